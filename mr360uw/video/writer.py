# SPDX-License-Identifier: Apache-2.0
"""Outputs: a video, one picture, or a sequence of pictures.

Everything is written under a temporary name (`.part` beside the target) and renamed when complete; when anything
fails, or the program is interrupted, the temporary file is removed.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Self

from mr360uw.errors import OutputExistsError, VideoError
from mr360uw.video.frame import VideoFrame
from mr360uw.video.reader import VideoReader
from mr360uw.video.settings import EncodeSettings


class VideoWriter(ABC):
    """An output; made by `create_video`, used in a `with` block: leaving it completes the output.

    path: the file or the pattern. notes: what the output does not carry, one line each. Use it from one thread.
    """

    path: Path
    notes: tuple[str, ...] = ()

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
    like: VideoReader,
    settings: EncodeSettings | None = None,
    *,
    overwrite: bool = False,
    audio: bool = True,
    rebase: bool = True,
) -> VideoWriter:
    """Begin an output with the size, colours, time stamps, sound and metadata of a plate.

    path: .mp4, .mov, .mkv or .webm; or a picture or a pattern of pictures ("out_%04d.png", "out_####.exr"), numbered
    by the frame's index. audio: copy the sound. rebase: when the first frame is not frame 0 of the plate, move pictures
    and sound so that the output begins where the plate begins; False keeps the time stamps.

    OutputExistsError where the output is there already and `overwrite` is not set; VideoError where it cannot be made.
    """
    from mr360uw.video.images import PICTURE_SUFFIXES

    path = Path(path)
    _check_target(path, like.path)
    if path.suffix.lower() in PICTURE_SUFFIXES:
        from mr360uw.video.image_writer import ImageWriter

        return ImageWriter(path, like, overwrite)
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path} - is already there - choose another name or allow overwriting")
    from mr360uw.video.container_writer import ContainerWriter

    return ContainerWriter(path, like, settings or EncodeSettings(), audio, rebase)


def _check_target(path: Path, plate: Path) -> None:
    folder = path.parent
    if not folder.is_dir():
        raise VideoError(f"{path} - the output folder is missing (got {folder}) - make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise VideoError(f"{path} - the output folder may not be written to (got {folder}) - choose another one")
    if path.is_dir():
        raise VideoError(f"{path} - is a folder - name a file in it")
    if path.exists() and plate.exists() and path.samefile(plate):
        raise VideoError(f"{path} - the output would replace the plate - choose another name")
