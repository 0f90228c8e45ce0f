# SPDX-License-Identifier: Apache-2.0
"""Methods of others, for comparison: benchmarks and a few settings reach them by name; no default uses them.

light_methods   inverse tone mapping (`light.operator`), irradiance by nine harmonics (`ibl.irradiance`, "sh9")
divided_areas   caustics that do not conserve energy (`caustics.method`)
aerial_look     shallow water from the air (`water.mode = "blended"`, `reflection.sun = "thresholded"`)
"""
