# SPDX-License-Identifier: Apache-2.0
"""The interface of plates, and plates made of others: smaller ones for drafts, and ones whose frames are kept."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError, VideoError
from mr360uw.types import YuvImage
from mr360uw.video.clip import Clip
from mr360uw.video.video_frame import VideoFrame

Damaged = Literal["stop", "hold"]
Decoder = Literal["software", "auto"]
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

    def numbered_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return the frames (start, stop) whose numbers [start, stop) are those in the names of a sequence's files.

        Start 0 is the first frame, stop None the end. Clips without such numbers count from 0: as `check_range`.
        """
        first, count = self.first_number, self.frame_count
        if not first or count is None:
            return self.check_range(start, stop)
        begin, end = start or first, first + count if stop is None else stop
        if not first <= begin < end <= first + count:
            raise VideoError(
                f"{self.path} - frames outside the sequence (got {start}:{'' if stop is None else stop}, its files are "
                f"numbered {first} to {first + count - 1}) - take a range within {first}:{first + count}"
            )
        return self.check_range(begin - first, end - first)

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


_LEAST_ROWS = 16


def scaled(plate: VideoReader, scale: float) -> VideoReader:
    """Return a plate with frames of `scale` times its width and height, rounded to even sizes; for 1 itself.

    Raises `ParameterError` unless 0 < scale <= 1 and at least 16 rows are left.
    """
    if scale == 1.0:
        return plate
    width, height = scaled_size(plate, scale)
    return _ScaledReader(plate, width=width, height=height)


def scaled_size(plate: Clip, scale: float) -> tuple[int, int]:
    """Return the width and height of the frames of `scaled`; raise as it does."""
    if scale == 1.0:
        return plate.width, plate.height
    if not 0.0 < scale <= 1.0:
        raise ParameterError(f"scale - must be > 0 and <= 1 (got {scale}) - give 0.25 for a quarter of the width")
    width, height = (2 * round(0.5 * scale * size) for size in (plate.width, plate.height))
    if height < _LEAST_ROWS:
        raise ParameterError(
            f"scale - leaves frames of {width}x{height} of {plate.width}x{plate.height} (got {scale}) - give at least "
            f"{_LEAST_ROWS / plate.height:.2g}"
        )
    return width, height


class _ScaledReader(ReaderOver):
    """Reduces frames by `smaller`. Frames keep their index and time stamps."""

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        return (smaller(frame, self.width, self.height) for frame in self._plate.frames(start, stop))


def smaller(frame: VideoFrame, width: int, height: int) -> VideoFrame:
    """Return a frame reduced to an even size; every pixel is the mean of the codes that it covers."""
    if frame.shape == (height, width):
        return frame
    if frame.right is not None:
        frame = replace(frame, right=smaller(frame.right, width, height))
    if frame.yuv is None:
        assert frame.rgb is not None
        return replace(frame, rgb=_reduced(frame.rgb, width, height))
    old, (rows, columns) = frame.yuv, frame.shape
    y, u, v = (
        _reduced(plane, width * plane.shape[1] // columns, height * plane.shape[0] // rows)
        for plane in (old.y, old.u, old.v)
    )
    return replace(frame, yuv=YuvImage(y, u, v, old.spec), native=None)


def _reduced(plane: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    import cv2

    small = np.asarray(cv2.resize(np.ascontiguousarray(plane), (width, height), interpolation=cv2.INTER_AREA))
    small.flags.writeable = False
    return small


_MOST_BYTES = 512 << 20
"""Bytes of frames that are kept, where all of a range fit: 46 of 3840 x 1920 with 8 bits. Twice as many, runs over
clips up to twice as long decode once, and take half a gigabyte more."""


class DecodedOnce(ReaderOver):
    """A plate that keeps the frames [a, b) as they are read, and hands them out again; none where they are too many.

    What was worked out from a frame's codes is not kept.
    """

    def __init__(self, plate: VideoReader, span: tuple[int, int]) -> None:
        super().__init__(plate)
        self._span = range(*span)
        self._kept: dict[int, VideoFrame] = {}

    @property
    def are_all(self) -> bool:
        """Whether all frames of the range are kept."""
        return len(self._kept) == len(self._span)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        if all(index in self._kept for index in range(start, stop)):
            return (_anew(self._kept[index]) for index in range(start, stop))
        return map(self._seen, self._plate.frames(start, stop))

    def entry_before(self, index: int) -> int:
        """Return the last frame up to another that is read without others before it."""
        return self._plate.entry_before(index)

    def _seen(self, frame: VideoFrame) -> VideoFrame:
        """Return a frame that has been read; keep it, where it is one of those."""
        if frame.index in self._span and len(self._span) * _size(frame) <= _MOST_BYTES:
            self._kept[frame.index] = _anew(frame)
        return frame


def _anew(frame: VideoFrame) -> VideoFrame:
    """Return a frame of the same codes, with nothing worked out from them."""
    return replace(frame, right=None if frame.right is None else _anew(frame.right))


def _size(frame: VideoFrame) -> int:
    """Return the bytes of a frame's codes."""
    planes = (frame.rgb,) if frame.yuv is None else (frame.yuv.y, frame.yuv.u, frame.yuv.v)
    own = sum(plane.nbytes for plane in planes if plane is not None)
    return own if frame.right is None else own + _size(frame.right)
