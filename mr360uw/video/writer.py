# SPDX-License-Identifier: Apache-2.0
"""The interface of outputs: a video, one picture, or a sequence of pictures.

Everything is written under a new temporary name and renamed when complete; when anything fails, or the program is
interrupted, the temporary file is removed.
"""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import av
import av.error
import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec
from mr360uw.errors import VideoError
from mr360uw.reading.disk_cache import read_arrays, write_arrays
from mr360uw.types import Floats
from mr360uw.video.clip import Clip
from mr360uw.video.encoder import Encoder, resolved
from mr360uw.video.formats import EncodeSettings
from mr360uw.video.video_frame import VideoFrame


class VideoWriter(ABC):
    """An output; made by `create_video`, used in a `with` block: leaving it completes the output.

    path: the file or the pattern. notes: parts of the plate that it lacks, one line each. Use it from one thread.
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


# Encoded parts of a video, each decodable on its own, that are joined without encoding them again.
#
# A segment is two files: its packets one after the other, and a table of them, which is written last, when the packets
# are on the disk. A segment is complete when its table is there and holds the hash of its name and its packets.

_DATA, _TABLE = ".packets", ".npz"


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Encoded frames [start, stop) of a plate.

    data: file of the packets. packets: (n, 4) int64 in decoding order: time stamp of presentation and duration in the
    plate's time base, whether decoding can start here, size in bytes.
    """

    start: int
    stop: int
    data: Path
    packets: NDArray[np.int64]


class SegmentWriter(VideoWriter):
    """One segment as output, for frames [start, stop) of a plate; leaving the `with` block completes it.

    folder: gets its files.
    """

    def __init__(self, folder: Path, start: int, stop: int, like: Clip, settings: EncodeSettings) -> None:
        self.path = _data_path(folder, start, stop)
        self._clip, self._left, self._span = like, stop - start, (start, stop)
        settings = resolved(settings, like)
        context = av.CodecContext.create(settings.encoder_name, "w")
        # parameter sets go into the header of the joined file, as its containers want
        context.flags |= av.codec.context.Flags.global_header
        self._encoder = Encoder(self.path, like, settings, context)
        self._packets: list[tuple[int, int, int, int]] = []
        self._hash = hashlib.sha256()
        self._complete = False
        with self._errors():
            self._file: BinaryIO = self.path.open("wb")

    def write(self, frame: VideoFrame) -> None:
        """Encode a frame."""
        self._keep(self._encoder.encode(frame, frame.pts))
        self._left -= 1

    def _keep(self, packets: list[Any]) -> None:
        with self._errors():
            for packet in packets:
                data = bytes(packet)
                size = self._file.write(data)
                self._hash.update(data)
                self._packets.append((packet.pts, packet.duration or 0, int(packet.is_keyframe), size))

    def finish(self) -> None:
        """Encode what is pending and write the table."""
        if self._file.closed:
            return
        if self._left:
            raise VideoError(f"{self.path} - lacks frames (got {self._left} too few) - render the segment again")
        self._keep(self._encoder.flush())
        with self._errors():
            self._file.flush()
            os.fsync(self._file.fileno())  # after a power cut, no table stands beside packets that are not there
            self._file.close()
            mark = _mark(self.path, self._hash)
            table: dict[str, NDArray[Any]] = {"packets": np.array(self._packets, np.int64), "sha256": mark}
            write_arrays(self.path.with_suffix(_TABLE), table)
        self._complete = True

    def cut(self) -> None:
        """Complete the segment with the frames that it has, under a name that says so; without any it is removed."""
        start, stop = self._span[0], self._span[1] - self._left
        if not self._file.closed and stop > start:
            with self._errors():
                self.path = self.path.rename(_data_path(self.path.parent, start, stop))
            self._left = 0
            self.finish()
        self.abort()

    def abort(self) -> None:
        """Remove the segment unless it is complete."""
        if not self._complete:
            with suppress(OSError):  # what is left in a buffer cannot be written where the disk is full
                self._file.close()
            self.path.unlink(missing_ok=True)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise VideoError(
                f"{self.path} - cannot be written (got {error.strerror}) - check the space and the folder's rights"
            ) from error


def _data_path(folder: Path, start: int, stop: int) -> Path:
    return folder / f"{start:08d}-{stop:08d}{_DATA}"


def stored_segments(folder: Path) -> list[Segment]:
    """Return the complete segments in a folder by their first frame; damaged ones are left out."""
    found = []
    for table in sorted(folder.glob(f"????????-????????{_TABLE}")):
        data, stored = table.with_suffix(_DATA), read_arrays(table)
        try:
            start, stop = map(int, table.stem.split("-"))
            with data.open("rb") as file:
                mark = _mark(data, hashlib.file_digest(file, "sha256"))
        except (OSError, ValueError):
            continue
        if stored is not None and np.array_equal(stored.get("sha256", ()), mark):
            found.append(Segment(start, stop, data, stored["packets"]))
    return found


def _mark(data: Path, found: hashlib._Hash) -> NDArray[np.uint8]:
    """Return the hash (32,) of a segment's name and of its packets, whose own hash is given."""
    return np.frombuffer(hashlib.sha256(data.stem.encode() + found.digest()).digest(), np.uint8)


def decoding_stamps(pts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return time stamps of decoding (n,) for packets with time stamps of presentation (n,) in decoding order.

    They rise, none is after its packet's presentation, and the delay between both is as short as can be.
    """
    shown = np.sort(pts)
    place = np.arange(len(pts))
    delay = int(np.max(place - np.searchsorted(shown, pts)))
    step = int(np.min(np.diff(shown))) if len(pts) > 1 else 1
    before = shown[0] - step * np.arange(delay, 0, -1)
    return np.concatenate([before, shown[: len(pts) - delay]])
