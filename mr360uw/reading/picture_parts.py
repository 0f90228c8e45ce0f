# SPDX-License-Identifier: Apache-2.0
"""Parts of picture files by their bytes: segments of JPEG, chunks of PNG and WebP, entries of TIFF, and their size."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

JPEG_START, PNG_START, TIFF_STARTS = b"\xff\xd8", b"\x89PNG\r\n\x1a\n", (b"II*\0", b"MM\0*")
JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_MARK, _SCAN, _ALONE = 0xFF, 0xDA, frozenset({0x01, *range(0xD0, 0xD9)})
"""Markers of JPEG (ITU-T T.81, table B.1): those of frames, which hold depth and size; what begins each, that of the
pixels, and those that have no length."""
HDR_SIZE = re.compile(rb"\n([-+])([XY]) +(\d{1,9}) +([-+])([XY]) +(\d{1,9})(?:\r\n|[\r\n])")
"""The line on the size of a Radiance HDR file: sign, axis and number of its rows, and of the samples in one."""
_HDR_HEAD_BYTES = 65536
_SIZE_TAGS = (256, 257)
"""Tags of TIFF: width and height."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) [pixels] of a PNG, JPEG, TIFF, BMP, WebP or Radiance HDR file; None for other bytes."""
    try:
        if data.startswith(PNG_START):
            return struct.unpack_from(">II", data, 16)
        if data.startswith(JPEG_START):
            frame = next((body for marker, body in jpeg_segments(data) if marker in JPEG_FRAMES), b"")
            height, width = struct.unpack_from(">HH", frame, 1)
            return width, height
        if data.startswith(TIFF_STARTS):
            order, entries = tiff_entries(data)
            found = {tag: (order + "HI"[kind != 3], data, at) for tag, kind, at in entries if tag in _SIZE_TAGS}
            sides = [struct.unpack_from(*found[tag])[0] for tag in _SIZE_TAGS if tag in found]
            return (sides[0], sides[1]) if len(sides) == 2 else None
        if data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp_size(*next(riff_chunks(data), (b"", b"")))
    except struct.error:
        return None
    line = HDR_SIZE.search(data, 0, _HDR_HEAD_BYTES) if data.startswith(b"#?") else None
    if line is None or line[2] == line[5]:
        return None
    rows, samples = int(line[3]), int(line[6])
    return (samples, rows) if line[2] == b"Y" else (rows, samples)


def _webp_size(kind: bytes, body: bytes) -> tuple[int, int] | None:
    """Return the size that the first chunk of a WebP file says."""
    if kind == b"VP8X":
        return int.from_bytes(body[4:7], "little") + 1, int.from_bytes(body[7:10], "little") + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", body, 1)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", body, 6)
        return width & 0x3FFF, height & 0x3FFF
    return None


def jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the segments of a JPEG before its pixels, marker and content."""
    at = 2
    while at + 4 <= len(data) and data[at] == _MARK:
        marker = data[at + 1]
        if marker == _SCAN:
            return
        if marker == _MARK or marker in _ALONE:  # fill, or without content
            at += 1 if marker == _MARK else 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield marker, data[at + 4 : at + 2 + length]
        at += 2 + max(length, 2)


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the chunks of a PNG before its pixels, kind and content; none of other files."""
    at = len(PNG_START)
    while data.startswith(PNG_START) and at + 12 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        if kind == b"IDAT":
            return
        yield kind, data[at + 8 : at + 8 + size]
        at += 12 + size


def riff_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the chunks of a WebP file, kind and content."""
    at = 12
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<4sI", data, at)
        yield kind, data[at + 8 : at + 8 + size]
        at += 8 + size + size % 2


def tiff_entries(data: bytes) -> tuple[str, Iterator[tuple[int, int, int]]]:
    """Return the order of bytes of TIFF or EXIF, "<" or ">", and its first directory: tag, type, place of the value.

    Raises `struct.error` where it is cut.
    """
    order = "<" if data.startswith(b"II") else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    starts = range(directory + 2, directory + 2 + 12 * count, 12)
    return order, ((*struct.unpack_from(f"{order}HH", data, start), start + 8) for start in starts)
