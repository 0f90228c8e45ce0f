# SPDX-License-Identifier: Apache-2.0
"""Light from the plate: expansion to scene radiance, environment maps, the sun."""
