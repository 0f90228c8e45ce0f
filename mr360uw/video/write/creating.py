# SPDX-License-Identifier: Apache-2.0
"""Begins outputs of every kind: video files, sequences of pictures, single pictures."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from mr360uw.errors import VideoError
from mr360uw.output_gate import check_outputs
from mr360uw.video.clip import Clip, checked_rate
from mr360uw.video.read.suffixes import PICTURE_SUFFIXES
from mr360uw.video.settings import EncodeSettings
from mr360uw.video.write.image_writer import ImageWriter
from mr360uw.video.write.writer import VideoWriter


def create_video(
    path: str | Path,
    like: Clip | None = None,
    settings: EncodeSettings | None = None,
    *,
    width: int | None = None,
    height: int | None = None,
    frame_rate: Fraction | float = 30,
    sound: str | Path | None = None,
    overwrite: bool = False,
    audio: bool = True,
    rebase: bool = True,
    frames: tuple[int, int] | None = None,
) -> VideoWriter:
    """Begin an output with the size, colours, time stamps, sound and metadata of a plate, or a new one.

    path: .mp4, .mov, .mkv or .webm; or a picture or a pattern of pictures ("out_%04d.png", "out_####.exr"), numbered
    by the frame's index. like: the plate; without one, width, height, frame_rate and sound (a file) say what is made,
    in BT.709, 4:2:0, 8 bits. audio: copy the sound, unless the settings leave it out. rebase: when the first frame is
    not frame 0 of the plate, move pictures and sound so that the output begins where the plate begins; False keeps the
    time stamps. frames: (start, stop) of those that will be written, which time code and chapters follow; default: all.

    Raises `OutputExistsError` where the output is there already and `overwrite` is not set, `OutputError` where it may
    not be written, `VideoError` where it cannot be made.
    """
    path = Path(path)
    if like is None:
        if width is None or height is None:
            raise VideoError(f"{path} - the size of a new video is missing - give like, or width and height")
        like = _new_clip(path, width, height, frame_rate, sound)
    check_outputs([path], inputs=[like.path] if like.path.name else [], overwrite=overwrite)
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return ImageWriter(path, like, overwrite)
    from mr360uw.video.write.container_writer import ContainerWriter

    return ContainerWriter(
        path, like, settings or EncodeSettings(), audio=audio, rebase=rebase, overwrite=overwrite, frames=frames
    )


def _new_clip(path: Path, width: int, height: int, frame_rate: Fraction | float, sound: str | Path | None) -> Clip:
    if width != 2 * height or height < 2 or height % 2:
        raise VideoError(
            f"{path} - a panorama must be 2:1 with an even height (got {width}x{height}) - take 2048x1024 or 3840x1920"
        )
    rate = checked_rate(frame_rate, path)
    return Clip(
        path=Path(),
        width=width,
        height=height,
        frame_rate=rate,
        time_base=1 / rate,
        sound=Path(sound) if sound is not None else None,
    )
