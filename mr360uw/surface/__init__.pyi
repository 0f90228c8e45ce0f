from .sampled_sea import MovingSea, SampledSea
from .sea_floor import Floor
from .sea_picture import SurfacePicture, picture

__all__ = ["Floor", "MovingSea", "SampledSea", "SurfacePicture", "picture"]
