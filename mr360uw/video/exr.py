# SPDX-License-Identifier: Apache-2.0
"""Reads and writes OpenEXR pictures: RGB plates, maps, layered results.

A file is checked before it is decoded: the sizes that it announces, and whether all of its chunks are there. The
library prints a line for every chunk that it misses, and takes memory for pictures that are not there. Layout of the
file: the technical introduction and the file layout of openexr.com.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import LUMINANCE, REC709_XY, XY_BY_NAME
from mr360uw.base.files import NewFile, whole_file, writing
from mr360uw.base.input_files import DATA, PICTURE, unreadable, wrapped
from mr360uw.base.parameters import checked
from mr360uw.errors import VideoError
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
    """A part's windows and the names of its channels.

    data, display: (left, top, right, bottom) of the pixels that are there and of the frame, the last ones included.
    chunks: their number (0: not known), tiled: whether they are tiles. levels: whether smaller copies follow.
    """

    data: tuple[int, int, int, int]
    display: tuple[int, int, int, int]
    channels: tuple[str, ...]
    chunks: int
    tiled: bool
    levels: bool
    deep: bool

    @property
    def width(self) -> int:
        """Columns of the data window."""
        return self.data[2] - self.data[0] + 1

    @property
    def height(self) -> int:
        """Rows of the data window."""
        return self.data[3] - self.data[1] + 1

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height of the display window."""
        return self.display[2] - self.display[0] + 1, self.display[3] - self.display[1] + 1

    @property
    def whole(self) -> bool:
        """Whether the data window is the frame."""
        return self.data == self.display


