# SPDX-License-Identifier: Apache-2.0
"""Input files: read whole within limits, as bytes, text or JSON; notes of which files were read; parts of picture
files by their bytes.

Limits are checked before anything is decoded, for a small file may ask for any memory. Each is an environment variable,
in millions; the message that refuses a file names it.

Files that a mesh file names (buffers, textures, material libraries) lie in the folder of the mesh or below it. A mesh
from a stranger could otherwise show any file of the machine.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import json
import os
import re
import stat
import struct
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from mr360uw.errors import MeshError, Mr360uwError, ParameterError

_MILLION = 1_000_000


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit. variable: environment variable that sets it; default: in millions of `unit`; covers: for the manual."""

    variable: str
    default: float
    unit: str
    covers: str

    def value(self) -> int:
        """Return the limit in units; raise `ParameterError` where the variable holds no positive number."""
        text = os.environ.get(self.variable, "").strip()
        if not text:
            return round(self.default * _MILLION)
        try:
            value = round(float(text) * _MILLION)
        except (ValueError, OverflowError):
            value = 0
        if value < 1:
            raise ParameterError(
                f"{self.variable} - is no limit (got {text!r:.40}) - set millions of {self.unit}, or unset it"
            )
        return value

    def check(self, where: str, amount: int, wrong: type[Mr360uwError]) -> None:
        """Raise `wrong` where an amount, in units, is larger; where: what holds it, with the name of its file."""
        if amount > (most := self.value()):
            raise wrong(
                f"{where} - is too large (got {amount / _MILLION:.6g} million {self.unit}, at most "
                f"{most / _MILLION:.6g}) - make it smaller, or set {self.variable} to allow more"
            )


PICTURE = Limit("MR360UW_MAX_PICTURE", 150, "pixels", "a picture or a frame of a video: 16384 x 8192 fit")
TEXTURE = Limit("MR360UW_MAX_TEXTURE", 70, "pixels", "a texture: 8192 x 8192 fit")
DATA = Limit("MR360UW_MAX_DATA", 1000, "bytes", "a mesh file, one of its arrays, or an EXR picture, unpacked")
TRIANGLES = Limit("MR360UW_MAX_TRIANGLES", 10, "triangles", "a mesh file, each repetition counted")
TEXT = Limit("MR360UW_MAX_TEXT", 10, "bytes", "a scene, a table, a track or a material library")
FRAMES = Limit("MR360UW_MAX_FRAMES", 1, "frames", "frames made of a still: nine hours at 30 a second")
OBJECTS = Limit("MR360UW_MAX_OBJECTS", 0.001, "objects", "the objects of a scene")
PRIMS = Limit("MR360UW_MAX_PRIMS", 1, "prims", "a USD stage, each reference to a prim counted")
PARTICLES = Limit("MR360UW_MAX_PARTICLES", 10, "particles", "marine snow about the camera in one frame")
LIMITS = (PICTURE, TEXTURE, DATA, TRIANGLES, TEXT, FRAMES, OBJECTS, PRIMS, PARTICLES)


_NOTES: ContextVar[tuple[dict[Path, None], ...]] = ContextVar("files read", default=())
"""The notes that are being taken in this thread, one inside the other."""
_BLOCK = 1 << 20
_BLOCKS = 16
"""Blocks of a large file that are hashed, spread over it evenly: gigabytes are not read."""


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file that a scene reads. digest: SHA-256 of its size and of its content, of large files of 16 blocks of it.

    changed_ns: of large files the time of the last change of any of their data, which programs cannot set back; else 0.
    """

    path: Path
    size: int
    digest: str
    changed_ns: int


@contextmanager
def files_read() -> Iterator[dict[Path, None]]:
    """Yield a dictionary whose keys become the files that `note_read` names on this thread within the context.

    `read_data` names every file that it opens, so that a mesh's textures and buffers are found without knowing its
    format.
    """
    found: dict[Path, None] = {}
    before = _NOTES.set((*_NOTES.get(), found))
    try:
        yield found
    finally:
        _NOTES.reset(before)


def note_read(path: Path) -> None:
    """Note that a file is read."""
    for found in _NOTES.get():
        found[path] = None


Stamp = tuple[int, int] | None
"""Time of the last change [ns] and length [bytes] of a file; None where it cannot be read."""


def stamp(path: Path) -> Stamp:
    """Return what changes when a file does."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


