from .caustic_match import CausticMatch, match_caustics, spectral_distance
from .water_match import WaterMatch, WaterPatch, match_water

__all__ = [
    "CausticMatch",
    "WaterMatch",
    "WaterPatch",
    "match_caustics",
    "match_water",
    "spectral_distance",
]
