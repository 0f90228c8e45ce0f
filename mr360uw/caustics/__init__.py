# SPDX-License-Identifier: Apache-2.0
"""The sea surface and the caustics it casts."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mr360uw.caustics.export import export_tiles
    from mr360uw.caustics.gerstner import GerstnerSea
    from mr360uw.caustics.irradiance import caustic_map, caustic_stack
    from mr360uw.caustics.planes import stack_depths
    from mr360uw.caustics.refraction import (
        fresnel_reflectance,
        fresnel_transmittance,
        refract_to_air,
        refract_to_water,
        sea_water_index,
    )
    from mr360uw.caustics.settings import CausticSettings
    from mr360uw.caustics.spectral import SpectralSea

_HOME = {
    "CausticSettings": "settings",
    "GerstnerSea": "gerstner",
    "SpectralSea": "spectral",
    "caustic_map": "irradiance",
    "caustic_stack": "irradiance",
    "export_tiles": "export",
    "fresnel_reflectance": "refraction",
    "fresnel_transmittance": "refraction",
    "refract_to_air": "refraction",
    "refract_to_water": "refraction",
    "sea_water_index": "refraction",
    "stack_depths": "planes",
}

__all__ = [
    "CausticSettings",
    "GerstnerSea",
    "SpectralSea",
    "caustic_map",
    "caustic_stack",
    "export_tiles",
    "fresnel_reflectance",
    "fresnel_transmittance",
    "refract_to_air",
    "refract_to_water",
    "sea_water_index",
    "stack_depths",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
