# SPDX-License-Identifier: Apache-2.0
"""Reads and edits the 'moov' box of MP4 and QuickTime files (ISO/IEC 14496-12)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mr360uw.errors import VideoError

_CONTAINERS = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"sv3d", b"proj"}
_SAMPLE_ENTRY_HEAD = 78  # bytes of a VisualSampleEntry before its child boxes
_TAGS, _CHAPTERS = (b"udta", b"meta"), b"chpl"
_DEEPEST = 32
"""Most boxes within each other; a file of a camera has ten."""
_COPY_BYTES = 1 << 23
_OFFSET_LIMIT = 1 << 32


@dataclass(slots=True)
class Box:
    """A box: its four-letter kind, its payload up to the first child, and its children."""

    kind: bytes
    payload: bytes = b""
    children: list[Box] = field(default_factory=list)

    def find(self, *path: bytes) -> Box | None:
        """Return the first descendant on a path of kinds."""
        box: Box | None = self
        for kind in path:
            box = next((child for child in box.children if child.kind == kind), None) if box else None
        return box

    def serialised(self) -> bytes:
        """Return the bytes of the box."""
        body = self.payload + b"".join(child.serialised() for child in self.children)
        if len(body) + 8 < _OFFSET_LIMIT:
            return struct.pack(">I4s", len(body) + 8, self.kind) + body
        return struct.pack(">I4sQ", 1, self.kind, len(body) + 16) + body


_Extent = tuple[bytes, int, int]
"""A top-level box in the file: kind, offset, size."""


def _header(data: bytes, available: int) -> tuple[bytes, int, int] | None:
    """Return (kind, size of the header, size of the box), None where the bytes are no box."""
    if len(data) < 8:
        return None
    size, kind = struct.unpack_from(">I4s", data)
    if size == 1 and len(data) >= 16:
        return kind, 16, struct.unpack_from(">Q", data, 8)[0]
    if size == 0:
        return kind, 8, available
    return (kind, 8, size) if size >= 8 else None


def _extents(file: BinaryIO) -> Iterator[_Extent]:
    end = file.seek(0, 2)
    offset = 0
    while offset < end:
        file.seek(offset)
        header = _header(file.read(16), end - offset)
        if header is None:
            return
        yield header[0], offset, header[2]
        offset += header[2]


def cut_short(path: Path) -> str:
    """Return in what way an MP4 or QuickTime file ends early, in words; "" where it does not, or is another kind."""
    with path.open("rb") as file:
        extents = list(_extents(file))
        size = file.seek(0, 2)
    if not extents or extents[0][0] not in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
        return ""
    kind, offset, length = extents[-1]
    missing = offset + length - size
    if missing > 0 and kind != b"mdat":
        return f"its '{kind.decode('latin-1')}' index is incomplete"
    if all(kind != b"moov" for kind, _, _ in extents):
        return "it has no 'moov' index"
    return f"{missing} bytes are missing" if missing > 0 else ""


def parse_boxes(data: bytes) -> list[Box]:
    """Return the boxes in some bytes; containers and video sample entries are parsed into children."""
    boxes, rest = _split(data)
    if rest:
        raise ValueError("not a sequence of boxes")
    return boxes


def _split(data: bytes, depth: int = 0) -> tuple[list[Box], bytes]:
    boxes: list[Box] = []
    if depth > _DEEPEST:
        return boxes, data
    offset = 0
    while offset < len(data):
        header = _header(data[offset : offset + 16], len(data) - offset)
        if header is None or offset + header[2] > len(data):
            break
        kind, head, size = header
        boxes.append(_box(kind, data[offset + head : offset + size], depth))
        offset += size
    return boxes, data[offset:]


def _box(kind: bytes, body: bytes, depth: int) -> Box:
    """Return a box; its children are left in its payload where they are no boxes, or too deep."""
    head = 8 if kind == b"stsd" else 0
    if kind in _CONTAINERS or kind == b"stsd":
        children, rest = _split(body[head:], depth + 1)
        if not rest:
            return Box(kind, body[:head], children)
    return Box(kind, body)


def video_track(moov: Box) -> Box | None:
    """Return the first track whose handler is video."""
    for track in moov.children:
        handler = track.find(b"mdia", b"hdlr")
        if track.kind == b"trak" and handler is not None and handler.payload[8:12] == b"vide":
            return track
    return None


def sample_entries(track: Box) -> list[Box]:
    """Return a video track's sample entries with their child boxes parsed, in place."""
    table = track.find(b"mdia", b"minf", b"stbl", b"stsd")
    entries = table.children if table is not None else []
    for entry in entries:
        if not entry.children:
            children, rest = _split(entry.payload[_SAMPLE_ENTRY_HEAD:])
            if rest in (b"", bytes(4)):  # QuickTime may end the entry with four zero bytes
                entry.payload, entry.children = entry.payload[:_SAMPLE_ENTRY_HEAD], children
    return entries


def read_moov(path: Path) -> Box | None:
    """Return the parsed 'moov' box of a file, None where it has none."""
    with path.open("rb") as file:
        for extent in _extents(file):
            if extent[0] == b"moov":
                return _read_moov(file, extent)
    return None


