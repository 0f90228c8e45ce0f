from .clip import Clip
from .exr import read_exr, read_rgb, write_exr
from .metadata.spherical import SphericalMetadata, read_spherical, write_spherical
from .read.images import read_picture
from .read.opening import open_video
from .read.reader import VideoReader
from .settings import EncodeSettings
from .transcoding import transcode
from .video_frame import VideoFrame
from .write.creating import create_video
from .write.layer_video import layer_video
from .write.writer import VideoWriter

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
    "read_rgb",
    "read_spherical",
    "transcode",
    "write_exr",
    "write_spherical",
]
