# SPDX-License-Identifier: Apache-2.0
"""Published methods that settings can select for comparison; the defaults are in the folder above.

tone_curves   operators that are a gain of one number per pixel (mr360, landis, akyuz, piecewise)
enhancement   the operator that depends on a pixel's surroundings (kovaleski)
harmonics     irradiance by nine spherical harmonics (sh9)
"""
