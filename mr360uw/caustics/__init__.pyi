from .depth_ladder import stack_depths
from .export import export_tiles
from .flux.irradiance import caustic_map, caustic_stack
from .refraction import (
    fresnel_reflectance,
    fresnel_transmittance,
    refract_to_air,
    refract_to_water,
    sea_water_index,
)
from .sea.gerstner import GerstnerSea
from .sea.spectral import SpectralSea
from .settings import CausticSettings

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
