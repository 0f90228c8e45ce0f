# SPDX-License-Identifier: Apache-2.0
"""Decodes the pictures of a video file in order of presentation, and tells which of them are lost.

Frames are numbered in order of presentation. MP4 and MOV hold an index of all packets; packets that an edit list cuts
away are marked and do not count. Other containers are read through once (packets only, nothing is decoded).

Every packet that is to be shown announces a time stamp. Decoders hand out pictures in the order of these stamps, so a
stamp that is passed over is a picture that could not be decoded, whether the decoder reported an error or not.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import av.error
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FrameIndex:
    """One entry for each packet, in decoding order.

    stamp: the time stamp by which a packet is found: that of decoding (MP4) or else of presentation. keyframe:
    decoding can start here. shown: False for packets that an edit list cuts away. end_byte: first byte after the
    packet in the file, 0 where unknown. by_dts: whether `stamp` is that of decoding. delay: time from the decoding of
    the first picture to its presentation, for `stamp` of decoding.
    """

    stamp: NDArray[np.int64]
    keyframe: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    end_byte: NDArray[np.int64]
    by_dts: bool
    delay: int = 0

    def begun_at(self, pts: int) -> FrameIndex:
        """Return the index of a clip whose first picture is presented at a time stamp."""
        first = int(np.argmax(self.shown))
        return replace(self, delay=pts - int(self.stamp[first]) if self.by_dts and len(self.stamp) else 0)

    def presentation(self, position: int) -> int:
        """Return the time stamp of presentation of a keyframe, by which containers are sought; it may be late."""
        return int(self.stamp[position]) + self.delay

    def entry_before(self, frame: int) -> int:
        """Return the last frame up to another at which decoding may start."""
        entries = self.entry_points(frame)
        return self.shown_before(entries[0]) if entries else 0

    @property
    def frame_count(self) -> int:
        """Number of frames that are presented."""
        return int(self.shown.sum())

    def shown_before(self, position: int) -> int:
        """Number of presented frames among the packets before `position`."""
        return int(self.shown[:position].sum())

    def entry_points(self, frame: int) -> list[int]:
        """Positions of keyframes at which decoding may start to reach a frame, the nearest first."""
        before = np.concatenate([[0], np.cumsum(self.shown)[:-1]])
        return [int(p) for p in np.flatnonzero(self.keyframe & (before <= frame))[::-1]]

    def position(self, packet: Any) -> int | None:
        """Position of a packet, None where it is not in the index."""
        stamp = packet.dts if self.by_dts else packet.pts
        found = np.flatnonzero(self.stamp == stamp)
        return int(found[0]) if found.size else None

    def complete_frames(self, file_size: int) -> int:
        """Number of frames that a file of this size holds; less than `frame_count` when it is cut short."""
        missing = np.flatnonzero(self.end_byte > file_size)
        return self.shown_before(int(missing[0])) if missing.size else self.frame_count


def has_full_index(container: Any, stream: Any) -> bool:
    """Whether the container lists every packet (an MP4 or MOV that is not fragmented)."""
    return "mp4" in container.format.name and stream.frames > 0 and len(stream.index_entries) > 0


def container_index(stream: Any) -> FrameIndex:
    """Return the index that an MP4 or MOV holds."""
    entries = [(e.timestamp, e.is_keyframe, not e.is_discard, e.pos + e.size) for e in stream.index_entries]
    stamp, keyframe, shown, end = zip(*entries, strict=True)
    return FrameIndex(np.array(stamp), np.array(keyframe, bool), np.array(shown, bool), np.array(end), by_dts=True)


def scanned_index(container: Any, stream: Any) -> FrameIndex:
    """Read all packets of a container that has just been opened, and return their index."""
    packets = [(p.pts, p.is_keyframe, not p.is_discard) for p in container.demux(stream) if p.pts is not None]
    stamp, keyframe, shown = zip(*packets, strict=True) if packets else ((), (), ())
    unknown = np.zeros(len(packets), np.int64)
    return FrameIndex(np.array(stamp, np.int64), np.array(keyframe, bool), np.array(shown, bool), unknown, by_dts=False)


_ANY_TIME = -(1 << 62)
"""A time stamp before all others."""


@dataclass(frozen=True, slots=True)
class StoredPicture:
    """One picture of a file. index: in order of presentation. pts: its time stamp.

    native: the decoder's frame, None where it is lost. reason: of the decoder, where it gave one.
    """

    index: int
    pts: int
    native: Any
    reason: str = ""


def pictures(
    container: Any, stream: Any, index: FrameIndex, start: int, reorder: int | None = None, *, rewound: bool = True
) -> Iterator[StoredPicture]:
    """Yield the pictures of an open file, from one at or before `start` on, lost ones too.

    reorder: most pictures by which decoding runs ahead of presentation; pictures before `start` that no other refers to
    are then left out as if lost. None decodes all. rewound: whether nothing of the file has been read yet.

    After a seek, pictures that are shown before the keyframe but decoded after it (an open group of pictures) count
    as frames before it and are dropped: their references may be missing.
    """
    at_start = start == 0 and rewound
    entry = (_demuxed(container, stream), 0, _ANY_TIME) if at_start else _entry(container, stream, index, start)
    packets, number, first = entry
    announced: list[int] = []
    reason, context = "", stream.codec_context
    needed = number if reorder is None else start - reorder
    for place, packet in enumerate(packets, number):
        context.skip_frame = "NONREF" if place < needed else "DEFAULT"
        if packet.pts is not None and packet.pts >= first and not packet.is_discard:
            heapq.heappush(announced, packet.pts)
        try:
            frames = () if packet.is_corrupt else packet.decode()  # one that is cut short shows half a picture
        except av.error.FFmpegError as error:
            reason = error.strerror or str(error)
            continue
        for frame in frames:
            if frame.pts is None or frame.pts < first:
                continue
            while announced and announced[0] < frame.pts:
                yield StoredPicture(number, heapq.heappop(announced), None, reason)
                number += 1
            if announced and announced[0] == frame.pts:
                heapq.heappop(announced)
            yield StoredPicture(number, frame.pts, frame)
            number += 1
    while announced:
        yield StoredPicture(number, heapq.heappop(announced), None, reason)
        number += 1


def _demuxed(container: Any, stream: Any) -> Iterator[Any]:
    """Yield packets up to where the file cannot be read on: what is missing there shows as lost pictures."""
    try:
        yield from container.demux(stream)
    except av.error.FFmpegError:
        return


def _entry(container: Any, stream: Any, index: FrameIndex, start: int) -> tuple[Iterable[Any], int, int]:
    """Seek so that decoding reaches frame `start`.

    Returns the packets from there on, the number of the first picture, and its time stamp.
    """
    for entry in index.entry_points(start):
        container.seek(index.presentation(entry), stream=stream, backward=True)
        packets = _demuxed(container, stream)
        head: list[Any] = []
        for packet in packets:
            head.append(packet)
            key = head[0]
            if len(head) > 1 and (packet.is_keyframe or packet.pts is None or (packet.dts or 0) >= key.pts):
                break
        position = index.position(head[0]) if head else None
        if position is None or not head[0].is_keyframe:
            continue
        leading = sum(p.pts is not None and p.pts < key.pts and not p.is_discard for p in head)
        number = index.shown_before(position) + leading
        if number <= start:
            return chain(head, packets), number, key.pts
    container.seek(index.presentation(0), stream=stream, backward=True)
    return _demuxed(container, stream), 0, _ANY_TIME
