# SPDX-License-Identifier: Apache-2.0
"""Reads PLY and STL.

PLY: polygons with colours, normals and texture coordinates under the names that programs give them. A file has elements
of rows of numbers and lists; which names mean what is left to its writers.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import decode
from mr360uw.base.input_files import TRIANGLES, neighbour, read_data, text_of
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


class _Element:
    """Rows of a file: numbers, and lists of numbers.

    declared: name, type in the header, and how a value and the length of a list are stored (None: a number).
    flat: values by name, row after row; sizes: (n,) how many of them are a row's, 1 for numbers.
    """

    def __init__(self, count: int = 0) -> None:
        self.count = count
        self.declared: list[tuple[str, str, np.dtype[Any], np.dtype[Any] | None]] = []
        self.flat: dict[str, NDArray[Any]] = {}
        self.sizes: dict[str, NDArray[np.int64]] = {}

    def read(self, data: NDArray[np.uint8], start: int) -> int:
        """Read the rows that begin at a place of bytes, and return where they end."""
        # Take all rows to be like the first: they are records, if the lengths of their lists say so
        found, end = self._rows(data, start, min(self.count, 1))
        end = start + self.count * (end - start)
        fields: list[Any] = []
        for k, (_, _, stored, size) in enumerate(self.declared if self.count else ()):
            fields += [] if size is None else [(f"size {k}", size)]
            fields.append((f"value {k}", stored, (len(found[k][0]),)))
        if fields and end <= len(data):
            rows = data[start:end].view(fields)
            values = [rows[f"value {k}"] for k in range(len(found))]
            lists = [k for k, one in enumerate(self.declared) if one[3] is not None]
            if all(np.all(rows[f"size {k}"] == values[k].shape[1]) for k in lists):
                for (name, *_), of_name in zip(self.declared, values, strict=True):
                    self.flat[name], self.sizes[name] = of_name.ravel(), np.full(self.count, of_name.shape[1])
                return end
        # Else find each where the one before it ends
        found, end = self._rows(data, start, self.count)
        for (name, _, stored, _), parts in zip(self.declared, found, strict=True):
            self.flat[name] = np.concatenate([np.zeros(0, stored), *parts])
            self.sizes[name] = np.array([len(part) for part in parts], np.int64)
        return end

    def _rows(self, data: NDArray[np.uint8], start: int, count: int) -> tuple[list[list[NDArray[Any]]], int]:
        """Return the values of each property in a number of rows, one by one, and where the last one ends."""
        found: list[list[NDArray[Any]]] = [[] for _ in self.declared]
        for _ in range(count if self.declared else 0):
            for values, (_, _, stored, size) in zip(found, self.declared, strict=True):
                length = 1
                if size is not None:
                    length = int(data[start : start + size.itemsize].view(size)[0])
                    start += size.itemsize
                    if length < 0:
                        raise ValueError(f"a list of {length} values")
                end = start + length * stored.itemsize
                if end > len(data):
                    raise IndexError(f"byte {end} of {len(data)}")
                values.append(data[start:end].view(stored))
                start = end
        return found, start

    def columns(self, names: tuple[str, ...]) -> Floats | None:
        """Return the numbers (n, ...) of properties; None where one is not there."""
        if not all(name in self.flat for name in names):
            return None
        return np.stack([self.flat[name].astype(np.float64) for name in names], axis=-1)

    def codes(self, *sets: tuple[str, ...]) -> Floats | None:
        """Return values (n, ...) in [0, 1] of the first names that are there, or None.

        Codes of 8 and 16 bits are divided by their largest, others above 1 by 255.
        """
        for names in sets:
            codes = self.columns(names)
            if codes is not None and codes.size:
                kind = {name: kind for name, kind, _, _ in self.declared}[names[0]]
                whole = np.iinfo(kind).max if kind in ("u1", "u2") else 255.0 if np.max(codes) > 1.0 else 1.0
                return codes / whole
        return None


def read_ply(path: Path, *, outside: bool = False) -> MeshFile:
    """Return the contents of a PLY; raise `MeshError`. outside: its texture may lie outside of its folder."""
    data = read_data(path, MeshError)
    head = re.match(rb"ply\s.*?\bend_header[^\S\n]*\r?\n?", data[:_HEAD], re.DOTALL | re.IGNORECASE)
    if head is None:
        raise MeshError(f"{path} - cannot be read as a mesh (got no header of a PLY) - export it again")
    try:
        text = text_of(head[0])
        elements = _elements(path, [line.split() for line in text.splitlines()], data[head.end() :])
        return _contents(path, elements, text, outside=outside)
    except IndexError as error:
        raise MeshError(f"{path} - is cut short: it ends before its last row - copy or export it again") from error
    except (ValueError, KeyError, OverflowError, TypeError, StopIteration) as error:
        what = f"{type(error).__name__}: {error!s:.160}"
        raise MeshError(f"{path} - cannot be read as a mesh (got: {what}) - export it again") from error


def _elements(path: Path, lines: list[list[str]], body: bytes) -> dict[str, _Element]:
    """Return the elements of a file by their names."""
    # Read the header: elements in the order of their rows, each with its properties; text becomes doubles
    found: list[tuple[str, _Element]] = []
    order = ""
    for line in lines:
        if line[:1] == ["format"]:
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[line[1].lower()]
        elif line[:1] == ["element"]:
            found.append((line[1], _Element(int(line[2]))))
        elif line[:1] == ["property"]:
            kinds = [_TYPES[word] for word in (line[2:4] if line[1] == "list" else line[1:2])]
            stored = [np.dtype(order + kind if order else "f8") for kind in kinds]
            size = stored[0] if line[1] == "list" else None
            found[-1][1].declared.append((line[2 * len(kinds)].lower(), kinds[-1], stored[-1], size))
    # Read the rows; none that is promised may be missing
    data = np.frombuffer(body if order else np.array(body.split(), np.float64), np.uint8)
    start = 0
    for name, element in found:
        if name == "face":
            TRIANGLES.check(str(path), element.count, MeshError)
        least = sum((size or stored).itemsize for _, _, stored, size in element.declared)
        if element.count < 0 or element.count * least > len(data) - start:
            raise ValueError(f"fewer than the {element.count} rows of {name} that its header promises")
        start = element.read(data, start)
    return dict(found)


def _contents(path: Path, elements: dict[str, _Element], head: str, *, outside: bool) -> MeshFile:
    """Return the polygons of a file, a part for each of its textures."""
    vertex, face = elements["vertex"], elements.get("face", _Element())
    points = vertex.columns(("x", "y", "z"))
    place, sizes = next(((face.flat[name], face.sizes[name]) for name in _CORNERS if name in face.flat), (None, None))
    if place is None and (strips := elements.get("tristrips")):
        place, sizes = _of_strips(*(next(iter(one.values())) for one in (strips.flat, strips.sizes)))
    if points is None or place is None:
        what, out = "points without faces (got no vertex_indices)", "make a surface of them first"
        if {"f_dc_0", "packed_position"} & set(vertex.flat):
            what, out = "Gaussian splats, which have no surface", "export a mesh from the program that made them"
        raise MeshError(f"{path} - has {what} - {out}")
    place = place.astype(np.int64)
    check_corners(path, place, len(points))
    polygons = polygons_of(points, sizes, place, left_handed=False)
    TRIANGLES.check(str(path), len(polygons.faces), MeshError)
    # Bring everything to the corners of the polygons
    notes: list[str] = []
    colors, uv = _colors(path, polygons, vertex, face, notes), _uv(polygons, vertex, face)
    normals = vertex.columns(("nx", "ny", "nz"))
    # Read the textures; several are told apart by a number of each face
    named = [line.split(None, 2)[2].strip("\"' ") for line in head.splitlines() if _TEXTURE.match(line)]
    files = [neighbour(path, name, "texture", outside=outside) for name in named]
    images = [make_texture(decode_image(read_data(file, MeshError), str(file)), srgb=True) for file in files]
    look = np.zeros(len(polygons.counts), np.int64)
    if "texnumber" in face.flat and len(images) > 1:
        look = np.clip(face.flat["texnumber"].astype(np.int64), 0, len(images) - 1)
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
        shades = [name for name, flat in vertex.flat.items() if _SHADES.search(name) and flat.size and np.ptp(flat) > 0]
        notes += [
            f"{path} - has {name} of its vertices - it colours nothing; export colours instead" for name in shades
        ]
    drawn = ("vertex", "face" if "face" in elements else "tristrips")
    others = [k for k, one in elements.items() if k not in drawn and any(flat.size for flat in one.flat.values())]
    notes += [f"{path} - has elements {name!r:.40} - they are not used; export coloured triangles" for name in others]
    return MeshFile(tuple(parts), tuple(materials), tuple(notes), head=head)


def _of_strips(corners: NDArray[Any], sizes: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the corners of the triangles of strips, which end at -1, and how many each has; every second one of a
    strip runs the other way.
    """
    strips = np.split(corners, np.cumsum(sizes)[:-1])
    runs = [run[run >= 0] for strip in strips for run in np.split(strip, np.flatnonzero(strip < 0))]
    found = [np.stack([run[:-2], run[1:-1], run[2:]], axis=1) for run in runs if len(run) > 2]
    for triangles in found:
        triangles[1::2] = triangles[1::2, ::-1]
    flat = np.concatenate(found).ravel() if found else np.zeros(0, np.int64)
    return flat, np.full(len(flat) // 3, 3)


def _uv(polygons: Polygons, vertex: _Element, face: _Element) -> Floats | None:
    """Return texture coordinates (C, 2) of corners, right and down from the image's top left, or None."""
    uv = next((found for names in _UVS if (found := vertex.columns(names)) is not None), None)
    if uv is not None:
        uv = uv[polygons.corners]
    elif "texcoord" in face.flat and np.all(face.sizes["texcoord"] == 2 * polygons.counts):
        uv = face.flat["texcoord"].astype(np.float64).reshape(-1, 2)
    return None if uv is None else uv * [1.0, -1.0] + [0.0, 1.0]


def _colors(path: Path, polygons: Polygons, vertex: _Element, face: _Element, notes: list[str]) -> Floats | None:
    """Return the linear colours (C, 4) of corners: those of vertices, unless only those of faces differ; or None."""
    found: list[Floats] = []
    for element, kind in ((vertex, "vertex"), (face, "uniform")):
        codes, alpha = element.codes(*_COLORS), element.codes(("alpha",), ("diffuse_alpha",), ("a",))
        if codes is not None:
            found.append(polygons.at_corners(codes, kind, "colours"))
            if alpha is not None and alpha.min() < 1.0:
                notes.append(
                    f"{path} - has colours that are clear in places (alpha) - they are opaque; glTF can be clear"
                )
    if not found:
        return None
    flat = len(found) == 2 and not np.ptp(found[0], axis=0).any()
    if len(found) == 2:
        drawn = "faces" if flat else "vertices"
        notes.append(f"{path} - has colours of vertices and of faces - those of {drawn} are drawn; remove the others")
    chosen = found[-1] if flat else found[0]
    return np.append(decode(np.clip(chosen, 0.0, 1.0), "srgb"), np.ones((len(chosen), 1)), axis=1)


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
