# SPDX-License-Identifier: Apache-2.0
"""Reads STL: separate triangles, as text or as rows of 50 bytes, with the colours that some programs keep in these.

A header that begins with "solid" is no sign of text, and the number of triangles in it is not always right: programs
that write while they compute leave it 0.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import decode
from mr360uw.composite.mesh.material import Material, MeshFile, Part
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import TRIANGLES, read_data, text_of
from mr360uw.types import Floats

_HEAD, _COUNT_END = 80, 84
"""Bytes of the header of a binary file, and of that with the number of triangles."""
_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("word", "<u2")])
_SOLID = re.compile(rb"^[ \t]*solid\b([^\r\n]*)", re.IGNORECASE | re.MULTILINE)
_OTHER_LINES = re.compile(rb"^(?![ \t]*vertex\b)[^\r\n]*$", re.IGNORECASE | re.MULTILINE)
_MATERIALS = Material(double_sided=True), Material(base_color=(1.0, 1.0, 1.0, 1.0), double_sided=True)


def read_stl(path: Path, *, outside: bool = False) -> MeshFile:  # noqa: ARG001 - it names no other files
    """Return the triangles of an STL; raise `MeshError`."""
    data = read_data(path, MeshError).removeprefix(b"\xef\xbb\xbf")
    count = int.from_bytes(data[_HEAD:_COUNT_END], "little")
    exact = len(data) == _COUNT_END + count * _ROW.itemsize
    head, notes = data[:_HEAD], []
    if not exact and re.match(rb"\s*solid.*?(facet|endsolid)", data, re.IGNORECASE | re.DOTALL):
        parts = tuple(_text_parts(path, data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")))
        if not re.search(rb"endsolid[^\n]*\s*\Z", data, re.IGNORECASE):
            notes.append(f"{path} - ends without endsolid: is it cut short? - copy or export it again if parts lack")
        return MeshFile(parts, _MATERIALS, tuple(notes), head=text_of(head), cad=True)
    # Read as many rows as the header says; of a number that was never written, all that are there
    there = max(len(data) - _COUNT_END, 0) // _ROW.itemsize
    if count > there or len(data) < _COUNT_END:
        got = f"got {there} of {count} triangles" if len(data) >= _COUNT_END else f"got {len(data)} bytes"
        raise MeshError(f"{path} - is cut short, or no STL ({got}) - copy or export it again")
    if count < there:
        count = count or there
        notes.append(f"{path} - is longer than its number of triangles says - {count} are drawn; export it again")
    TRIANGLES.check(str(path), count, MeshError)
    rows = np.frombuffer(data, _ROW, count, _COUNT_END)
    colors = _colors(rows["word"], head)
    if colors is not None and head[head.find(b"COLOR=") + 9 :][:1] < b"\xff" and b"COLOR=" in head:
        notes.append(f"{path} - has colours that are clear (COLOR) - they are opaque; glTF can be clear")
    part = _part(path.name, rows["corners"].reshape(-1, 3).astype(np.float64), colors)
    return MeshFile((part,), _MATERIALS, tuple(notes), head=text_of(head), cad=True)


def _text_parts(path: Path, data: bytes) -> Iterator[Part]:
    """Yield the solids of a text; raise `MeshError` where their corners are no numbers, or not three to a triangle."""
    starts = list(_SOLID.finditer(data))
    ends = [*(one.start() for one in starts[1:]), len(data)]
    for one, end in zip(starts, ends, strict=True):
        lines = _OTHER_LINES.sub(b"", data[one.end() : end]).lower().replace(b"vertex", b" ").strip()
        if not lines:
            continue
        try:
            with warnings.catch_warnings(action="error"):  # what is no number ends the reading with a warning
                numbers = np.fromstring(lines.decode("ascii"), np.float64, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise MeshError(
                f"{path} - has corners that are no numbers (got: {error!s:.100}) - export it again"
            ) from None
        if len(numbers) % 9:
            raise MeshError(f"{path} - is cut short (its last triangle has no three corners) - copy or export it again")
        TRIANGLES.check(str(path), len(numbers) // 9, MeshError)
        yield _part(text_of(one[1]).strip() or path.name, numbers.reshape(-1, 3), None)


def _part(name: str, corners: Floats, colors: Floats | None) -> Part:
    """Return triangles, each with three corners (3 T, 3) of its own."""
    faces = np.arange(len(corners)).reshape(-1, 3)
    return Part(name, corners, faces, colors=colors, material=int(colors is not None))


def _colors(words: NDArray[np.uint16], head: bytes) -> Floats | None:
    """Return the linear colours (V, 4) of the corners of triangles by their 16 bits, or None where they have none.

    Five bits each of blue, green and red, from the lowest, where the highest bit is set (VisCAM, SolidView); with
    `COLOR=` in the header the order is red, green, blue and the highest bit is set where the header's colour is meant
    (Materialise Magics).
    """
    if not np.any(words):
        return None
    magics = head.find(b"COLOR=")
    shifts = (0, 5, 10) if magics >= 0 else (10, 5, 0)
    own = (words >> 15 == 0) if magics >= 0 else (words >> 15 == 1)
    codes = np.stack([(words >> shift & 31) / 31.0 for shift in shifts], axis=-1)
    common = np.frombuffer(head[magics + 6 : magics + 9], np.uint8) / 255.0 if magics >= 0 else np.full(3, 0.735)
    if not np.any(own) and magics < 0:
        return None
    rgb = decode(np.where(own[:, None], codes, common), "srgb")
    return np.repeat(np.append(rgb, np.ones((len(rgb), 1)), axis=1), 3, axis=0)
