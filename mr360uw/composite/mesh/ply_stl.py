# SPDX-License-Identifier: Apache-2.0
"""Reads PLY and STL, and tells which axis of a mesh points up.

PLY: polygons with colours, normals and texture coordinates under the names that programs give them.

A file has elements of rows of numbers and lists; which names mean what is left to its writers.
"""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import decode
from mr360uw.base.input_files import TRIANGLES, neighbour, own_table, read_data, text_of
from mr360uw.composite.mesh.material import Material, MeshFile, Part, Texture, decode_image, make_texture
from mr360uw.composite.mesh.polygons import Polygons, check_corners, polygons_of
from mr360uw.errors import MeshError
from mr360uw.types import Floats

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "half": "f2", "float16": "f2", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_CORNERS = ("vertex_indices", "vertex_index")
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_UVS = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"), ("texcoord_u", "texcoord_v"), ("tu", "tv"))
_TEXTURE = re.compile(r"\s*comment\s+texture_?file:?\s+\S", re.IGNORECASE)
_HEAD = 1_000_000
"""Bytes within which a header ends."""
_SHADES = re.compile(r"quality|intensity|reflectance|scalar|label|class|gr[ae]y|luminance|material_index")
"""Names of values by which programs colour meshes that have no colours."""


@dataclass(frozen=True, slots=True)
class _Property:
    """Values of an element. type: as in the header. stored: how a value is stored, and size the length of a list."""

    name: str
    type: str
    stored: np.dtype[Any]
    size: np.dtype[Any] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Values:
    """Values of a property, row after row. sizes: (n,) of its lists, 1 for plain numbers. type: as in the header."""

    flat: NDArray[Any]
    sizes: NDArray[np.int64]
    type: str


_Element = dict[str, _Values]


