from .sampled_sea import SampledSea
from .sea_floor import Floor
from .sea_picture import SeaScene, SurfacePicture, picture

__all__ = ["Floor", "SampledSea", "SeaScene", "SurfacePicture", "picture"]
