from .clip import Clip, EncodeSettings
from .container_writer import layer_video
from .exr import read_exr, write_exr
from .opening import create_video, open_video, transcode
from .picture_file import read_picture
from .reader import VideoFrame, VideoReader
from .spherical import SphericalMetadata, read_spherical, write_spherical
from .writer import VideoWriter

__all__ = [
    "Clip",
    "EncodeSettings",
    "SphericalMetadata",
    "VideoFrame",
    "VideoReader",
    "VideoWriter",
    "create_video",
    "layer_video",
    "open_video",
    "read_exr",
    "read_picture",
    "read_spherical",
    "transcode",
    "write_exr",
    "write_spherical",
]
