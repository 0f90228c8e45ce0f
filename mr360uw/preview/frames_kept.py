# SPDX-License-Identifier: Apache-2.0
"""Frames of plates at any size, in any order: readers stay open, and the last few frames are kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from mr360uw.reading.kept_reads import KeptReads, stamp
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, at_scale
from mr360uw.video import VideoFrame, VideoReader
from mr360uw.video.read.scaled import scaled_size, smaller

_KEPT_FRAMES = 8
"""Frames that are kept at the size they were asked for: 6 MB each at 2048 x 1024."""
_READ_ON = 24
"""Frames ahead that are reached by decoding on; what is farther is sought. Seeking costs at most as many again."""


@dataclass(slots=True)
class _Pass:
    """A pass over a plate that is still open. next_index: of the frame that comes next."""

    reader: VideoReader
    frames: Iterator[VideoFrame]
    next_index: int


class KeptFrames:
    """Reads frames of scenes' plates. reads: keeps readers and frames, and counts the frames decoded as "plate"."""

    def __init__(self, reads: KeptReads) -> None:
        self._reads = reads
        self._open: _Pass | None = None

    def reader(self, scene: Scene) -> VideoReader:
        """Return the reader of a scene's plate at its full size; opened again where the file has changed."""
        whole = at_scale(scene, 1.0)
        return self._reads.get("clip", whole.plate, lambda: open_plate(whole))

    def size(self, scene: Scene, width: int | None) -> tuple[int, int]:
        """Return the width and height of a scene's frames that are `width` pixels wide, rounded to even numbers.

        None takes the scene's own; a plate is never enlarged. Raises `ParameterError` for less than 16 rows.
        """
        reader = self.reader(scene)
        return scaled_size(reader, scene.plate.scale if width is None else min(width / reader.width, 1.0))

    def at(self, scene: Scene, index: int, size: tuple[int, int]) -> VideoFrame:
        """Return a frame of a scene's plate, width x height pixels; raise `VideoError`."""
        reader = self.reader(scene)
        reader.check_range(index, index + 1)
        which, cache = (reader, index, stamp(reader.file_of(index))), self._reads.cache

        def reduced() -> VideoFrame:
            return smaller(cache.get("plate", which, lambda: self._decoded(reader, index)), *size)

        return cache.get("plate at its size", (which, size), reduced, _KEPT_FRAMES)

    def close(self) -> None:
        """Close the file that is open."""
        self._open = None

    def _decoded(self, reader: VideoReader, index: int) -> VideoFrame:
        """Return a frame of a reader, decoding on from the last one where that is near."""
        going, self._open = self._open, None
        if going is None or going.reader is not reader or not 0 <= index - going.next_index < _READ_ON:
            going = _Pass(reader, iter(reader.frames(index)), index)
        while True:
            frame = next(going.frames)
            if frame.index == index:
                going.next_index = index + 1
                self._open = going
                return frame
