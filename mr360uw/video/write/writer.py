# SPDX-License-Identifier: Apache-2.0
"""Outputs: a video, one picture, or a sequence of pictures.

Everything is written under a temporary name (`.part` beside the target) and renamed when complete; when anything
fails, or the program is interrupted, the temporary file is removed.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.errors import OutputExistsError, VideoError
from mr360uw.types import Floats
from mr360uw.video.clip import Clip
from mr360uw.video.frame import VideoFrame
from mr360uw.video.settings import EncodeSettings


class VideoWriter(ABC):
    """An output; made by `create_video`, used in a `with` block: leaving it completes the output.

    path: the file or the pattern. notes: what the output does not carry, one line each. Use it from one thread.
    """

    path: Path
    notes: tuple[str, ...] = ()
    _clip: Clip
    _images = 0

    def write_image(self, image_linear: Floats) -> None:
        """Append a picture of linear Rec.709 light (H, W, 3) at the next position in time."""
        index, base = self._images, self._clip.time_base
        step = round(1 / (self._clip.frame_rate * base))
        pts = self._clip.start_pts + index * step
        linear = ColorSpec("bt709", True, "linear", 32)
        rgb = np.asarray(image_linear, np.float32)
        self.write(VideoFrame(index, pts, base, float(index * step * base), step, linear, rgb=rgb))
        self._images += 1

    @abstractmethod
    def write(self, frame: VideoFrame) -> None:
        """Append a frame. Frames come in order of presentation. VideoError where it cannot be written."""

    @abstractmethod
    def finish(self) -> None:
        """Complete the output and let it appear under its name."""

    @abstractmethod
    def abort(self) -> None:
        """Remove everything that is not complete."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self.abort()


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
) -> VideoWriter:
    """Begin an output with the size, colours, time stamps, sound and metadata of a plate, or a new one.

    path: .mp4, .mov, .mkv or .webm; or a picture or a pattern of pictures ("out_%04d.png", "out_####.exr"), numbered
    by the frame's index. like: the plate; without one, width, height, frame_rate and sound (a file) say what is made,
    in BT.709, 4:2:0, 8 bits. audio: copy the sound, unless the settings leave it out. rebase: when the first frame is
    not frame 0 of the plate, move pictures and sound so that the output begins where the plate begins; False keeps the
    time stamps.

    OutputExistsError where the output is there already and `overwrite` is not set; VideoError where it cannot be made.
    """
    from mr360uw.video.read.images import PICTURE_SUFFIXES

    path = Path(path)
    if like is None:
        if width is None or height is None:
            raise VideoError(f"{path} - the size of a new video is missing - give like, or width and height")
        like = _new_clip(path, width, height, frame_rate, sound)
    _check_target(path, like.path)
    if path.suffix.lower() in PICTURE_SUFFIXES:
        from mr360uw.video.write.image_writer import ImageWriter

        return ImageWriter(path, like, overwrite)
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path} - is already there - choose another name or allow overwriting")
    from mr360uw.video.write.container_writer import ContainerWriter

    return ContainerWriter(path, like, settings or EncodeSettings(), audio, rebase)


def _new_clip(path: Path, width: int, height: int, frame_rate: Fraction | float, sound: str | Path | None) -> Clip:
    if width != 2 * height or height < 2 or height % 2:
        raise VideoError(
            f"{path} - a panorama must be 2:1 with an even height (got {width}x{height}) - take 2048x1024 or 3840x1920"
        )
    rate = Fraction(frame_rate).limit_denominator(1001)
    if rate <= 0:
        raise VideoError(f"{path} - frame rate must be positive (got {frame_rate}) - give frames per second")
    return Clip(
        path=Path(),
        width=width,
        height=height,
        frame_rate=rate,
        time_base=1 / rate,
        sound=Path(sound) if sound is not None else None,
    )


def _check_target(path: Path, plate: Path) -> None:
    folder = path.parent
    if not folder.is_dir():
        raise VideoError(f"{path} - the output folder is missing (got {folder}) - make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise VideoError(f"{path} - the output folder may not be written to (got {folder}) - choose another one")
    if path.is_dir():
        raise VideoError(f"{path} - is a folder - name a file in it")
    if path.exists() and plate.exists() and plate.name and path.samefile(plate):
        raise VideoError(f"{path} - the output would replace the plate - choose another name")
