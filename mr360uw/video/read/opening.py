# SPDX-License-Identifier: Apache-2.0
"""Opens plates of every kind: video files, sequences of pictures, stills."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from mr360uw.color import Transfer
from mr360uw.video.read.images import ImageReader, picture_files
from mr360uw.video.read.layout import Eye, Layout
from mr360uw.video.read.reader import Damaged, VideoReader


def open_video(
    path: str | Path,
    transfer: Transfer | None = None,
    *,
    eye: Eye | None = None,
    frame_rate: Fraction | float = 30,
    equirectangular: bool = True,
    depth: bool = False,
    damaged: Damaged = "stop",
    layout: Layout | None = None,
) -> VideoReader:
    """Open a plate: a video (mp4, mov, mkv, webm ...), one picture, or a sequence of pictures.

    path: a file, or the pattern of a sequence: "plate_%04d.png", "plate_####.exr" or "plate_*.png".
    transfer: curve from code values to linear light; by default sRGB, and none for EXR and HDR pictures.
    eye: "left" or "right" of a stereo plate, or "both": then frames are the left eye's and have the right one.
    frame_rate: of pictures, which have none of their own. equirectangular: refuse what is not a panorama, of 2:1 or
    tagged as one. depth: read EXR pictures by their channel Z if they have one. damaged: "stop" raises at a frame of a
    video that cannot be decoded, "hold" repeats the last one that could. layout: arrangement of the eyes in a file
    without tags; by default as its tags or its shape say.

    VideoError where the plate cannot be used.
    """
    files = picture_files(Path(path))
    if files is not None:
        rate = Fraction(frame_rate).limit_denominator(1001)
        return ImageReader(Path(path), files, rate, transfer, eye, equirectangular, depth, layout)
    from mr360uw.video.read.container import ContainerReader

    return ContainerReader(Path(path), transfer, eye, equirectangular, damaged, layout)