_FOLDERS = ("textures", "texture", "tex", "maps", "images", "materials")
"""Folders beside a mesh, in any case, in which files that it names elsewhere are looked for."""


def neighbour(path: Path, name: str, what: str, *, outside: bool, shown: str = "", exact: bool = False) -> Path:
    """Return the file that a mesh file calls `name`, or where that is not there, the file of its bare name beside it.

    path: of the mesh file; what: kind of the file, for messages; shown: the name as the mesh file has it. outside: it
    may lie outside of the mesh file's folder. exact: under its own name only, as others will open it. Raises
    `MeshError` for other places, and for what is no regular file.
    """
    shown, home = shown or name, (path.parent.resolve(), path.resolve().parent)

    def allowed(file: Path) -> bool:
        return outside or any(file.resolve().is_relative_to(folder) for folder in home)

    try:
        named = path.parent / name.replace("\\", "/")
        inside, there = allowed(named), named.exists()
        found = named if inside and there else None
        if found is None and not exact:
            found = next((file for file in beside(path, name) if file.exists() and allowed(file)), None)
    except (OSError, ValueError, RuntimeError):  # a name too long, with a zero character, or a circle of links
        raise MeshError(f"{path} - names a {what} by a name that no file has (got {shown!r:.80}) - rename it") from None
    if found is None and not inside:
        raise MeshError(
            f"{path} - names a {what} outside of its folder (got {shown!r:.80}) - put it beside the mesh, or if you "
            "trust the mesh set outside_files = true for the object"
        )
    if found is None:
        raise MeshError(f"{path} - a {what} is missing (got {shown!r:.80}; {LOOKED_FOR}) - put it beside the mesh")
    if reason := unreadable(found):
        raise MeshError(f"{path} - names a {what} that {reason} (got {shown!r:.80})")
    return found


LOOKED_FOR = f"looked for there, and by its bare name beside the mesh and in {', '.join(_FOLDERS)}"


def beside(path: Path, name: str) -> list[Path]:
    """Return the files of a name, without its folders and in any case, in a mesh file's folder and in `_FOLDERS`."""
    wanted = _folded(name.replace("\\", "/").rpartition("/")[2])
    entries = sorted(path.parent.iterdir()) if wanted else []
    for folder in [entry for entry in entries if entry.name.lower() in _FOLDERS and entry.is_dir()]:
        entries += sorted(folder.iterdir())
    return [entry for entry in entries if _folded(entry.name) == wanted]


def _folded(name: str) -> str:
    """Return a file's name as systems compare them that neither tell cases nor ways to write an accent apart."""
    return unicodedata.normalize("NFC", name).casefold()


def text_of(data: bytes) -> str:
    """Return text as exporters encode it: UTF-8 or UTF-16, with or without a mark, or else Windows-1252."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def unreadable(path: Path) -> str:
    """Return why a path is no file that can be read, *what is wrong - what to do*; "" for a regular file.

    Devices, pipes and sockets are refused: reading them may wait for ever, or never end.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return "no such file - check the path"
    except (OSError, ValueError) as error:
        return f"cannot be read (got: {getattr(error, 'strerror', None) or error}) - check its name and rights"
    if stat.S_ISDIR(mode):
        return "is a folder - name a file"
    if not stat.S_ISREG(mode):
        return "is a device, a pipe or a socket, which cannot be read twice - save it as a file first"
    return ""


