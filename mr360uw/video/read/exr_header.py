# SPDX-License-Identifier: Apache-2.0
"""Checks an OpenEXR file before it is decoded: the sizes that it announces, and whether all of its chunks are there.

Layout of the file: the technical introduction and the file layout of openexr.com. The library prints a line for every
chunk that it misses, and takes memory for pictures that are not there.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mr360uw.errors import VideoError
from mr360uw.reading.input_files import unreadable
from mr360uw.reading.limits import DATA, PICTURE

_MAGIC = 20000630
_TILED, _DEEP, _MULTIPART = 0x200, 0x800, 0x1000
_HEAD_BYTES = 1 << 20
"""Longest header that is read; that of a picture with a preview has some thousands."""
_SAMPLE_BYTES = 4
_ROWS = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
"""Rows in a chunk for each compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB."""


@dataclass(frozen=True, slots=True)
class _Part:
    """Size of a part's data window, and its chunks: their number (0: not known), and whether they are tiles."""

    width: int
    height: int
    channels: int
    chunks: int
    tiled: bool
    deep: bool


def check_exr(path: Path) -> None:
    """Raise `VideoError` where a file is no EXR, too large, cut short, or holds deep samples."""
    if reason := unreadable(path):
        raise VideoError(f"{path} - {reason}")
    try:
        with path.open("rb") as file:
            parts, table = _parts(file.read(_HEAD_BYTES))
            _check_sizes(path, parts)
            if not _complete(file, parts, table):
                raise VideoError(f"{path} - is cut short or damaged (chunks are missing) - copy or write it again")
    except (struct.error, ValueError, KeyError, OSError) as error:
        what = getattr(error, "strerror", None) or "a broken header"
        raise VideoError(f"{path} - is not an EXR file that can be read (got {what}) - write it again") from error


def _check_sizes(path: Path, parts: list[_Part]) -> None:
    for part in parts:
        if part.deep:
            raise VideoError(f"{path} - holds deep samples, several to a pixel - write it flattened")
        PICTURE.check(str(path), part.width * part.height, VideoError)
    unpacked = sum(part.width * part.height * part.channels for part in parts) * _SAMPLE_BYTES
    DATA.check(str(path), unpacked, VideoError)


def _parts(head: bytes) -> tuple[list[_Part], int]:
    """Return the parts of a file, and where the table of their chunks begins."""
    magic, version = struct.unpack_from("<II", head)
    if magic != _MAGIC:
        raise ValueError("no EXR")
    parts, at = [], 8
    while True:
        attributes, at = _attributes(head, at)
        if attributes:
            parts.append(_part(attributes, version))
        if not (attributes and version & _MULTIPART):
            return parts, at


def _attributes(head: bytes, at: int) -> tuple[dict[bytes, bytes], int]:
    """Return the attributes of a header by name, and where it ends."""
    found = {}
    while head[at : at + 1] != b"\0":
        name, _, rest = head[at : at + 512].partition(b"\0")
        kind, _, _ = rest.partition(b"\0")
        at += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<I", head, at)
        found[name] = head[at + 4 : at + 4 + size]
        at += 4 + size
        if at >= len(head):
            raise ValueError("a header without end")
    return found, at + 1


def _part(attributes: dict[bytes, bytes], version: int) -> _Part:
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if width < 1 or height < 1:
        raise ValueError("an empty picture")
    kind = attributes.get(b"type", b"").rstrip(b"\0")
    tiled = kind == b"tiledimage" or (not kind and bool(version & _TILED))
    rows = _ROWS.get(attributes[b"compression"][0], 0) if not tiled else 0
    chunks = -(-height // rows) if rows else 0
    if b"chunkCount" in attributes:
        (chunks,) = struct.unpack("<i", attributes[b"chunkCount"])
    deep = kind.startswith(b"deep") or bool(version & _DEEP)
    return _Part(width, height, _channels(attributes[b"channels"]), chunks, tiled, deep)


def _channels(data: bytes) -> int:
    """Return the number of channels in a list of them: a name, and 16 bytes about it."""
    count, at = 0, 0
    while data[at : at + 1] != b"\0":
        at = data.index(b"\0", at) + 17
        count += 1
    return count


def _complete(file: BinaryIO, parts: list[_Part], table: int) -> bool:
    """Return whether every chunk begins, and the last one ends, within the file; True where they are not counted."""
    count = sum(part.chunks for part in parts)
    if any(part.chunks < 1 for part in parts):
        return True
    end = file.seek(0, 2)
    if table + 8 * count > end:
        return False
    file.seek(table)
    offsets = np.frombuffer(file.read(8 * count), "<u8")
    last = int(offsets.max())
    if offsets.min() < table + 8 * count or last + 12 > end:
        return False
    if any(part.tiled for part in parts):
        return True
    file.seek(last + (4 if len(parts) > 1 else 0))
    _, size = struct.unpack("<ii", file.read(8))
    return 0 <= size <= end - file.tell()
