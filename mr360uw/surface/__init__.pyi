from .sampled_sea import MovingSea, SampledSea
from .sea_floor import Floor
from .sea_picture import SeaScene, SurfacePicture, picture

__all__ = ["Floor", "MovingSea", "SampledSea", "SeaScene", "SurfacePicture", "picture"]
