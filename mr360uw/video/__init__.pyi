from .clip import Clip
from .exr import read_exr, read_rgb, write_exr
from .frame import VideoFrame
from .metadata.spherical import SphericalMetadata, read_spherical, write_spherical
from .pixels.grain import with_grain
from .plain import transcode
from .read.images import read_picture
from .read.reader import VideoReader, open_video
from .settings import EncodeSettings
from .write.writer import VideoWriter, create_video

__all__ = [
    "Clip",
    "EncodeSettings",
    "SphericalMetadata",
    "VideoFrame",
    "VideoReader",
    "VideoWriter",
    "create_video",
    "open_video",
    "read_exr",
    "read_picture",
    "read_rgb",
    "read_spherical",
    "transcode",
    "with_grain",
    "write_exr",
    "write_spherical",
]
