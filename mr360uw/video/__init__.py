# SPDX-License-Identifier: Apache-2.0
"""Frames in and out: video files, pictures, sound, spherical metadata and OpenEXR.

with open_video("dive.mp4") as video, create_video("out.mp4", like=video) as out:
    for frame in video.frames():
        out.write(frame)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mr360uw.video.clip import Clip as Clip
    from mr360uw.video.exr import read_exr as read_exr
    from mr360uw.video.exr import read_rgb as read_rgb
    from mr360uw.video.exr import write_exr as write_exr
    from mr360uw.video.frame import VideoFrame as VideoFrame
    from mr360uw.video.grain import with_grain as with_grain
    from mr360uw.video.images import read_picture as read_picture
    from mr360uw.video.plain import transcode as transcode
    from mr360uw.video.reader import VideoReader as VideoReader
    from mr360uw.video.reader import open_video as open_video
    from mr360uw.video.settings import EncodeSettings as EncodeSettings
    from mr360uw.video.spherical import SphericalMetadata as SphericalMetadata
    from mr360uw.video.spherical import read_spherical as read_spherical
    from mr360uw.video.spherical import write_spherical as write_spherical
    from mr360uw.video.writer import VideoWriter as VideoWriter
    from mr360uw.video.writer import create_video as create_video

_HOME = {
    "Clip": "clip",
    "EncodeSettings": "settings",
    "SphericalMetadata": "spherical",
    "VideoFrame": "frame",
    "VideoReader": "reader",
    "VideoWriter": "writer",
    "create_video": "writer",
    "open_video": "reader",
    "read_exr": "exr",
    "read_picture": "images",
    "read_rgb": "exr",
    "read_spherical": "spherical",
    "transcode": "plain",
    "with_grain": "grain",
    "write_exr": "exr",
    "write_spherical": "spherical",
}
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


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
