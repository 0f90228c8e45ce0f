# SPDX-License-Identifier: Apache-2.0
"""Where the frames of a range go: into segments of a video, or into numbered pictures; both remember what is done."""

from __future__ import annotations

import itertools
from contextlib import suppress
from pathlib import Path

from mr360uw.errors import VideoError
from mr360uw.runs.work_folder import WorkFolder
from mr360uw.video import Clip, EncodeSettings, VideoFrame
from mr360uw.video.write.image_writer import ImageWriter
from mr360uw.video.write.segment import SegmentWriter
from mr360uw.video.write.writer import VideoWriter

Part = tuple[int, int]
"""Frames [start, stop) of a clip."""


def segment_bounds(start: int, stop: int, length: int) -> list[Part]:
    """Return the parts [a, b) of a range: cut at multiples of `length`, so that ranges share the parts inside them."""
    cuts = [start, *range((start // length + 1) * length, stop, length), stop]
    return list(itertools.pairwise(cuts))


def joined_bounds(parts: list[Part]) -> list[Part]:
    """Return ascending parts with those that follow each other made one."""
    found: list[Part] = []
    for start, stop in parts:
        follows = bool(found) and found[-1][1] == start
        found.append((found.pop()[0] if follows else start, stop))
    return found


class SegmentSink(VideoWriter):
    """Frames of a range as segments in a work folder, each complete as soon as its last frame is encoded."""

    def __init__(self, work: WorkFolder, parts: list[Part], like: Clip, settings: EncodeSettings) -> None:
        self.path = work.path
        self._stops, self._clip, self._settings = dict(parts), like, settings
        self._writer: SegmentWriter | None = None
        self._stop = 0

    def write(self, frame: VideoFrame) -> None:
        """Encode a frame into its segment."""
        if self._writer is None:
            self._stop = self._stops[frame.index]
            self._writer = SegmentWriter(self.path, frame.index, self._stop, self._clip, self._settings)
        self._writer.write(frame)
        if frame.index + 1 == self._stop:
            self._writer.finish()
            self._writer = None

    def finish(self) -> None:
        """Complete the last segment; the frames of it have all been written."""
        if self._writer is not None:
            self._writer.finish()

    def abort(self) -> None:
        """End the segment that is not complete with the frames that it has, or remove it where that fails."""
        if self._writer is not None:
            with suppress(VideoError):  # of a disk that is full; the error that ends the run says so
                self._writer.cut()
            self._writer.abort()


class PictureSink(VideoWriter):
    """Frames of a range from `start` on as pictures under their own names."""

    def __init__(self, work: WorkFolder, start: int, pattern: Path, like: Clip) -> None:
        self.path = pattern
        self._work, self._start = work, start
        self._writer = ImageWriter(pattern, like, overwrite=True, folder=work.path)

    def write(self, frame: VideoFrame) -> None:
        """Write the frame's picture."""
        self._writer.write(frame)
        self._work.add_picture(frame.index, self._start)

    def finish(self) -> None:
        """Nothing is left to do: every picture is complete."""

    def abort(self) -> None:
        """Nothing is left to remove: every picture is complete."""