def _taken(data: NDArray[np.uint8], places: NDArray[np.int64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the values (n,) at places (n,) of bytes."""
    return data[places[:, None] + np.arange(kind.itemsize)].view(kind).reshape(len(places))


def _element(data: NDArray[np.uint8], start: int, count: int, properties: list[_Property]) -> tuple[_Element, int]:
    """Return an element whose rows begin at a place, and where they end.

    Rows are as long as the first one where all their lists are; else they are passed one by one.
    """
    # Take all rows to be like the first, and look whether their lists say the same
    none = [0] * len(properties)
    sizes, places, length = _row(data, start, properties) if count else (none, none, 0)
    end, rows = start + length * count, length * np.arange(count)
    at, many = [place + rows for place in places], [np.full(count, size) for size in sizes]
    alike = end <= len(data) and all(
        np.all(_taken(data, place - one.size.itemsize, one.size) == size)
        for one, place, size in zip(properties, at, sizes, strict=True)
        if one.size is not None
    )
    # Else find every row where the one before it ends
    if not alike:
        table, end = np.empty((count, 2, len(properties)), np.int64), start
        for row in range(count):
            table[row, 0], table[row, 1], length = _row(data, end, properties)
            end += length
        many, at = list(table[:, 0].T), list(table[:, 1].T)
    # Take the values of each property
    found: _Element = {}
    for one, begins, counts in zip(properties, at, many, strict=True):
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        flat = _taken(data, np.repeat(begins, counts) + within * one.stored.itemsize, one.stored)
        found[one.name] = _Values(flat, counts, one.type)
    return found, end


def _row(data: NDArray[np.uint8], start: int, properties: list[_Property]) -> tuple[list[int], list[int], int]:
    """Return how many values each property has in a row, where they begin, and the row's length."""
    sizes, places, place = [], [], start
    for one in properties:
        size = 1
        if one.size is not None:
            size = int(data[place : place + one.size.itemsize].view(one.size)[0])
            place += one.size.itemsize
            if size < 0:
                raise ValueError(f"a list of {size} values")
        sizes.append(size)
        places.append(place)
        place += size * one.stored.itemsize
    return sizes, places, place - start


def read_ply(path: Path, *, outside: bool = False) -> MeshFile:
    """Return the contents of a PLY; raise `MeshError`. outside: its texture may lie outside of its folder."""
    data = read_data(path, MeshError)
    head = re.match(rb"ply\s.*?\bend_header[^\S\n]*\r?\n?", data[:_HEAD], re.DOTALL | re.IGNORECASE)
    if head is None:
        raise MeshError(f"{path} - cannot be read as a mesh (got no header of a PLY) - export it again")
    try:
        text = text_of(head[0])
        elements = dict(_elements(path, [line.split() for line in text.splitlines()], data[head.end() :]))
        return _contents(path, elements, text, outside=outside)
    except IndexError as error:
        raise MeshError(f"{path} - is cut short: it ends before its last row - copy or export it again") from error
    except (ValueError, KeyError, OverflowError, TypeError, StopIteration) as error:
        what = f"{type(error).__name__}: {error!s:.160}"
        raise MeshError(f"{path} - cannot be read as a mesh (got: {what}) - export it again") from error


def _elements(path: Path, lines: list[list[str]], body: bytes) -> Iterator[tuple[str, _Element]]:
    """Yield the elements of a file by their names."""
    # Read the header: elements in the order of their rows, each with its properties; text becomes doubles
    declared: list[tuple[str, int, list[_Property]]] = []
    order = ""
    for line in lines:
        if line[:1] == ["format"]:
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[line[1].lower()]
        elif line[:1] == ["element"]:
            declared.append((line[1], int(line[2]), []))
        elif line[:1] == ["property"]:
            kinds = [_TYPES[word] for word in (line[2:4] if line[1] == "list" else line[1:2])]
            stored = [np.dtype(order + kind if order else "f8") for kind in kinds]
            declared[-1][2].append(_Property(line[2 * len(kinds)].lower(), kinds[-1], *reversed(stored)))
    # Read the rows; none that is promised may be missing
    data = np.frombuffer(body if order else np.array(body.split(), np.float64), np.uint8)
    start = 0
    for name, count, properties in declared:
        if name == "face":
            TRIANGLES.check(str(path), count, MeshError)
        least = sum((one.size or one.stored).itemsize for one in properties)
        if count < 0 or count * least > len(data) - start:
            raise ValueError(f"fewer than the {count} rows of {name} that its header promises")
        found, start = _element(data, start, count, properties)
        yield name, found


def _contents(path: Path, elements: dict[str, _Element], head: str, *, outside: bool) -> MeshFile:
    """Return the polygons of a file, a part for each of its textures."""
    vertex, face = elements["vertex"], elements.get("face", {})
    points = _columns(vertex, ("x", "y", "z"))
    corners = next((face[name] for name in _CORNERS if name in face), None)
    if corners is None and (strips := elements.get("tristrips")):
        corners = _of_strips(next(iter(strips.values())))
    if points is None or corners is None:
        what, out = "points without faces (got no vertex_indices)", "make a surface of them first"
        if {"f_dc_0", "packed_position"} & set(vertex):
            what, out = "Gaussian splats, which have no surface", "export a mesh from the program that made them"
        raise MeshError(f"{path} - has {what} - {out}")
    place = corners.flat.astype(np.int64)
    check_corners(path, place, len(points))
    polygons = polygons_of(points, corners.sizes, place, left_handed=False)
    TRIANGLES.check(str(path), len(polygons.faces), MeshError)
    # Bring everything to the corners of the polygons
    notes: list[str] = []
    colors, uv = _colors(path, polygons, vertex, face, notes), _uv(polygons, vertex, face)
    normals = _columns(vertex, ("nx", "ny", "nz"))
    # Read the textures; several are told apart by a number of each face
    named = [line.split(None, 2)[2].strip("\"' ") for line in head.splitlines() if _TEXTURE.match(line)]
    files = [neighbour(path, name, "texture", outside=outside) for name in named]
    images = [make_texture(decode_image(read_data(file, MeshError), str(file)), srgb=True) for file in files]
    look = np.zeros(len(polygons.counts), np.int64)
    if "texnumber" in face and len(images) > 1:
        look = np.clip(face["texnumber"].flat.astype(np.int64), 0, len(images) - 1)
    maps: list[Texture | None] = [*images] or [None]
    color = (1.0, 1.0, 1.0, 1.0) if images or colors is not None else Material().base_color
    materials = [Material(base_color=color, base_map=image, double_sided=True) for image in maps]
    parts = [
        Part(
            path.name, points[polygons.corners], polygons.faces[look[polygons.polygon] == number],
            None if normals is None else normals[polygons.corners], uv, colors, number,
        )
        for number in range(len(materials))
    ]  # fmt: skip
    # Say what is left over
    if uv is not None and not images:
        notes.append(f"{path} - has texture coordinates and names no texture - set the object's texture in the scene")
    if colors is None and not images:
        shades = [
            name for name, one in vertex.items() if _SHADES.search(name) and one.flat.size and np.ptp(one.flat) > 0.0
        ]
        notes += [
            f"{path} - has {name} of its vertices - it colours nothing; export colours instead" for name in shades
        ]
    drawn = ("vertex", "face" if "face" in elements else "tristrips")
    others = [name for name, one in elements.items() if name not in drawn and any(v.flat.size for v in one.values())]
    notes += [f"{path} - has elements {name!r:.40} - they are not used; export coloured triangles" for name in others]
    return MeshFile(tuple(parts), tuple(materials), tuple(notes), head=head)


def _of_strips(strips: _Values) -> _Values:
    """Return the triangles of strips, which end at -1; every second one of a strip runs the other way."""
    ends = np.cumsum(strips.sizes)[:-1]
    runs = [run for strip in np.split(strips.flat, ends) for run in np.split(strip, np.flatnonzero(strip < 0))]
    runs = [run[run >= 0] for run in runs]
    found = [np.stack([run[:-2], run[1:-1], run[2:]], axis=1) for run in runs if len(run) > 2]
    for triangles in found:
        triangles[1::2] = triangles[1::2, ::-1]
    flat = np.concatenate(found).ravel() if found else np.zeros(0, np.int64)
    return _Values(flat, np.full(len(flat) // 3, 3), strips.type)


def _columns(element: _Element, names: tuple[str, ...]) -> Floats | None:
    """Return the numbers (n, ...) of properties; None where one is not there."""
    if not all(name in element for name in names):
        return None
    return np.stack([element[name].flat.astype(np.float64) for name in names], axis=-1)


def _uv(polygons: Polygons, vertex: _Element, face: _Element) -> Floats | None:
    """Return texture coordinates (C, 2) of corners, right and down from the image's top left, or None."""
    uv = next((found for names in _UVS if (found := _columns(vertex, names)) is not None), None)
    if uv is not None:
        uv = uv[polygons.corners]
    elif "texcoord" in face and np.all(face["texcoord"].sizes == 2 * polygons.counts):
        uv = face["texcoord"].flat.astype(np.float64).reshape(-1, 2)
    return None if uv is None else uv * [1.0, -1.0] + [0.0, 1.0]


def _colors(path: Path, polygons: Polygons, vertex: _Element, face: _Element, notes: list[str]) -> Floats | None:
    """Return the linear colours (C, 4) of corners: those of vertices, unless only those of faces differ; or None."""
    found: list[Floats] = []
    for element, kind in ((vertex, "vertex"), (face, "uniform")):
        codes = next((c for names in _COLORS if (c := _codes(element, names)) is not None), None)
        if codes is not None and len(codes):
            found.append(polygons.at_corners(codes, kind, "colours"))
        alpha = next(
            (a for name in ("alpha", "diffuse_alpha", "a") if (a := _codes(element, (name,))) is not None), None
        )
        if codes is not None and alpha is not None and alpha.min() < 1.0:
            notes.append(f"{path} - has colours that are clear in places (alpha) - they are opaque; glTF can be clear")
    if not found:
        return None
    flat = len(found) == 2 and not np.ptp(found[0], axis=0).any()
    if len(found) == 2:
        drawn = "faces" if flat else "vertices"
        notes.append(f"{path} - has colours of vertices and of faces - those of {drawn} are drawn; remove the others")
    chosen = found[-1] if flat else found[0]
    return np.append(decode(np.clip(chosen, 0.0, 1.0), "srgb"), np.ones((len(chosen), 1)), axis=1)


def _codes(element: _Element, names: tuple[str, ...]) -> Floats | None:
    """Return colours (n, ...) in [0, 1] of properties of whole numbers, or of others up to 1 or 255; else None."""
    codes = _columns(element, names)
    if codes is None or not codes.size:
        return None
    kind = element[names[0]].type
    if kind in ("u1", "u2"):
        return codes / np.iinfo(kind).max
    return codes / 255.0 if np.max(codes) > 1.0 else codes


# --- STL ------------------------------------------------------------------------------------------------------------

# Reads STL: separate triangles, as text or as rows of 50 bytes, with the colours that some programs keep in these.
#
# A header that begins with "solid" is no sign of text, and the number of triangles in it is not always right: programs
# that write while they compute leave it 0.


_STL_HEAD, _COUNT_END = 80, 84
"""Bytes of the header of a binary file, and of that with the number of triangles."""
_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("word", "<u2")])
_SOLID = re.compile(rb"^[ \t]*solid\b([^\r\n]*)", re.IGNORECASE | re.MULTILINE)
_OTHER_LINES = re.compile(rb"^(?![ \t]*vertex\b)[^\r\n]*$", re.IGNORECASE | re.MULTILINE)
_MATERIALS = Material(double_sided=True), Material(base_color=(1.0, 1.0, 1.0, 1.0), double_sided=True)


def read_stl(path: Path, *, outside: bool = False) -> MeshFile:  # noqa: ARG001 - it names no other files
    """Return the triangles of an STL; raise `MeshError`."""
    data = read_data(path, MeshError).removeprefix(b"\xef\xbb\xbf")
    count = int.from_bytes(data[_STL_HEAD:_COUNT_END], "little")
    exact = len(data) == _COUNT_END + count * _ROW.itemsize
    head, notes = data[:_STL_HEAD], []
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
    colors = _stl_colors(rows["word"], head)
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


def _stl_colors(words: NDArray[np.uint16], head: bytes) -> Floats | None:
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


# --- Which axis points up -------------------------------------------------------------------------------------------

# The axis of a mesh file that points up, where its format does not say: STL, OBJ and PLY.
#
# It is told by words in the file's comments or name, by the program that wrote it, or by the shape: things are as a
# rule mirror-symmetric across a vertical plane and stand on something flat. Where none of these tells, it is y.


# Kinds of things that meshes show, known by words in the names of their files and parts.

Habit = Literal["swims", "stands", "flies"]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of thing. low_m, high_m: between which its longest side is. typical_m: where the file's own is not.

    habit: whether it is in open water, on the floor, or in the sky. blunt: whether its front is the thicker end.
    """

    word: str
    low_m: float
    high_m: float
    typical_m: float
    habit: Habit
    blunt: bool


@functools.cache
def kinds() -> tuple[Kind, ...]:
    """Return the kinds in the order in which their words are looked for."""
    rows = (row.values() for row in own_table("composite/mesh/data/kinds.csv"))
    return tuple(
        Kind(word, float(low), float(high), float(typical), cast("Habit", habit), front == "thick")
        for word, low, high, typical, habit, front in rows
    )


_OF_PROGRAMS = {"plane"}
"""Words that modelling programs give to parts by themselves."""


def kind_of(name: str, parts: Iterable[str] = ()) -> Kind | None:
    """Return the kind whose word a file's name holds, or else one of its parts'; short words must stand alone.

    None where there is none.
    """
    found = _kind_in(name)
    named = (_kind_in(part) for part in parts)
    return found or next((kind for kind in named if kind is not None and kind.word not in _OF_PROGRAMS), None)


def _kind_in(name: str) -> Kind | None:
    plain = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()
    words = re.split(r"[^a-z]+", plain)
    joined = "".join(words)
    for kind in kinds():
        hit = kind.word in words or f"{kind.word}s" in words or (len(kind.word) > 4 and kind.word in joined)
        if hit or (kind.word == "fish" and any(word.endswith("fish") for word in words)):
            return kind
    return None


Up = Literal["auto", "y", "z", "x", "-y", "-z", "-x"]
UPRIGHT: dict[Up, Floats] = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]),
    "x": np.array([[0, -1.0, 0], [1.0, 0, 0], [0, 0, 1.0]]),
    "-y": np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]),
    "-x": np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, 1.0]]),
}
"""Rotations (3, 3) from axes with one up to axes with y up. From z, x stays, and y goes away from the viewer."""
_SAID = re.compile(
    r"(?<![a-z0-9-])([xyz])[\s_-]?up(?![a-z]|\s*[:=]|[\s_-]?axis\s*[:=])"
    r"|(?<![a-z])up[\s_-]?(?:(?:axis|vector|direction)\s*[:=]?|[:=])\s*['\"]?\+?([xyz])(?![a-z])",
    re.IGNORECASE,
)
"""Words such as z-up, zup, Z_UP, up axis: z, up=z."""
_Z_PROGRAMS = re.compile(
    r"\b(?:openscad|freecad|open ?cascade|solidworks|catia|autocad|inventor|solid ?edge|onshape|creo|stlb atf"
    r"|realitycapture|realityscan|metashape|photoscan|pix4d|contextcapture|opendronemap|cloudcompare|qgis|arcgis"
    r"|exported from blender)",  # its STL: its OBJ has y up and says "Blender ... OBJ File", its PLY has either
    re.IGNORECASE,
)
"""Programs whose files have z up unless their users ask for another."""
_UPRIGHT_KINDS = ("person", "human", "mannequin", "man", "woman", "soldier", "statue", "column", "bottle", "amphora")
"""Kinds of things that are taller than they are wide."""
_TALL = 1.5
_POINTS = 3000
"""Points on the surface that are looked at: the symmetry differs by a tenth with another choice of them."""
_ALONE = 0.3
"""Ratio of asymmetries below which a mesh is symmetric about one axis and not about another; the larger one is at least
that of a symmetric body. Bodies without symmetry have ratios of 0.6 to 1."""
_FLAT, _BARE = 0.5, 0.005
"""Areas of a flat base over the footprint from which there is one and below which there is none, not even thin legs."""
_THIN = 0.25
"""Height over width below which a thing lies flat: a spanner is as symmetric about its vertical axis as a ship on
its side is about the horizontal one."""
_AT_FOOT = 1e-3
"""Distance of a lowest point from the origin, over the longest side, below which the origin is at the foot."""


def up_axis(path: Path, file: MeshFile) -> tuple[Up, str]:
    """Return the axis that points up in a file, and what tells it, "" where nothing does."""
    if file.head is None:
        return "y", "its format has y up"
    if (said := _SAID.search(file.head)) or (said := _SAID.search(path.stem)):
        up: Up = (said[1] or said[2]).lower()  # type: ignore[assignment]
        return up, f"it says {said[0].strip()!r}"
    if program := _Z_PROGRAMS.search(file.head):
        return "z", f"by its program, {program[0]}"
    corners = [part.positions[part.faces] for part in file.parts if len(part.faces)]
    positions = np.concatenate(corners) if corners else np.zeros((0, 3, 3))
    extent = np.ptp(positions.reshape(-1, 3), axis=0) if len(positions) else np.zeros(3)
    if not (np.all(np.isfinite(extent)) and np.all(extent > 0.0)):
        return "y", ""
    why = _z_by_shape(positions, extent, kind_of(path.stem, (part.name for part in file.parts)), cad=file.cad)
    return ("z", why) if why else ("y", "")


def _z_by_shape(positions: Floats, extent: Floats, kind: Kind | None, *, cad: bool) -> str:
    """Return what in the shape of triangles (T, 3, 3) tells that z is up, not y; "" where nothing does."""
    # Tall things first: their names tell more than their symmetry
    stands = kind is None or kind.habit == "stands"
    if kind is not None and kind.word in _UPRIGHT_KINDS and extent[2] > _TALL * max(extent[0], extent[1]):
        return f"by its name, {kind.word}, it is tall"
    middle = 0.5 * (positions.min(axis=(0, 1)) + positions.max(axis=(0, 1)))
    points = surface_points(positions) - middle
    # Asymmetries above that of a symmetric body, which is due to its few points
    least = _apart(points, surface_points(positions, seed=1) - middle)
    x, y, z = (asymmetry(points, axis) - least for axis in range(3))
    if y < _ALONE * min(x, z) > _ALONE * least and extent[1] > _THIN * extent[2]:
        return "it is mirror-symmetric about y alone"
    # Of things that stand, look for the end on which they do
    lowest = positions.min(axis=(0, 1))
    foot = np.abs(lowest) < _AT_FOOT * np.max(extent)
    smallest = extent[2] <= min(extent[0], extent[1])
    if not stands or (smallest and not cad and kind is None) or (foot[1] and not foot[2]):
        return ""
    if max(x, y) < _ALONE * z > _ALONE * least and extent[2] < np.max(extent):
        return "it is mirror-symmetric about x and y, and not about z"
    if cad and foot[2] and not foot[1]:
        return "it stands on z = 0"
    bottom, top = _flat_ends(positions, extent, 2)
    if bottom - top > _FLAT and _flat_ends(positions, extent, 1)[0] < _BARE:
        return "its base is flat there"
    return ""


def _flat_ends(positions: Floats, extent: Floats, axis: int) -> tuple[float, float]:
    """Return the areas of the flat lower and upper end along an axis, over that of the box."""
    across = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])[:, axis]
    area = 0.5 * np.abs(across)
    along = positions[..., axis]
    low, high = along.min(), along.max()
    slack = 1e-3 * extent[axis]
    box = float(np.prod(extent) / extent[axis])
    lower, upper = (float(area[np.all(np.abs(along - end) < slack, axis=1)].sum()) / box for end in (low, high))
    return lower, upper


def surface_points(positions: Floats, seed: int = 0) -> Floats:
    """Return points (n, 3) spread evenly over the area of triangles (T, 3, 3), the same for the same triangles."""
    a, b, c = (positions[:, k] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(area), _POINTS, p=area / area.sum())
    u, v = rng.random((2, _POINTS, 1))
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    return np.asarray(a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen])


def asymmetry(points: Floats, axis: int) -> float:
    """Return the mean distance from points (n, 3), mirrored along an axis, to the nearest points."""
    mirrored = points.copy()
    mirrored[:, axis] *= -1.0
    return _apart(points, mirrored)


def _apart(points: Floats, others: Floats) -> float:
    """Return the mean distance from other points (n, 3) to the nearest points."""
    from scipy.spatial import cKDTree

    return float(np.mean(cKDTree(points).query(others)[0]))
