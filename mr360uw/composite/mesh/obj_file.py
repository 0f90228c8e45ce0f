# SPDX-License-Identifier: Apache-2.0
"""Reads Wavefront OBJ: polygons with texture coordinates, normals and colours of vertices, a part for each material."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import decode
from mr360uw.composite.mesh.material import Material, MeshFile, Part
from mr360uw.composite.mesh.obj_material import Libraries, bare_name
from mr360uw.composite.mesh.polygons import polygons_of
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import TRIANGLES, read_data, text_of
from mr360uw.types import Floats

_CURVES, _LOOKS = "curves or free-form surfaces", "textures by name (usemap) instead of materials"
_NOT_DRAWN = {"p": "points or lines", "l": "points or lines", "curv": _CURVES, "curv2": _CURVES, "surf": _CURVES,
              "usemap": _LOOKS, "maplib": _LOOKS, "call": "other files in it (call)"}  # fmt: skip
_PAINT = "#MRGB"
"""Comments in which ZBrush keeps the colours of vertices."""
_HEAD = 60
"""Lines at the top in whose comments exporters name themselves and their axes."""


@dataclass(slots=True)
class _Lines:
    """The lines of a file, by their first words. vertices, uvs, normals: numbers as they are written.

    corners, counts, looks: of polygons: v/vt/vn as absolute numbers, how many, and the name of its material. words: how
    often others come.
    """

    vertices: list[list[str]] = field(default_factory=list)
    uvs: list[list[str]] = field(default_factory=list)
    normals: list[list[str]] = field(default_factory=list)
    corners: list[str] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    looks: list[str] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)
    objects: list[str] = field(default_factory=list)
    words: Counter[str] = field(default_factory=Counter)


def read_obj(path: Path, *, outside: bool = False) -> MeshFile:
    """Return the contents of an OBJ; raise `MeshError`. outside: it may name files outside of its folder."""
    text = text_of(read_data(path, MeshError)).replace("\\\r\n", " ").replace("\\\n", " ")
    try:
        return _contents(path, text, _sorted(text), outside=outside)
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshError(f"{path} - cannot be read as a mesh (got: {error!s:.200}) - export it again") from error


def _sorted(text: str) -> _Lines:
    """Return the lines of a text by what they give."""
    found, look = _Lines(), ""
    # Compare the frequent words first; comments end lines of numbers, but may be part of a name
    rows = {"v": found.vertices, "vt": found.uvs, "vn": found.normals}
    for line in text.splitlines():
        word, *values = line.split(None, 1) or [""]
        word, rest = word.lower(), values[0] if values else ""
        if word in ("v", "vt", "vn", "f", "fo") and "#" in rest:
            rest = rest.partition("#")[0]
        if word in rows:
            rows[word].append(rest.split())
        elif word in ("f", "fo"):
            corners = rest.split()
            if "-" in rest:  # counted back from the last before this line
                sizes = (len(found.vertices), len(found.uvs), len(found.normals))
                corners = [_absolute(corner, sizes) for corner in corners]
            found.corners += corners
            found.counts.append(len(corners))
            found.looks.append(look)
        elif word == "usemtl":
            look = rest
        elif word == "mtllib":
            found.libraries.append(rest)
        elif word in ("o", "g") and rest:
            found.objects.append(rest.strip())
        elif word in _NOT_DRAWN or word == _PAINT.lower():
            found.words[word] += 1
    return found


def _absolute(corner: str, sizes: tuple[int, int, int]) -> str:
    """Return a corner v/vt/vn whose numbers below 0 are counted from the end."""
    numbers = [int(number) if number else 0 for number in corner.split("/")]
    return "/".join(str(n + size + 1 if n < 0 else n) for n, size in zip(numbers, sizes, strict=False))


def _contents(path: Path, text: str, lines: _Lines, *, outside: bool) -> MeshFile:
    """Return the parts of the lines, one for each material."""
    # Make tables of the numbers, each corner with its own
    TRIANGLES.check(str(path), len(lines.corners) - 2 * len(lines.counts), MeshError)
    vertices, colors = _vertices(lines.vertices)
    uvs, normals = _table(lines.uvs, 2), _table(lines.normals, 3)
    corners = _corners(lines.corners)
    # Make a part of the polygons of each material, in the order of their first use
    libraries = Libraries(path, lines.libraries, outside=outside)
    names = list(dict.fromkeys(lines.looks))
    look = np.array([names.index(name) for name in lines.looks] if len(names) > 1 else [0] * len(lines.looks), np.int64)
    counts = np.array(lines.counts, np.int64)
    owner = np.repeat(look, counts)
    parts: list[Part] = []
    materials: list[Material] = []
    title = lines.objects[0] if lines.objects else path.name
    for number, name in enumerate(names):
        place, image, normal = corners[owner == number].T
        _check(path, place, len(vertices))
        tint = None if colors is None else colors[place]
        mapped = libraries.material(name, tinted=tint is not None)
        uv = _values(uvs, image)
        uv = None if uv is None else mapped.coordinates[0].of(uv) * [1.0, -1.0] + [0.0, 1.0]
        polygons = polygons_of(vertices, counts[look == number], place, left_handed=False)
        called = title if len(names) == 1 else bare_name(name) or title
        parts.append(Part(called, vertices[place], polygons.faces, _values(normals, normal), uv, tint, number))
        materials.append(mapped.material)
    notes = [
        f"{path} - has {what} - they are not drawn" for what in dict.fromkeys(map(_NOT_DRAWN.get, lines.words)) if what
    ]
    if _PAINT.lower() in lines.words:
        notes.append(
            f"{path} - has painted vertices of ZBrush ({_PAINT}) - they are not drawn; export a texture or PLY"
        )
    head = "\n".join(line for line in text.splitlines()[:_HEAD] if line.lstrip().startswith("#"))
    return MeshFile(tuple(parts), tuple(materials), (*libraries.notes, *notes), head=head)


def _vertices(rows: list[list[str]]) -> tuple[Floats, Floats | None]:
    """Return positions (V, 3) and the linear colours (V, 4) that follow them, of files that have any."""
    vertices = _table(rows, 3)
    if not any(len(row) > 5 for row in rows):
        return vertices, None
    rgb = np.array([row[3:6] if len(row) > 5 else ("1", "1", "1") for row in rows], np.float64)
    rgb = rgb / 255.0 if np.max(rgb) > 1.0 else rgb
    if np.all(rgb == 1.0):
        return vertices, None
    return vertices, np.append(decode(np.clip(rgb, 0.0, 1.0), "srgb"), np.ones((len(rgb), 1)), axis=1)


def _table(rows: list[list[str]], width: int) -> Floats:
    """Return the first numbers (n, width) of rows; what is not written is 0."""
    if all(len(row) >= width for row in rows):
        return np.array([row[:width] for row in rows], np.float64).reshape(-1, width)
    return np.array([(row + ["0"] * width)[:width] for row in rows], np.float64)


def _corners(written: list[str]) -> NDArray[np.int64]:
    """Return the numbers (C, 3) of vertex, texture coordinates and normal of corners, from 0; -1: none."""
    slashes = {corner.count("/") for corner in written}
    if len(slashes) == 1:
        text = " ".join(written).replace("//", "/0/").replace("/ ", "/0 ").replace("/", " ")
        numbers = np.array(text.split(), np.int64).reshape(len(written), -1)
    else:
        rows = [[int(n or 0) for n in (*corner.split("/"), "", "")[:3]] for corner in written]
        numbers = np.array(rows, np.int64).reshape(-1, 3)
    result = np.full((len(written), 3), -1, np.int64)
    result[:, : numbers.shape[1]] = numbers[:, :3] - 1
    return result


def _values(table: Floats, index: NDArray[np.int64]) -> Floats | None:
    """Return the rows of corners, 0 where a corner has none; None where none has one that is there."""
    there = (index >= 0) & (index < len(table))
    if not np.any(there):
        return None
    return np.where(there[:, None], table[np.where(there, index, 0)], 0.0)


def _check(path: Path, place: NDArray[np.int64], count: int) -> None:
    """Raise `MeshError` where a polygon is of a vertex that is not there."""
    wrong = place[(place < 0) | (place >= count)]
    if len(wrong):
        raise MeshError(
            f"{path} - has a face of a vertex that is not there (got {wrong[0]} of {count}, the first is 0)"
            " - export it again"
        )
