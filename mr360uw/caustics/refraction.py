# SPDX-License-Identifier: Apache-2.0
"""Refraction at the sea surface, for `mr360uw.caustics`; the formulas stand in `mr360uw.optics`."""

from mr360uw.optics import (
    fresnel_reflectance,
    fresnel_transmittance,
    refract_to_air,
    refract_to_water,
    sea_water_index,
)

__all__ = ["fresnel_reflectance", "fresnel_transmittance", "refract_to_air", "refract_to_water", "sea_water_index"]
