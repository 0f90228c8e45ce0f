from .export import export_tiles
from .gerstner import GerstnerSea
from .irradiance import (
    caustic_map,
    caustic_stack,
    fresnel_reflectance,
    fresnel_transmittance,
    refract_to_air,
    refract_to_water,
    sea_water_index,
)
from .settings import CausticSettings, stack_depths
from .spectral import SpectralSea

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