def _read_moov(file: BinaryIO, extent: _Extent) -> Box | None:
    _, offset, size = extent
    file.seek(offset)
    boxes, _ = _split(file.read(size))
    return boxes[0] if boxes and boxes[0].children else None


def carry_tags(moov: Box, source: Box) -> None:
    """Put the tags of a file ('udta' and 'meta' of its movie) into another one's index, byte for byte.

    Cameras and phones keep there what no muxer has names for. Chapters ('chpl') stay those of the file that is written.
    """
    tags = [box for box in source.children if box.kind in _TAGS]
    if not tags:
        return
    own = [
        box for old in moov.children if old.kind == b"udta" for box in _split(old.payload)[0] if box.kind == _CHAPTERS
    ]
    if own and all(box.kind != b"udta" for box in tags):
        tags.append(Box(b"udta"))
    moov.children = [box for box in moov.children if box.kind not in _TAGS] + [_with_chapters(box, own) for box in tags]


def _with_chapters(tags: Box, chapters: list[Box]) -> Box:
    """Return tags with other chapters; as they are where they are no boxes, which QuickTime may end with four zeros."""
    boxes, rest = _split(tags.payload)
    if tags.kind != b"udta" or rest not in (b"", bytes(4)):
        return tags
    return Box(tags.kind, children=[box for box in boxes if box.kind != _CHAPTERS] + chapters)


def edit_moov(path: Path, edit: Callable[[Box], None], front: bool = False) -> None:
    """Change the 'moov' box of a file in place; the media data move as needed and all chunk offsets follow.

    edit: changes the parsed box. front: also move it before the media data, so that players can start while loading.
    Interrupted half way the file is broken: work on a copy. VideoError where the file is fragmented or has no 'moov'.
    """
    with path.open("r+b") as file:
        extents = list(_extents(file))
        index = next((i for i, extent in enumerate(extents) if extent[0] == b"moov"), None)
        moov = _read_moov(file, extents[index]) if index is not None else None
        if index is None or moov is None:
            raise VideoError(f"{path} - is not an mp4 or mov file with an index - remux it to mp4")
        if moov.find(b"mvex") or any(kind == b"moof" for kind, _, _ in extents):
            raise VideoError(f"{path} - is a fragmented mp4, its index cannot be edited - remux it to a plain mp4")
        edit(moov)
        old = extents[index]
        target = old[1]
        if front:
            target = min([*(offset for kind, offset, _ in extents if kind == b"mdat"), target])
        _replace(file, old, target, moov)


def _replace(file: BinaryIO, old: _Extent, target: int, moov: Box) -> None:
    """Take away the box at `old` and put the new one at `target`, not after it."""
    size, (_, old_offset, old_size) = len(moov.serialised()), old
    old_end = old_offset + old_size

    def moved(offsets: np.ndarray) -> np.ndarray:
        between = np.where((offsets >= target) & (offsets < old_offset), size, 0)
        return offsets + np.where(offsets >= old_end, size - old_size, between)

    shifted = _with_offsets(moov, moved, wide=False)
    if shifted is None:  # an offset no longer fits in 32 bits: 64-bit tables make the box larger
        size = len(_with_offsets(moov, lambda offsets: offsets, wide=True).serialised())  # type: ignore[union-attr]
        shifted = _with_offsets(moov, moved, wide=True)
    assert shifted is not None
    end = file.seek(0, 2)
    if size >= old_size:
        _move(file, old_end, end, size - old_size)
        _move(file, target, old_offset, size)
    else:
        _move(file, target, old_offset, size)
        _move(file, old_end, end, size - old_size)
    file.seek(target)
    file.write(shifted.serialised())
    file.truncate(end + size - old_size)


def _with_offsets(box: Box, moved: Callable[[np.ndarray], np.ndarray], wide: bool) -> Box | None:
    """Return a copy of the tree with all chunk offsets moved; None where one does not fit in 32 bits unless `wide`."""
    if box.kind in (b"stco", b"co64"):
        offsets = moved(np.frombuffer(box.payload[8:], ">u4" if box.kind == b"stco" else ">u8").astype(np.int64))
        if box.kind == b"co64" or wide:
            return Box(b"co64", box.payload[:8] + offsets.astype(">u8").tobytes())
        if offsets.size and offsets.max() >= _OFFSET_LIMIT:
            return None
        return Box(b"stco", box.payload[:8] + offsets.astype(">u4").tobytes())
    children = [_with_offsets(child, moved, wide) for child in box.children]
    if any(child is None for child in children):
        return None
    return Box(box.kind, box.payload, [child for child in children if child is not None])


def _move(file: BinaryIO, start: int, stop: int, shift: int) -> None:
    """Move the bytes [start, stop) of a file by `shift`, in pieces, in the order that overwrites nothing unread."""
    if not shift:
        return
    pieces = range(start, stop, _COPY_BYTES)
    for piece in reversed(pieces) if shift > 0 else pieces:
        file.seek(piece)
        data = file.read(min(_COPY_BYTES, stop - piece))
        file.seek(piece + shift)
        file.write(data)
