from .aerial_picture import AerialPicture, AerialReport, LoadedAerial, aerial, aerial_film, picture_parts
from .settings import AerialScene, load_aerial

__all__ = [
    "AerialPicture",
    "AerialReport",
    "AerialScene",
    "LoadedAerial",
    "aerial",
    "aerial_film",
    "load_aerial",
    "picture_parts",
]
