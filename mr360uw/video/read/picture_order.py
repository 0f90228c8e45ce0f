# SPDX-License-Identifier: Apache-2.0
"""Decodes the pictures of a video file in order of presentation, and tells which of them are lost.

Every packet that is to be shown announces a time stamp. Decoders hand out pictures in the order of these stamps, so a
stamp that is passed over is a picture that could not be decoded, whether the decoder reported an error or not.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

import av.error

from mr360uw.video.read.index import FrameIndex

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
