from .clip_depth import DepthReport, depth_of_clip
from .sphere_stereo import DepthMap, distances
from .warping import Panorama

__all__ = ["DepthMap", "DepthReport", "Panorama", "depth_of_clip", "distances"]