def check_exr(path: Path) -> list[ExrPart]:
    """Return a file's parts; raise `VideoError` where it is no EXR, too large, cut short, or holds deep samples."""
    if reason := unreadable(path):
        raise VideoError(f"{path} - {reason}")
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
            if why := wrapped(head):
                raise VideoError(f"{path} - {why}")
            parts, table = _parts(head)
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
        PICTURE.check(str(path), part.frame_size[0] * part.frame_size[1], VideoError)
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
    data, display = (
        struct.unpack("<4i", attributes.get(name, attributes[b"dataWindow"]))
        for name in (b"dataWindow", b"displayWindow")
    )
    if any(right < left or bottom < top for left, top, right, bottom in (data, display)):
        raise ValueError("an empty picture")
    kind = attributes.get(b"type", b"").rstrip(b"\0")
    tiled = kind == b"tiledimage" or (not kind and bool(version & _TILED))
    rows = _ROWS.get(attributes[b"compression"][0], 0) if not tiled else 0
    chunks = -(-(data[3] - data[1] + 1) // rows) if rows else 0
    if b"chunkCount" in attributes:
        (chunks,) = struct.unpack("<i", attributes[b"chunkCount"])
    deep = kind.startswith(b"deep") or bool(version & _DEEP)
    levels = bool(attributes.get(b"tiles", bytes(9))[-1] & 0xF)
    return ExrPart(data, display, _channels(attributes[b"channels"]), chunks, tiled, levels, deep)


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


Part = Mapping[str, NDArray[Any]]
"""Channels by name, float16, float32 or uint32: "RGB" or "RGBA" (H, W, 3 or 4), "Z" or "N.X" (H, W); an array (H, W, 3)
of another name, as "diffuse", is diffuse.R, diffuse.G, diffuse.B in the file."""


@checked
def read_exr(path: str | Path) -> dict[str, dict[str, NDArray[Any]]]:
    """Return the channels of all parts, {part: {channel: array}}, as they are stored (negative samples too).

    A part without a name is called by its number. Channels R, G, B, (A) of a layer come as one array (H, W, 3 or 4)
    called "RGB" or "RGBA", or by the layer's name. Raises `VideoError`.
    """
    path = Path(path)
    check_exr(path)
    with _opened(path) as file:
        return {
            part.name() or str(number): {name: channel.pixels for name, channel in part.channels.items()}
            for number, part in enumerate(file.parts)
        }


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Yield OpenEXR's file of a path that was checked; `VideoError` where it is damaged."""
    import OpenEXR

    try:
        file = OpenEXR.File(str(path))
    except (RuntimeError, ValueError, TypeError, IndexError, OSError) as error:
        raise VideoError(f"{path} - is not an EXR file that can be read (got {error}) - write it again") from error
    with file:
        if not file.parts or not all(part.channels for part in file.parts):
            raise VideoError(f"{path} - is damaged (its pixels cannot be read) - copy or write it again")
        yield file


def primaries_of(path: Path) -> tuple[float, ...]:
    """Return the chromaticities that an EXR states, x and y of red, green, blue and white; Rec.709's without."""
    with _opened(path) as file:
        return tuple(round(float(one), 6) for one in file.parts[0].header.get("chromaticities", REC709_XY))


Wanted = Literal["colour", "depth", "matte"]
"""What of a picture is read: its colours, its distances where it has some (channel Z), or colours and alpha alike."""


ExrFrame = tuple[NDArray[np.float32], tuple[float, ...], Mapping[str, Any], tuple[str, ...]]


def read_frame(path: Path, wanted: Wanted = "colour") -> ExrFrame:
    """Return an EXR's frame; raise `VideoError` where it has no such channels.

    These are its display window, (H, W, 3) or, of mattes with alpha, (H, W, 4) float32 as stored, black where there is
    no pixel; chromaticities, empty where the file states none; header entries that outputs keep; and what is there and
    is not used, one line each.
    """
    parts = check_exr(path)
    with _opened(path) as file:
        # Take Z or the best layer of colours, of the first part that has it
        layers = [one for number, part in enumerate(file.parts) for one in _layers(number, part, wanted)]
        if not layers:
            names = sorted({name for part in parts for name in part.channels})
            raise VideoError(f"{path} - has no colour channels R, G, B (got {', '.join(names)}) - write them")
        _, number, taken, channels = min(layers, key=lambda one: one[0])
        part, header = parts[number], file.parts[number].header
        # Place the data window in the display window
        planes = [np.asarray(one, np.float32) for one in channels]
        joined = planes[0] if planes[0].ndim == 3 else np.stack(planes, axis=-1)
        array = _in_frame(joined if joined.shape[-1] > 2 else np.repeat(joined[..., :1], 3, axis=-1), part)
        stated = header.get("chromaticities", XY_BY_NAME.get(_named_colours(header), ()))
        xy = tuple(map(float, stated)) if isinstance(stated, Iterable) else ()  # else of a type that is not known
        kept = {name: value for name, value in header.items() if _is_carried(name, value)}
        others = [name for name in _names(file.parts) if name != taken]
        # A closed file has no header any more
        alphas = [a for name, a in _alphas(file.parts[number]) if name.rpartition(".")[0] in (taken, "")]
        clear = any(bool((alpha < _OPAQUE).any()) for alpha in alphas)
        notes = tuple(_frame_notes(path, part, header, taken, others, clear=clear)) if wanted == "colour" else ()
    return array, xy if len(xy) == 8 else (), kept, notes


_OPAQUE = 0.999


def _named_colours(header: Mapping[str, Any]) -> str:
    """Return the space that a header names instead of chromaticities, "" for none."""
    if header.get("acesImageContainerFlag") == 1:
        return "ap0"
    said = str(header.get("colorInteropID", header.get("oiio:ColorSpace", ""))).lower()
    said = {"acescg": "ap1", "aces2065-1": "ap0", "linear": "rec709", "scene_linear": ""}.get(said, said)
    return said.removeprefix("lin_").removesuffix("_scene").removesuffix("_display")


def _alphas(part: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the alpha channels of a part, with the names of these or of the colours that they are joined to."""
    for name, channel in part.channels.items():
        if channel.pixels.ndim == 3 and channel.pixels.shape[-1] == 4:
            yield f"{name.removesuffix('RGBA').rstrip('.')}.A", channel.pixels[..., 3]
        elif name.rpartition(".")[2].lower() in ("a", "alpha"):
            yield name, channel.pixels


_BEST = ("", "combined", "rgba", "rgb", "beauty", "c", "color", "colour", "main", "default", "composite", "final")
"""Names of the layer of the picture itself in files of several, the most likely first: of the file, Blender, Nuke,
Arnold and others."""
_RGBA_NAMES = (("R", "G", "B", "A"), ("r", "g", "b", "a"), ("red", "green", "blue", "alpha"))


_Layer = tuple[tuple[bool, int], int, str, tuple[NDArray[Any], ...]]
"""A layer: its rank, the least of the most wanted one; number of its part; full name; and channels, (h, w, 3 or 4) or
several (h, w)."""


def _layer(number: int, names: tuple[str, ...], *channels: NDArray[Any], distances: bool = False) -> _Layer:
    """Return a layer of a part. names: of parts and layers around it. distances: whether it is channel Z."""
    name = ".".join(filter(None, names))
    last = name.lower().rpartition(".")[2]
    return (not distances, _BEST.index(last) if last in _BEST else len(_BEST)), number, name, channels


def _layers(number: int, part: Any, wanted: Wanted) -> Iterator[_Layer]:
    """Yield the layers of a part that hold what is wanted."""
    pixels = {name: channel.pixels for name, channel in part.channels.items()}
    for base in [name[:-1] for name in pixels if name.rpartition(".")[2] == "Z" and wanted == "depth"]:
        if base + "X" not in pixels:  # else it is one of a vector, such as a normal
            yield _layer(number, (base.rstrip("."),), pixels[base + "Z"], distances=True)
    # A part's name counts where the file has several: Nuke and Blender write a part for each layer
    prefix = part.name() if number else ""
    joined = {name: array for name, array in pixels.items() if array.ndim == 3 and array.shape[-1] > 2}
    for name, array in joined.items():
        own = "" if name in ("RGB", "RGBA") else name
        has_alpha = wanted == "matte" or array.shape[-1] == 3
        yield _layer(number, (prefix, own), array if has_alpha else array[..., :3])
    for base in dict.fromkeys(name.rpartition(".")[0] for name in pixels if name not in joined):
        dot = f"{base}." if base else ""
        for names in _RGBA_NAMES:
            found = tuple(pixels[dot + one] for one in names if dot + one in pixels)
            if len(found) > 2:
                kept = found if wanted == "matte" else found[:3]
                yield _layer(number, (prefix, base), *kept)
    vector = "X" in pixels  # X, Y, Z are no luminance
    if "Y" in pixels and {"RY", "BY"} <= set(pixels):
        yield _layer(number, (prefix,), _rgb_of_luma_chroma(pixels["Y"], pixels["RY"], pixels["BY"]))
    elif "Y" in pixels and not vector:
        yield _layer(number, (prefix,), pixels["Y"])
    elif wanted == "matte" and not joined:
        alphas = [name for name in pixels if name.rpartition(".")[2] in ("A", "a", "alpha")]
        for name in alphas or list(pixels)[: len(pixels) == 1]:
            yield _layer(number, (prefix, name.rpartition(".")[0]), pixels[name])


def _names(parts: list[Any]) -> list[str]:
    """Return the full names of all layers, of colours and others, "" for channels without a layer, each once."""
    found = []
    for number, part in enumerate(parts):
        for name, channel in part.channels.items():
            own = name if channel.pixels.ndim == 3 else name.rpartition(".")[0]
            own = "" if own in ("RGB", "RGBA") else own
            found.append(".".join(filter(None, [part.name() if number else "", own])))
    return list(dict.fromkeys(found))


def _rgb_of_luma_chroma(luma: NDArray[Any], red: NDArray[Any], blue: NDArray[Any]) -> NDArray[np.float32]:
    """Return RGB (h, w, 3) of luminance and the differences (R - Y) / Y and (B - Y) / Y, which have a sample for
    every second pixel (OpenEXR, "Luminance/Chroma Images").
    """
    import cv2

    y = np.asarray(luma, np.float32)
    shares = (
        cv2.resize(np.asarray(one, np.float32), y.shape[::-1], interpolation=cv2.INTER_LINEAR) for one in (red, blue)
    )
    r, b = (y * (1.0 + share) for share in shares)
    weights = LUMINANCE.astype(np.float32)
    return np.stack([r, (y - weights[0] * r - weights[2] * b) / weights[1], b], axis=-1)


def _in_frame(array: NDArray[np.float32], part: ExrPart) -> NDArray[np.float32]:
    """Return the display window (H, W, c) of a data window (h, w, c), black where it has no pixel."""
    if part.whole:
        return np.ascontiguousarray(array)
    width, height = part.frame_size
    out = np.zeros((height, width, array.shape[-1]), np.float32)
    left, top = part.data[0] - part.display[0], part.data[1] - part.display[1]
    rows, columns = (
        slice(max(top, 0), max(min(top + part.height, height), 0)),
        slice(max(left, 0), max(min(left + part.width, width), 0)),
    )
    inside = array[max(-top, 0) :, max(-left, 0) :][: rows.stop - rows.start, : columns.stop - columns.start]
    out[rows, columns][: inside.shape[0], : inside.shape[1]] = inside
    return out


def _frame_notes(
    path: Path, part: ExrPart, header: Mapping[str, Any], taken: str, others: list[str], *, clear: bool
) -> Iterator[str]:
    """Yield lines on what of a frame's file is not used. clear: whether it has alpha that is not opaque."""
    # Transparency and the colour space
    if clear:
        yield f"{path} - has transparency, which is left out - flatten it if that is wrong"
    space = _named_colours(header)
    if space and "chromaticities" not in header and space not in XY_BY_NAME:
        yield f"{path} - names a space that is not known (got {space!r:.40}), read as Rec.709 - write chromaticities"
    # Windows that differ
    (width, height), (left, top, right, bottom) = part.frame_size, part.data
    if (left, top, right, bottom) != part.display:
        low, high = np.array(part.display[:2]), np.array(part.display[2:])
        inside = bool(np.all([left, top] >= low) and np.all([right, bottom] <= high))
        what = "the rest of the frame is black" if inside else "what lies outside of the frame is cut off"
        yield (
            f"{path} - its data window is not its display window (got {part.width}x{part.height} at {left},{top} for "
            f"{width}x{height}): {what} - write it with both the same if that is wrong"
        )
    # Layers, pixel aspect and mip levels that are not read
    if others or taken:
        shown = ", ".join(name or "R, G, B" for name in others[:8]) + " ..." * (len(others) > 8)
        yield (
            f"{path} - is read by its layer {taken or 'R, G, B'}, others are not used (got {shown or 'none'}) - to "
            "have another one read, write it alone"
        )
    if abs(float(header.get("pixelAspectRatio", 1.0)) - 1.0) > _SQUARE:
        yield (
            f"{path} - says that its pixels are not square (got {header['pixelAspectRatio']:g}), which is not used: "
            "the frame is the whole sphere - write square pixels if it is not"
        )
    if part.levels:
        yield f"{path} - holds smaller copies of itself (mip levels) - the full size is read, outputs have it alone"


_SQUARE = 1e-3
_STRUCTURE = frozenset({
    "channels", "chromaticities", "chunkCount", "compression", "dataWindow", "displayWindow", "envmap", "lineOrder",
    "maxSamplesPerPixel", "multiView", "name", "preview", "screenWindowCenter", "screenWindowWidth", "textureformat",
    "tiles", "type", "version", "view", "BlenderMultiChannel",
})  # fmt: skip
"""Header entries that say how a file is stored, or of which layers it is."""


def _is_carried(name: str, value: Any) -> bool:
    """Return whether outputs keep a header entry: what it says of the picture, not how it is stored."""
    import OpenEXR

    known = (str, int, float, Fraction, tuple, np.ndarray, OpenEXR.TimeCode, OpenEXR.KeyCode, OpenEXR.Rational)
    usual = name in _STRUCTURE or (name == "pixelAspectRatio" and value == 1.0)
    return not usual and not name.startswith(("cryptomatte", "oiio:")) and isinstance(value, known)


def _checked(where: str, values: Any) -> NDArray[Any]:
    """Return a channel as a contiguous array; raise `VideoError` where it is no picture."""
    array = np.asarray(values)
    if array.dtype not in (np.float16, np.float32, np.uint32) or array.ndim not in (2, 3) or not array.size:
        raise VideoError(
            f"{where} - is no picture (got {array.dtype}, {array.shape}) - give float16, float32 or uint32, "
            "(H, W) or (H, W, 3)"
        )
    return np.ascontiguousarray(array)


@checked
def write_exr(
    path: str | Path,
    parts: Mapping[str, Part] | Floats,
    *,
    latlong: bool = True,
    attributes: Mapping[str, Any] | None = None,
    views: Mapping[str, str] | None = None,
    file: NewFile = whole_file,
) -> None:
    """Write one or more parts as an OpenEXR file, by a temporary name and a rename.

    parts: {part: {channel: array}}, or one linear image (H, W, 3 or 4). float16 channels are stored as half, float32
    as float. latlong: mark it as a latitude-longitude environment map. attributes: more header entries, windows other
    than the whole frame too. views: of parts that show what one eye sees, "left" or "right". file: opens the temporary
    file.
    """
    import OpenEXR

    # Name the channels of a plain array by their number
    path = Path(path)
    if isinstance(parts, Mapping):
        image_parts: Mapping[str, Part] = parts
    else:
        image = np.asarray(parts)
        image_parts = {"": {"RGBA"[: image.shape[-1] if image.ndim == 3 else 1]: image}}
    if not (image_parts and all(image_parts.values())):
        raise VideoError(f"{path} - has no channels (got none) - give an array for each")
    # Write what all parts have in common into one header
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_XY,
        **(attributes or {}),
    }
    if latlong:
        header["envmap"] = OpenEXR.ENVMAP_LATLONG
    # Make the parts, each with its view
    made = []
    for name, channels in image_parts.items():
        arrays = {channel: _checked(f"{path} {channel}", array) for channel, array in channels.items()}
        own = header | ({"view": views[name]} if views is not None and name in views else {})
        made.append(OpenEXR.Part(own, arrays, name) if name else OpenEXR.Part(own, arrays))
    with writing(path, RuntimeError, ValueError), file(path) as part:
        OpenEXR.File(made).write(str(part))
