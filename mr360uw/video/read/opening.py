# SPDX-License-Identifier: Apache-2.0
"""Opens plates of every kind: video files, sequences of pictures, stills."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from mr360uw.color import Primaries, Transfer
from mr360uw.errors import VideoError
from mr360uw.shapes import file_path
from mr360uw.video.clip import checked_rate
from mr360uw.video.read.images import ImageReader, picture_files
from mr360uw.video.read.layout import Eye, Layout
from mr360uw.video.read.projection import FISHEYE_FOV_DEG, Projection, projection_of
from mr360uw.video.read.reader import Damaged, VideoReader


def open_video(
    path: str | Path,
    transfer: Transfer | None = None,
    *,
    primaries: Primaries | None = None,
    eye: Eye | None = None,
    frame_rate: Fraction | float = 30,
    equirectangular: bool = True,
    depth: bool = False,
    damaged: Damaged = "stop",
    projection: Projection = "auto",
    fisheye_fov_deg: float = FISHEYE_FOV_DEG,
    layout: Layout | None = None,
) -> VideoReader:
    """Open a plate: a video (mp4, mov, mkv, webm ...), one picture, or a sequence of pictures.

    path: a file, or the pattern of a sequence: "plate_%04d.png", "plate_####.exr" or "plate_*.png".
    transfer: curve from code values to linear light; by default sRGB, PQ or HLG where the file is tagged so, and none
    for EXR and HDR pictures. primaries: of the plate's light; by default those of its matrix.
    eye: "left" or "right" of a stereo plate, or "both": then frames are the left eye's and have the right one.
    frame_rate: of pictures, which have none of their own. equirectangular: refuse what is not a panorama, of 2:1 or
    tagged as one. depth: read EXR pictures by their channel Z if they have one. damaged: "stop" raises at a frame of a
    video that cannot be decoded, "hold" repeats the last one that could.
    projection: of the file's pictures; frames of "dual_fisheye" and "eac" are turned to equirectangular. "auto": .insv
    is dual fisheye, .360 is EAC, all else equirectangular. fisheye_fov_deg: across one half of a dual-fisheye frame.
    layout: arrangement of the eyes in a file without tags; by default as its tags or its shape say.

    VideoError where the plate cannot be used.
    """
    path = file_path("video", path)
    kind = projection_of(path, projection) if equirectangular else "equirectangular"
    if kind != "equirectangular":
        from mr360uw.video.read.unwrapped import open_unwrapped

        if eye is not None:
            raise VideoError(f"{path} - {kind} has no {eye} eye - leave out the eye")
        return open_unwrapped(Path(path), kind, fisheye_fov_deg, transfer, primaries, damaged)
    files = picture_files(Path(path))
    if files is not None:
        rate = checked_rate(frame_rate, Path(path))
        return ImageReader(Path(path), files, rate, transfer, primaries, eye, equirectangular, depth, layout)
    from mr360uw.video.read.container import ContainerReader

    return ContainerReader(Path(path), transfer, primaries, eye, equirectangular, damaged, layout)
