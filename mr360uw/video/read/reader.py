# SPDX-License-Identifier: Apache-2.0
"""The interface of plates: videos, image sequences and stills."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from mr360uw.errors import VideoError
from mr360uw.video.clip import Clip
from mr360uw.video.video_frame import VideoFrame

Damaged = Literal["stop", "hold"]
"""What happens at a frame that cannot be decoded: an error, or the last good frame once more."""

Seeker = Callable[[int], Iterator[VideoFrame]]
"""Frames from a start on, to the end of the clip; of a still its one."""


class VideoReader(Clip, ABC):
    """A plate; made by `open_video`. Its metadata: see `Clip`."""

    @property
    def intact_frames(self) -> int | None:
        """Number of frames from the first on whose data are there; less than `frame_count` in a file cut short."""
        return self.frame_count

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there, one line each."""
        return ()

    @abstractmethod
    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; VideoError where the plate does not hold all of these frames."""

    def file_of(self, index: int) -> Path:  # noqa: ARG002 - sequences have one for each frame
        """Return the file that holds a frame."""
        return self.path

    @abstractmethod
    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop (to the end by default).

        Frame k is the same however it is reached. The range is checked at once, the frames are decoded as they are
        asked for. Use each iterator from one thread; several may run side by side.
        """

    @contextmanager
    def seeker(self) -> Iterator[Seeker]:
        """Yield a function of a start that returns the frames from there on, to go to and fro in a file kept open.

        Each call ends the pass of the one before.
        """
        yield self.frames

    def entry_before(self, index: int) -> int:
        """Return the last frame up to another that is read without others before it."""
        return index

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the plate; no file stays open between passes."""
        return


class ReaderOver(VideoReader):
    """A plate made of another one, whose frames it changes or keeps. changed: metadata that differ from the other's."""

    def __init__(self, plate: VideoReader, **changed: Any) -> None:
        kept: dict[str, Any] = {field.name: getattr(plate, field.name) for field in fields(Clip)}
        super().__init__(**(kept | changed))
        self._plate = plate

    @property
    def frame_count(self) -> int | None:
        """Number of frames; None for a still."""
        return self._plate.frame_count

    @property
    def intact_frames(self) -> int | None:
        """Number of frames whose data are there; see `VideoReader`."""
        return self._plate.intact_frames

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there."""
        return self._plate.doubts

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; see `VideoReader`."""
        return self._plate.check_range(start, stop)

    def file_of(self, index: int) -> Path:
        """Return the file that holds a frame."""
        return self._plate.file_of(index)


def check_range(path: Path, start: int, stop: int | None, count: int) -> tuple[int, int]:
    """Return (start, stop), stop filled in with the count; VideoError unless 0 <= start < stop <= count."""
    if not isinstance(start, int | np.integer) or not isinstance(stop, int | np.integer | None):
        raise VideoError(f"{path} - frames must be whole numbers (got {start!r:.20}, {stop!r:.20}) - take 0 to {count}")
    end = count if stop is None else stop
    if not 0 <= start < end <= count:
        raise VideoError(
            f"{path} - frames outside the clip (got {start}:{'' if stop is None else stop}, the clip has "
            f"{count} frames) - take a range within 0:{count}"
        )
    return start, end
