# SPDX-License-Identifier: Apache-2.0
"""Marks of spatial audio in MP4 and QuickTime files: how the channels of a track are ambisonics.

SA3D says the order and how channels are sorted, SAND that two more are head-locked stereo (Google, "Spatial Audio
RFC"). Players take a track of four channels for loudspeakers without them; FFmpeg does not copy them.
"""

from __future__ import annotations

import struct
from pathlib import Path

from mr360uw.video.metadata.mp4 import Box, parse_boxes, read_moov

_MARKS = (b"SA3D", b"SAND")
_ENTRY_HEADS = {0: 28, 1: 44, 2: 64}
"""Bytes of an audio sample entry before its boxes, by version (ISO/IEC 14496-12; QuickTime File Format: 1 and 2)."""
_VERSION_AT = 8


def read_spatial(path: Path) -> tuple[bytes, ...]:
    """Return the marks of each audio track of a file, as the bytes of their boxes; b"" for a track without."""
    moov = read_moov(path)
    return () if moov is None else tuple(_marks(entry) for entry in _audio_entries(moov))


def embed_spatial(moov: Box, marks: tuple[bytes, ...]) -> None:
    """Put the marks of each audio track into a parsed 'moov' box that has the same tracks, where it has none."""
    for entry, mark in zip(_audio_entries(moov), marks, strict=False):
        if mark and not _marks(entry):
            entry.payload += mark


def _audio_entries(moov: Box) -> list[Box]:
    """Return the first sample entry of each audio track."""
    found = []
    for track in moov.children:
        handler, table = track.find(b"mdia", b"hdlr"), track.find(b"mdia", b"minf", b"stbl", b"stsd")
        sounds = track.kind == b"trak" and handler is not None and handler.payload[8:12] == b"soun"
        if sounds and table is not None and table.children:
            found.append(table.children[0])
    return found


def _marks(entry: Box) -> bytes:
    """Return the marks in an audio sample entry."""
    if len(entry.payload) < _ENTRY_HEADS[0]:
        return b""
    head = _ENTRY_HEADS.get(struct.unpack_from(">H", entry.payload, _VERSION_AT)[0], len(entry.payload))
    try:
        boxes = parse_boxes(entry.payload[head:])
    except ValueError:
        return b""
    return b"".join(box.serialised() for box in boxes if box.kind in _MARKS)
