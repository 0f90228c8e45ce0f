from .sampled_sea import MovingSea, SampledSea
from .sea_floor import Floor
from .sea_picture import SurfacePicture
from .sea_scene import SeaScene, picture

__all__ = ["Floor", "MovingSea", "SampledSea", "SeaScene", "SurfacePicture", "picture"]
