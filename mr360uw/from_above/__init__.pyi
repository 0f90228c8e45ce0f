from .aerial_picture import AerialPicture, LoadedAerial, aerial
from .settings import AerialScene, load_aerial

__all__ = ["AerialPicture", "AerialScene", "LoadedAerial", "aerial", "load_aerial"]
