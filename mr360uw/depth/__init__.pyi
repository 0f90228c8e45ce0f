from .clip_depth import DepthReport, depth_of_clip
from .clip_eyes import depth_of_eyes, eye_distances
from .clip_water import water_of_clip
from .sphere_stereo import DepthMap, distances
from .warping import Panorama

__all__ = [
    "DepthMap",
    "DepthReport",
    "Panorama",
    "depth_of_clip",
    "depth_of_eyes",
    "distances",
    "eye_distances",
    "water_of_clip",
]
