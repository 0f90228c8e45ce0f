from .caustic_match import CausticMatch, match_caustics, spectral_distance
from .floor_region import FloorRegion
from .water_match import WaterMatch, WaterPatch, match_water

__all__ = [
    "CausticMatch",
    "FloorRegion",
    "WaterMatch",
    "WaterPatch",
    "match_caustics",
    "match_water",
    "spectral_distance",
]
