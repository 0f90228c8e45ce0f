from .floor import Floor
from .picture import SurfacePicture, picture
from .sampled_sea import MovingSea, SampledSea

__all__ = ["Floor", "MovingSea", "SampledSea", "SurfacePicture", "picture"]
