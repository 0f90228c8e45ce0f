# SPDX-License-Identifier: Apache-2.0
"""Reads and writes OpenEXR pictures: RGB plates, maps, layered results.

A file is checked before it is decoded: the sizes that it announces, and whether all of its chunks are there. The
library prints a line for every chunk that it misses, and takes memory for pictures that are not there. Layout of the
file: the technical introduction and the file layout of openexr.com.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import VideoError
from mr360uw.files import NewFile, whole_file
from mr360uw.reading.input_files import unreadable
from mr360uw.reading.limits import DATA, PICTURE
from mr360uw.shapes import checked
from mr360uw.types import Floats

_MAGIC = 20000630
_TILED, _DEEP, _MULTIPART = 0x200, 0x800, 0x1000
_HEAD_BYTES = 1 << 20
"""Longest header that is read; that of a picture with a preview has some thousands."""
_SAMPLE_BYTES = 4
_ROWS = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
"""Rows in a chunk for each compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB."""


@dataclass(frozen=True, slots=True)
class ExrPart:
    """Size of a part's data window and names of its channels.

    chunks: their number (0: not known), tiled: whether they are tiles. whole: whether the data window is the frame.
    """

    width: int
    height: int
    channels: tuple[str, ...]
    chunks: int
    tiled: bool
    deep: bool
    whole: bool


def check_exr(path: Path) -> list[ExrPart]:
    """Return a file's parts; raise `VideoError` where it is no EXR, too large, cut short, or holds deep samples."""
    if reason := unreadable(path):
        raise VideoError(f"{path} - {reason}")
    try:
        with path.open("rb") as file:
            parts, table = _parts(file.read(_HEAD_BYTES))
            _check_sizes(path, parts)
            if not _complete(file, parts, table):
                raise VideoError(f"{path} - is cut short or damaged (chunks are missing) - copy or write it again")
            return parts
    except (struct.error, ValueError, KeyError, OSError) as error:
        what = getattr(error, "strerror", None) or "a broken header"
        raise VideoError(f"{path} - is not an EXR file that can be read (got {what}) - write it again") from error


def _check_sizes(path: Path, parts: list[ExrPart]) -> None:
    for part in parts:
        if part.deep:
            raise VideoError(f"{path} - holds deep samples, several to a pixel - write it flattened")
        PICTURE.check(str(path), part.width * part.height, VideoError)
    unpacked = sum(part.width * part.height * len(part.channels) for part in parts) * _SAMPLE_BYTES
    DATA.check(str(path), unpacked, VideoError)


def _parts(head: bytes) -> tuple[list[ExrPart], int]:
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


def _part(attributes: dict[bytes, bytes], version: int) -> ExrPart:
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
    whole = attributes.get(b"displayWindow", attributes[b"dataWindow"]) == attributes[b"dataWindow"]
    return ExrPart(width, height, _channels(attributes[b"channels"]), chunks, tiled, deep, whole)


def _channels(data: bytes) -> tuple[str, ...]:
    """Return the names of channels in a list of them: a name, and 16 bytes about it."""
    names, at = [], 0
    while data[at : at + 1] != b"\0":
        end = data.index(b"\0", at)
        names.append(data[at:end].decode("utf-8", "replace"))
        at = end + 17
    return tuple(names)


def _complete(file: BinaryIO, parts: list[ExrPart], table: int) -> bool:
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


REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""x, y of red, green, blue and white (ITU-R BT.709-6): the primaries of all linear light here."""
Compression = Literal["none", "zips", "zip", "piz", "dwaa", "dwab"]
Part = Mapping[str, NDArray[Any]]
"""Channels by name, float16, float32 or uint32: "RGB" or "RGBA" (H, W, 3 or 4), "Z" or "N.X" (H, W); an array (H, W, 3)
of another name, as "diffuse", is diffuse.R, diffuse.G, diffuse.B in the file."""


@checked
def read_exr(path: str | Path) -> dict[str, dict[str, NDArray[Any]]]:
    """Return the channels of all parts, {part: {channel: array}}, as they are stored (negative samples too).

    A part without a name is called by its number. Channels R, G, B, (A) of a layer come as one array (H, W, 3 or 4)
    called "RGB" or "RGBA", or by the layer's name. Raises `VideoError`.
    """
    import OpenEXR

    path = Path(path)
    check_exr(path)
    try:
        file = OpenEXR.File(str(path))
    except (RuntimeError, ValueError, TypeError, IndexError, OSError) as error:
        raise VideoError(f"{path} - is not an EXR file that can be read (got {error}) - write it again") from error
    with file:
        if not file.parts or not all(part.channels for part in file.parts):
            raise VideoError(f"{path} - is damaged (its pixels cannot be read) - copy or write it again")
        return {
            part.name() or str(number): {name: channel.pixels for name, channel in part.channels.items()}
            for number, part in enumerate(file.parts)
        }


@checked
def read_rgb(path: str | Path, *, depth: bool = False) -> NDArray[np.float32]:
    """Return the colour of an EXR's first part as linear RGB, (H, W, 3) float32, alpha left out.

    depth: rather the channel Z of any part, three times, where there is one.
    """
    parts = read_exr(path)
    found = next((channels["Z"] for channels in parts.values() if "Z" in channels), None) if depth else None
    if found is not None:
        return np.repeat(np.asarray(found, np.float32)[..., None], 3, axis=-1)
    channels = next(iter(parts.values()))
    for name in ("RGBA", "RGB"):
        if name in channels:
            return np.ascontiguousarray(channels[name][..., :3], np.float32)
    if "Y" in channels:
        return np.repeat(np.asarray(channels["Y"], np.float32)[..., None], 3, axis=-1)
    raise VideoError(f"{path} - has no colour channels R, G, B (got {', '.join(sorted(channels))}) - write them")


def _checked(where: str, values: Any) -> NDArray[Any]:
    """Return a channel as a contiguous array; raise `VideoError` where it is no picture."""
    array = np.asarray(values)
    if array.dtype not in (np.float16, np.float32, np.uint32) or array.ndim not in (2, 3) or not array.size:
        raise VideoError(
            f"{where} - is no picture (got {array.dtype}, {array.shape}) - give float16, float32 or uint32, "
            "(H, W) or (H, W, 3)"
        )
    return np.ascontiguousarray(array)


def frame_attributes(index: int, frame_rate: Fraction, timecode: str = "") -> dict[str, Any]:
    """Return the header entries of a frame of a clip: frameNumber, framesPerSecond and timeCode.

    timecode: "hh:mm:ss:ff" of the frame, with ";" for drop frames; without one it is counted from 0 at frame 0. The
    entry holds frames up to 59: of faster clips it is left out.
    """
    import OpenEXR

    rate = frame_rate.limit_denominator(1001)
    found: dict[str, Any] = {"frameNumber": index, "framesPerSecond": rate}
    base = round(rate)
    if not 1 <= base <= _MOST_FRAMES or index < 0:
        return found
    seconds, frame = divmod(index, base)
    counted = f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{frame:02d}"
    told = timecode or counted
    numbers = [int(told[at : at + 2]) for at in (0, 3, 6, 9)]
    drop = told[8] == ";"
    return {**found, "timeCode": OpenEXR.TimeCode(*numbers, drop, *[0] * 13)}


_MOST_FRAMES = 60
"""Frames a second that a time code counts (SMPTE ST 12-1)."""


@checked
def write_exr(
    path: str | Path,
    parts: Mapping[str, Part] | Floats,
    *,
    latlong: bool = True,
    compression: Compression = "zip",
    full_size: tuple[int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    attributes: Mapping[str, Any] | None = None,
    views: Mapping[str, str] | None = None,
    file: NewFile = whole_file,
) -> None:
    """Write one or more parts as an OpenEXR file, by a temporary name and a rename.

    parts: {part: {channel: array}}, or one linear image (H, W, 3 or 4). float16 channels are stored as half, float32
    as float. latlong: mark it as a latitude-longitude environment map. full_size: (width, height) of the frame
    that the arrays are a window of, whose top left pixel is `origin` = (column, row); by default the arrays are the
    frame. attributes: more header entries (numbers, strings). views: of parts that show
    what one eye sees, "left" or "right". file: opens the temporary file.
    """
    import OpenEXR

    path = Path(path)
    if isinstance(parts, Mapping):
        image_parts: Mapping[str, Part] = parts
    else:
        image = np.asarray(parts)
        image_parts = {"": {"RGBA"[: image.shape[-1] if image.ndim == 3 else 1]: image}}
    if not (image_parts and all(image_parts.values())):
        raise VideoError(f"{path} - has no channels (got none) - give an array for each")
    kind = "NO" if compression == "none" else compression.upper()
    header: dict[str, Any] = {
        "compression": getattr(OpenEXR, f"{kind}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709,
        **(attributes or {}),
    }
    if latlong:
        header["envmap"] = OpenEXR.ENVMAP_LATLONG
    made = []
    for name, channels in image_parts.items():
        arrays = {channel: _checked(f"{path} {channel}", array) for channel, array in channels.items()}
        height, width = next(iter(arrays.values())).shape[:2]
        own = dict(header)
        if views is not None and name in views:
            own["view"] = views[name]
        if full_size is not None:
            column, row = origin
            low = np.array([column, row], np.int32)
            own["dataWindow"] = (low, low + np.array([width - 1, height - 1], np.int32))
            own["displayWindow"] = (np.zeros(2, np.int32), np.array(full_size, np.int32) - 1)
        made.append(OpenEXR.Part(own, arrays, name) if name else OpenEXR.Part(own, arrays))
    try:
        with file(path) as part:
            OpenEXR.File(made).write(str(part))
    except (RuntimeError, ValueError, OSError) as error:
        raise VideoError(
            f"{path} - cannot be written (got {error}) - check the folder, its rights and the space"
        ) from error