_WRAPPED = {
    b"version https://git-lfs": "is a pointer of Git LFS, not the file itself - fetch that by git lfs pull",
    b"PK\3\4": "is a ZIP archive - unpack it, and name the file in it",
    b"\x1f\x8b": "is compressed by gzip - unpack it",
    b"7z\xbc\xaf\x27\x1c": "is a 7z archive - unpack it, and name the file in it",
    b"Rar!": "is a RAR archive - unpack it, and name the file in it",
    b"<!doctype html": "is a web page, which a failed download leaves - download the file again",
    b"<html": "is a web page, which a failed download leaves - download the file again",
}
"""First bytes, in small letters, of what stands in for a file, and what to do."""


def wrapped(head: bytes) -> str:
    """Return why a file that begins so is not what its name says, *what is wrong - what to do*; "" for others."""
    start = head[:32].lstrip()
    return next((why for mark, why in _WRAPPED.items() if start.startswith(mark) or start.lower().startswith(mark)), "")


def read_data(path: Path, wrong: type[Mr360uwError], limit: Limit = DATA) -> bytes:
    """Return the bytes of a file; raise `wrong` where it cannot be read, is no regular file, is over the limit, or is
    an archive, a web page or a pointer in place of the file.
    """
    if reason := unreadable(path):
        raise wrong(f"{path} - {reason}")
    try:
        note_read(path)
        with path.open("rb") as file:
            limit.check(str(path), os.fstat(file.fileno()).st_size, wrong)
            data = file.read(limit.value())
    except OSError as error:
        raise wrong(f"{path} - cannot be read (got: {error.strerror or error}) - check its rights") from error
    if why := wrapped(data):
        raise wrong(f"{path} - {why}")
    return data


def read_text(path: Path, wrong: type[Mr360uwError]) -> str:
    """Return the text of a UTF-8 file, without a byte order mark; raise `wrong` as `read_data` does, or for others."""
    try:
        return read_data(path, wrong, TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise wrong(f"{path} - is no text in UTF-8 (got: {error!s:.80}) - save it as such") from None


def json_of(text: str | bytes) -> Any:
    """Return the value of a JSON text; raise `ValueError` where it is none, or has more levels than can be read."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("lists and tables within others, too deep to read") from None


def read_json(path: Path, wrong: type[Mr360uwError]) -> Any:
    """Return the value of a JSON file; raise `wrong` as `read_text` does, and for text that is no JSON."""
    text = read_text(path, wrong)
    try:
        return json_of(text)
    except ValueError as error:
        raise wrong(f"{path} - is no JSON (got: {error!s:.120}) - write it again") from None


def own_table(name: str) -> list[dict[str, str]]:
    """Return the rows of a table of this package, by the names of its columns. name: its path in the package."""
    lines = (resources.files("mr360uw") / name).read_text("utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


@functools.cache
def not_read(taken_for: str) -> dict[str, str]:
    """Return the endings of files that are not read, with what `base/data/unread.csv` says of them.

    taken_for: "mesh", "mesh by Blender", "picture", "raw picture" or "raw video".
    """
    rows = [row for row in own_table("base/data/unread.csv") if row["taken_for"] == taken_for]
    return {ending: row["said"] for row in rows for ending in row["endings"].split()}


def holds_text(path: Path, text: str) -> bool:
    """Return whether a regular file holds exactly this text, and can be read."""
    data = text.encode()
    try:
        return not unreadable(path) and path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:
        return False


def input_file(path: Path) -> InputFile:
    """Return a file's fingerprint; raise `OSError` where it cannot be read."""
    about = path.stat()
    size = about.st_size
    found = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        step = max(_BLOCK, (size - _BLOCK) // (_BLOCKS - 1))
        for start in range(0, size, step):
            file.seek(start)
            found.update(file.read(_BLOCK))
    return InputFile(path, size, found.hexdigest(), about.st_ctime_ns if size > _BLOCKS * _BLOCK else 0)


def content_of(paths: Iterable[Path]) -> str:
    """Return a hash of the content of files in their order, whatever their names and times; raise `OSError`."""
    return hashlib.sha256("".join(input_file(path).digest for path in paths).encode()).hexdigest()


# --- Parts of picture files -----------------------------------------------------------------------------------------

# Parts of picture files by their bytes: segments of JPEG, chunks of PNG and WebP, entries of TIFF, and their size.


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
