# SPDX-License-Identifier: Apache-2.0
"""Frames of plates at any size, in any order: readers stay open, and the last few frames are kept. Length and size
are told without decoding.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from typing import Self

import numpy as np

from mr360uw.reading.cached_reads import CachedReads, Stamp, stamp
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, at_scale
from mr360uw.video import VideoFrame, VideoReader
from mr360uw.video.read.reader import Seeker, scaled_size, smaller


@dataclass(frozen=True, slots=True)
class PlateClip:
    """A scene's plate. width, height: [pixels], at full size. frame_count, duration_s: None for a still, which has as
    many frames as are asked for. frame_rate: [1/s].
    """

    frame_count: int | None
    frame_rate: Fraction
    width: int
    height: int
    duration_s: float | None

    @classmethod
    def of(cls, reader: VideoReader) -> Self:
        """Return the length and size of an open plate."""
        count, rate = reader.frame_count, reader.frame_rate
        return cls(count, rate, reader.width, reader.height, None if count is None else float(count / rate))


def clip_of(scene: Scene) -> PlateClip:
    """Return the length and size of a scene's plate; raise `VideoError`."""
    with open_plate(scene) as video:
        return PlateClip.of(video)


_SOON = 4
"""Frames to decode before one from which on its keyframe comes sooner: 3840 x 1920 take 15 to 50 ms each on two cores.
Twice as many, the play head waits for half a second."""
_KEPT_FRAMES = 8
"""Frames that are kept at the size they were asked for: 6 MB each at 2048 x 1024."""


class KeptFrames:
    """Reads frames of scenes' plates. reads: keeps readers and frames, and counts the frames decoded."""

    def __init__(self, reads: CachedReads) -> None:
        self._reads = reads
        self._open: VideoReader | None = None  # the plate whose file is open
        self._closing = ExitStack()
        self._seek: Seeker = lambda _: iter(())
        self._frames: Iterator[VideoFrame] = iter(())  # the pass that goes on
        self._next = -1  # of the frame that comes next in it

    def reader(self, scene: Scene) -> VideoReader:
        """Return the reader of a scene's plate at its full size; opened again where the file has changed."""
        whole = at_scale(scene, 1.0)
        return self._reads.of(open_plate, whole.only())

    def size(self, scene: Scene, width: int | None) -> tuple[int, int]:
        """Return the width and height of a scene's frames that are `width` pixels wide, rounded to even numbers.

        None takes the scene's own; a plate is never enlarged. Raises `ParameterError` for less than 16 rows.
        """
        reader = self.reader(scene)
        return scaled_size(reader, scene.plate.scale if width is None else min(width / reader.width, 1.0))

    def at(self, scene: Scene, index: int, width: int | None) -> VideoFrame:
        """Return a frame of a scene's plate, `width` pixels wide, see `size`; raise `VideoError`."""
        reader, size = self.reader(scene), self.size(scene, width)
        reader.check_range(index, index + 1)
        return self._reads.cache.of(self._reduced, reader, index, stamp(reader.file_of(index)), size, keep=_KEPT_FRAMES)

    def _reduced(self, reader: VideoReader, index: int, at: Stamp, size: tuple[int, int]) -> VideoFrame:
        """Return a frame at a size. at: the stamp of its file."""
        return smaller(self._reads.cache.of(self._decoded, reader, index, at), *size)

    def soonest(self, scene: Scene, index: int, width: int | None) -> int:
        """Return the frame that stands in for another while that is decoded: its keyframe, or itself where it is near.

        Raises `VideoError`.
        """
        reader, size, cache = self.reader(scene), self.size(scene, width), self._reads.cache
        entry, which = reader.entry_before(index), (reader, index, stamp(reader.file_of(index)))
        kept = cache.holds(self._decoded, *which) or cache.holds(self._reduced, *which, size)
        start = max(entry, self._next) if self._open is reader else entry
        return index if kept or index - (start if start <= index else entry) < _SOON else entry

    def overview(self, scene: Scene, count: int, width: int) -> list[VideoFrame]:
        """Return up to `count` small frames spread over a scene's plate, for a time line; raise `VideoError`.

        They are the keyframes nearest before even steps, which are read without others; each has its own index.
        """
        reader = self.reader(scene)
        last = 1 if reader.frame_count is None else reader.frame_count
        places = np.linspace(0, last - 1, count).astype(int).tolist()
        return [self.at(scene, index, width) for index in dict.fromkeys(map(reader.entry_before, places))]

    def close(self) -> None:
        """Close the file that is open."""
        self._closing.close()
        self._open, self._frames = None, iter(())

    def _decoded(self, reader: VideoReader, index: int, _: Stamp) -> VideoFrame:
        """Return a frame of a reader, decoding on from the last one where that is near; its file is as its stamp."""
        if self._open is not reader:
            self.close()
            self._seek, self._next = self._closing.enter_context(reader.seeker()), -1
            self._open = reader
        if not reader.entry_before(index) <= self._next <= index:
            self._frames = self._seek(index)
        self._next = -1
        frame = next(frame for frame in self._frames if frame.index == index)
        self._next = index + 1
        return frame
