# SPDX-License-Identifier: Apache-2.0
"""Sizes of pictures, read from the first bytes of their files, before anything is decoded."""

from __future__ import annotations

import re
import struct

_PNG = b"\x89PNG\r\n\x1a\n"
HDR_SIZE = re.compile(rb"\n([-+])([XY]) +(\d{1,9}) +([-+])([XY]) +(\d{1,9})(?:\r\n|[\r\n])")
"""The line on the size of a Radiance HDR file: sign, axis and number of its rows, and of the samples in one."""
_HDR_HEAD_BYTES = 65536
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})
"""Markers of JPEG (ITU-T T.81, table B.1): those that hold the size, and those that have no length."""
_WIDTH_TAG, _HEIGHT_TAG = 256, 257


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) [pixels] of a PNG, JPEG, TIFF, BMP, WebP or Radiance HDR file; None for other bytes."""
    try:
        if data.startswith(_PNG):
            return struct.unpack_from(">II", data, 16)
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith((b"II*\0", b"MM\0*")):
            return _tiff(data)
        if data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp(data)
    except struct.error:
        return None
    found = HDR_SIZE.search(data, 0, _HDR_HEAD_BYTES) if data.startswith(b"#?") else None
    if found is None or found[2] == found[5]:
        return None
    rows, samples = int(found[3]), int(found[6])
    return (samples, rows) if found[2] == b"Y" else (rows, samples)


def _jpeg(data: bytes) -> tuple[int, int] | None:
    offset = 2
    while True:
        mark, kind = struct.unpack_from(">BB", data, offset)
        if mark != 0xFF:
            return None
        if kind == 0xFF:  # fill
            offset += 1
        elif kind in _ALONE:
            offset += 2
        elif kind in _FRAME_HEADERS:
            height, width = struct.unpack_from(">HH", data, offset + 5)
            return width, height
        else:
            offset += 2 + max(struct.unpack_from(">H", data, offset + 2)[0], 2)


def _tiff(data: bytes) -> tuple[int, int] | None:
    order = "<" if data.startswith(b"II") else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    found: dict[int, int] = {}
    for entry in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, directory + 2 + 12 * entry)
        if tag in (_WIDTH_TAG, _HEIGHT_TAG):
            form = "H" if kind == 3 else "I"
            (found[tag],) = struct.unpack_from(f"{order}{form}", data, directory + 10 + 12 * entry)
    return (found[_WIDTH_TAG], found[_HEIGHT_TAG]) if len(found) == 2 else None


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8X":
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None
