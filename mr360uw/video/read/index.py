# SPDX-License-Identifier: Apache-2.0
"""Frame index of a video stream: its packets in decoding order, with time stamps and keyframes.

Frames are numbered in order of presentation. MP4 and MOV hold an index of all packets; packets that an edit list
cuts away are marked and do not count. Other containers are read through once (packets only, nothing is decoded).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

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
