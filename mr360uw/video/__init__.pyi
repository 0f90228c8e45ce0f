from .clip import Clip
from .exr import read_exr, read_rgb, write_exr
from .metadata.spherical import SphericalMetadata, read_spherical, write_spherical
from .opening import create_video, open_video, transcode
from .read.picture_file import read_picture
from .read.reader import VideoReader
from .settings import EncodeSettings
from .video_frame import VideoFrame
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
