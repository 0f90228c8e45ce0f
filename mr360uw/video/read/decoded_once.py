# SPDX-License-Identifier: Apache-2.0
"""The frames of a short clip, decoded once: a first pass keeps them for what reads the clip again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from mr360uw.video.read.reader import ReaderOver, VideoReader
from mr360uw.video.video_frame import VideoFrame

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
