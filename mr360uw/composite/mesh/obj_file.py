# SPDX-License-Identifier: Apache-2.0
"""Reads Wavefront OBJ: polygons with texture coordinates, normals and colours of vertices, a part for each material."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import decode
from mr360uw.base.input_files import LOOKED_FOR, TEXT, TRIANGLES, beside, neighbour, read_data, text_of
from mr360uw.composite.mesh.material import (
    MapCoordinates,
    Material,
    MeshFile,
    Part,
    Pixels,
    Texture,
    Wrap,
    decode_image,
    make_texture,
)
from mr360uw.composite.mesh.polygons import check_corners, polygons_of
from mr360uw.errors import MeshError
from mr360uw.types import Floats

_CURVES, _LOOKS = "curves or free-form surfaces", "textures by name (usemap) instead of materials"
_NOT_DRAWN = {"p": "points or lines", "l": "points or lines", "curv": _CURVES, "curv2": _CURVES, "surf": _CURVES,
              "usemap": _LOOKS, "maplib": _LOOKS, "call": "other files in it (call)"}  # fmt: skip
_NAMES = {"mtllib": "library", "o": "object", "g": "object"}
"""What words give the names of."""
_PAINT = "#mrgb"
"""Comments in which ZBrush keeps the colours of vertices."""
_HEAD = 60
"""Lines at the top in whose comments exporters name themselves and their axes."""


def read_obj(path: Path, *, outside: bool = False) -> MeshFile:
    """Return the contents of an OBJ; raise `MeshError`. outside: it may name files outside of its folder."""
    text = text_of(read_data(path, MeshError)).replace("\\\r\n", " ").replace("\\\n", " ")
    try:
        return _contents(path, text, outside=outside)
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshError(f"{path} - cannot be read as a mesh (got: {error!s:.200}) - export it again") from error


def _sorted(text: str) -> tuple[dict[str, list[list[str]]], list[tuple[list[str], str]], dict[str, list[str]]]:
    """Return the lines of a text by what they give.

    Numbers of v, vt and vn as they are written; the corners v/vt/vn of each polygon, in absolute numbers, with the name
    of its material; what follows each of the other words that are read or said.
    """
    rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "vn": []}
    polygons: list[tuple[list[str], str]] = []
    others: dict[str, list[str]] = {}
    look = ""
    # Compare the frequent words first; comments end lines of numbers, but may be part of a name
    for line in text.splitlines():
        word, *values = line.split(None, 1) or [""]
        word, rest = word.lower(), values[0] if values else ""
        if word in rows:
            rows[word].append(rest.partition("#")[0].split())
        elif word in ("f", "fo"):
            numbers = rest.partition("#")[0]
            corners = numbers.split()
            if "-" in numbers:  # counted back from the last before this line
                sizes = [len(of_word) for of_word in rows.values()]
                corners = [_absolute(corner, sizes) for corner in corners]
            polygons.append((corners, look))
        elif word == "usemtl":
            look = rest
        elif word in _NAMES:
            others.setdefault(_NAMES[word], []).append(rest.strip())
        elif word in _NOT_DRAWN or word == _PAINT:
            others.setdefault(word, []).append(rest)
    return rows, polygons, others


def _absolute(corner: str, sizes: list[int]) -> str:
    """Return a corner v/vt/vn whose numbers below 0 are counted from the end."""
    numbers = [int(number) if number else 0 for number in corner.split("/")]
    return "/".join(str(n + size + 1 if n < 0 else n) for n, size in zip(numbers, sizes, strict=False))


def _contents(path: Path, text: str, *, outside: bool) -> MeshFile:
    """Return the parts of a text, one for each material."""
    # Make tables of the numbers, each corner with its own
    rows, polygons, others = _sorted(text)
    counts = np.array([len(polygon) for polygon, _ in polygons], np.int64)
    TRIANGLES.check(str(path), int(counts.sum()) - 2 * len(counts), MeshError)
    vertices, colors = _vertices(rows["v"])
    uvs, normals = _table(rows["vt"], 2), _table(rows["vn"], 3)
    corners = _corners([corner for polygon, _ in polygons for corner in polygon])
    # Make a part of the polygons of each material, in the order of their first use
    libraries = Libraries(path, others.get("library", []), outside=outside)
    numbers = {name: number for number, name in enumerate(dict.fromkeys(name for _, name in polygons))}
    look = np.array([numbers[name] for _, name in polygons], np.int64)
    owner = np.repeat(look, counts)
    parts: list[Part] = []
    materials: list[Material] = []
    title = next(filter(None, others.get("object", [])), path.name)
    for name, number in numbers.items():
        place, image, normal = corners[owner == number].T
        check_corners(path, place, len(vertices))
        tint = None if colors is None else colors[place]
        material, coordinates = libraries.material(name, tinted=tint is not None)
        uv = _values(uvs, image)
        uv = None if uv is None else coordinates.of(uv) * [1.0, -1.0] + [0.0, 1.0]
        faces = polygons_of(vertices, counts[look == number], place, left_handed=False).faces
        called = title if len(numbers) == 1 else bare_name(name) or title
        parts.append(Part(called, vertices[place], faces, _values(normals, normal), uv, tint, number))
        materials.append(material)
    notes = [f"{path} - has {what} - they are not drawn" for what in dict.fromkeys(map(_NOT_DRAWN.get, others)) if what]
    if _PAINT in others:
        notes.append(f"{path} - has painted vertices of ZBrush (#MRGB) - they are not drawn; export a texture or PLY")
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
    return np.array([(row + ["0"] * width)[:width] for row in rows], np.float64).reshape(-1, width)


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


# Material libraries of Wavefront OBJ, with the words for physically based materials that exporters add to them.
#
# Colours are sRGB codes over 255, as maps have them. The colour is that of `map_Kd`, else of `map_Ka`, else `Kd`.

_DRAWN = frozenset({
    "ka", "kd", "ke", "d", "tr", "pr", "pm", "map_ka", "map_kd", "map_ke", "map_d", "map_pr", "map_pm", "norm", "bump",
    "map_bump", "illum", "sharpness", "ns",
})  # fmt: skip
"""Words that are read, and two that say how other programs shade."""
_CHANGE_NOTHING = {"ks": (0.0, 0.5), "ni": (1.0, 1.45, 1.5), "tf": (1.0,), "ps": (0.0,), "pc": (0.0,),
                   "pcr": (0.0,), "aniso": (0.0,), "anisor": (0.0,)}  # fmt: skip
"""Values of words that are not read with which a material looks as without them; exporters write a `Ks` of 0.5 for a
dielectric.
"""
_PLAIN = MapCoordinates("uv")
_WHITE, _GREY = (1.0, 1.0, 1.0, 1.0), (0.5, 0.5, 0.5, 1.0)
_Entry = tuple[Path, dict[str, str]]
"""A library, and the words of one of its materials."""
_OPTION = re.compile(
    r"-(?:(?P<numbers>mm|s|o|t)(?P<values>(?:\s+[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?=\s)){1,3})"
    r"|(?P<word>blendu|blendv|boost|bm|cc|clamp|colorspace|imfchan|texres|type)\s+(?P<value>\S+))\s+",
    re.IGNORECASE,
)
"""An option before the name of a map's file."""
_TILES = re.compile(r"<(udim|uvtile)>|_mapid_|%\(UDIM\)d", re.IGNORECASE)
_UNIT = {"s": [1.0, 1.0, 1.0], "o": [0.0, 0.0, 0.0], "t": [0.0, 0.0, 0.0], "mm": [0.0, 1.0]}
"""Values of options that change nothing."""
_LIBRARY = re.compile(r'"[^"]+"|\S.*?\.mtl(?=\s|$)', re.IGNORECASE)
_NORMAL_BLUE, _NORMAL_RANGE = 0.7, 0.15
"""Least mean blue of a map of normals, and how far from a half its mean red and green are. Maps of heights are grey."""


def bare_name(name: str) -> str:
    """Return a name without quotes and in single spaces."""
    return " ".join(name.strip().strip("\"'").split())


def _names(written: str) -> list[str]:
    """Return what a name in a file may be: all that is written, or that without a comment; without quotes."""
    bare = re.split(r"\s+#", written, maxsplit=1)[0]
    return list(dict.fromkeys(name.strip().strip("\"'") for name in (written, bare, unquote(bare))))


class _Map:
    """A map of a material: its file and code values, how it scales and moves texture coordinates, what is beyond its
    edges, and the strength of its bumps.
    """

    def __init__(self, file: Path, pixels: Pixels, numbers: dict[str, list[float]], words: dict[str, str]) -> None:
        """Take the options before its name, as numbers or as words; an axis that is not written stays as it is."""
        self.file, self.pixels = file, pixels
        scale, offset = ((numbers.get(name, []) + _UNIT[name][len(numbers.get(name, [])) :])[:2] for name in "so")
        self.coordinates = MapCoordinates("uv", (offset[0], offset[1]), 0.0, (scale[0], scale[1]))
        self.wrap: Wrap = "clamp" if words.get("clamp", "").lower() == "on" else "repeat"
        self.strength = _number(words, "bm", 1.0)


class Libraries:
    """The libraries that an OBJ names. notes: what is missing in them, or not drawn, for the user.

    outside: libraries and maps may lie outside of the OBJ's folder.
    """

    def __init__(self, path: Path, named: Sequence[str], *, outside: bool) -> None:
        self.path, self._outside = path, outside
        self._notes: dict[str, None] = {}
        self._left: dict[Path, dict[str, None]] = {}
        self._entries: dict[str, _Entry] = {}
        pixels = functools.cache(lambda file: decode_image(read_data(file, MeshError), str(file)))
        self._pixels = pixels
        self._made = functools.cache(lambda file, srgb, wrap: make_texture(pixels(file), srgb=srgb, wrap=(wrap, wrap)))
        for library in dict.fromkeys(file for line in named for file in self._files(line)):
            self._read(library)

    @property
    def notes(self) -> tuple[str, ...]:
        """Each note once."""
        instead = "set the object's roughness and textures in the scene, or export glTF"
        left = (f"{library} - has {', '.join(words)}, not drawn - {instead}" for library, words in self._left.items())
        return (*self._notes, *left)

    def _files(self, line: str) -> list[Path]:
        """Return the files of a line `mtllib`: one whose name may have spaces, or several."""
        whole = self._library(_names(line))
        if whole is not None:
            return [whole]
        several = _LIBRARY.findall(line) or [line]
        found = [self._library(_names(name)) for name in several]
        if None in found and (renamed := beside(self.path, f"{self.path.stem}.mtl")):
            return [renamed[0]]
        for name, file in zip(several, found, strict=True):
            if file is None:
                self._notes[
                    f"{self.path} - its material library is missing (got {bare_name(name)!r:.80}; {LOOKED_FOR}) - "
                    "it is drawn without its colours; put the library beside the mesh"
                ] = None
        return [file for file in found if file is not None]

    def _library(self, names: list[str]) -> Path | None:
        """Return the library of the first name that is there, or None; raise `MeshError` where it is refused."""
        name = self._there(names)
        return None if name is None else neighbour(self.path, name, "material library", outside=self._outside)

    def _there(self, names: list[str]) -> str | None:
        """Return the first name of which there is a file, allowed or not."""
        return next(
            (n for n in names if os.path.lexists(self.path.parent / n.replace("\\", "/")) or beside(self.path, n)), None
        )

    def _read(self, library: Path) -> None:
        """Add the materials of a library that no earlier one has."""
        entry: dict[str, str] = {}
        for line in text_of(read_data(library, MeshError, TEXT)).splitlines():
            word, *values = line.split(None, 1) or [""]
            if word.lower() == "newmtl":
                entry = {}
                self._entries.setdefault(_key(values[0] if values else ""), (library, entry))
            elif values and not word.startswith("#"):
                entry[word.lower()] = values[0].strip()

    def material(self, name: str, *, tinted: bool) -> tuple[Material, MapCoordinates]:
        """Return the material of a name, and how its maps move the texture coordinates.

        tinted: its vertices have colours, which stand instead of its own.
        """
        found = next((self._entries[key] for key in map(_key, _names(name)) if key in self._entries), None)
        if found is None:
            if self._entries and bare_name(name):
                self._notes[f"{self.path} - its material {bare_name(name)!r:.80} is in no library - it is grey"] = None
            return Material(base_color=_WHITE if tinted else _GREY, double_sided=True), _PLAIN
        library, entry = found
        for word in entry:
            if word not in _DRAWN and not _changes_nothing(word, entry):
                self._left.setdefault(library, {})[word] = None
        # The file of the colour is needed; a material without another map looks nearly as it should
        word = "map_kd" if "map_kd" in entry else "map_ka"
        base = self._map(library, word, entry[word]) if word in entry else None
        color = _WHITE if base is not None or tinted else (*self._color(found, "kd", _GREY[:3]), 1.0)
        normal, glow, emission = self._normal(found), self._other(found, "map_ke"), self._color(found, "ke", (0.0,) * 3)
        material = Material(
            bare_name(name),
            color,
            emission=emission if glow is None or any(emission) else (1.0, 1.0, 1.0),
            normal_scale=1.0 if normal is None else normal.strength,
            double_sided=True,
            base_map=self._texture(base, srgb=True),
            normal_map=self._texture(normal, srgb=False),
            emission_map=self._texture(glow, srgb=True),
        )
        material = self._metallic(self._covering(material, found, base), found)
        return material, _PLAIN if base is None else base.coordinates

    def _covering(self, material: Material, found: _Entry, base: _Map | None) -> Material:
        """Return a material with the opacity of its entry: `d`, else 1 - `Tr`, cut out by `map_d`."""
        # Read the opacity of the whole material
        library, entry = found
        opacity = _number(entry, "d", 1.0, -1) if "d" in entry else 1.0 - _number(entry, "tr", 0.0, -1)
        if opacity <= 0.0 or (opacity >= 1.0 and "d" in entry and _number(entry, "tr", 0.0) > 0.0):
            # Old exporters write what is opaque as Tr 1
            what = " and ".join(f"{one} {entry[one]}" for one in ("d", "tr") if one in entry)
            self._notes[f"{library} - has a material that may be clear ({what}) - it is drawn opaque; set d"] = None
        mask = self._other(found, "map_d")
        if 0.0 < opacity < 1.0:
            material = replace(material, base_color=(*material.base_color[:3], opacity), alpha_mode="BLEND")
        if mask is None:
            if base is not None and np.any(base.pixels[..., 3:] < np.iinfo(base.pixels.dtype).max):
                self._notes[f"{base.file} - is clear in places, and no map_d says so - it is drawn opaque"] = None
            return material
        # Put the mask into the alpha of the colours
        pixels = np.full((*mask.pixels.shape[:2], 3), 255, np.uint8) if base is None else _eight_bits(base.pixels)
        alpha = _alpha(_eight_bits(mask.pixels), pixels.shape[:2])
        cut = make_texture(np.dstack([pixels[..., :3], alpha]), srgb=True, wrap=(mask.wrap, mask.wrap))
        return replace(material, base_map=cut, alpha_mode="BLEND" if material.alpha_mode == "BLEND" else "MASK")

    def _metallic(self, material: Material, found: _Entry) -> Material:
        """Return a material with the roughness and the metallic of its entry: `Pr` and `Pm`, or their maps.

        Without `Pr`, a highlight (`Ks`) has the roughness of Phong's exponent `Ns`: alpha^2 = 2/(Ns + 2) (Walter et al.
        2007, section 5.1), and alpha is the roughness squared (glTF 2.0, B.3.3).
        """
        entry = found[1]
        rough, metal = self._other(found, "map_pr"), self._other(found, "map_pm")
        roughness = 1.0 if rough is not None else _number(entry, "pr", _of_phong(entry, material.roughness))
        metallic = 1.0 if metal is not None else _number(entry, "pm", 0.0)
        material = replace(material, roughness=min(max(roughness, 0.0), 1.0), metallic=min(max(metallic, 0.0), 1.0))
        maps = [one for one in (rough, metal) if one is not None]
        if not maps:
            return material
        size = maps[0].pixels.shape[:2]
        both = np.full((*size, 3), 255, np.uint8)
        for channel, one in ((1, rough), (2, metal)):
            if one is not None:
                both[..., channel] = _resized(_eight_bits(one.pixels)[..., 0], size)
        return replace(
            material, metallic_roughness_map=make_texture(both, srgb=False, wrap=(maps[0].wrap, maps[0].wrap))
        )

    def _normal(self, found: _Entry) -> _Map | None:
        """Return the map of normals: `norm`, or a `bump` that is one by its colours, not a map of heights."""
        words = [word for word in ("norm", "map_bump", "bump") if word in found[1]]
        for word in words:
            one = self._other(found, word)
            if one is not None and (word == "norm" or _has_normals(one.pixels)):
                return one
            if one is not None:
                self._left.setdefault(found[0], {})[word] = None
        return None

    def _color(self, found: _Entry, word: str, default: tuple[float, ...]) -> tuple[float, float, float]:
        """Return the linear colour of a word, of one number grey. Emission above 1 is its colour times the largest."""
        library, entry = found
        try:
            codes = np.array([float(value) for value in entry.get(word, "").split()[:3]])
        except ValueError:
            codes = np.zeros(0)
        if len(codes) not in (1, 3) or not np.all(np.isfinite(codes)):
            if word in entry:
                self._notes[f"{library} - {word} is no colour (got {entry[word]!r:.40}) - write three numbers"] = None
            return default[0], default[1], default[2]
        largest = max(float(codes.max()), 1.0)
        if largest > 1.0 and word == "kd":
            self._notes[f"{library} - Kd has numbers above 1 (got {entry[word]!r:.40}) - they are over 255"] = None
            codes, largest = codes / 255.0, 1.0
        r, g, b = (largest * decode(np.clip(codes / largest, 0.0, 1.0), "srgb") * np.ones(3)).tolist()
        return r, g, b

    def _other(self, found: _Entry, word: str) -> _Map | None:
        """Return a map that the picture can do without; None where there is none, or with a note none of use."""
        library, entry = found
        try:
            return self._map(library, word, entry[word]) if word in entry else None
        except MeshError as error:
            self._notes[f"{library} - {word} is not drawn: {error}"] = None
            return None

    def _map(self, library: Path, word: str, written: str) -> _Map:
        """Return a map; raise `MeshError` where its file cannot be used."""
        numbers: dict[str, list[float]] = {}
        words: dict[str, str] = {}
        while option := _OPTION.match(written):
            if option["numbers"]:
                numbers[option["numbers"].lower()] = [float(value) for value in option["values"].split()]
            else:
                words[option["word"].lower()] = option["value"]
            written = written[option.end() :]
        for name in ("t", "mm"):
            if numbers.get(name, _UNIT[name]) != _UNIT[name][: len(numbers.get(name, _UNIT[name]))]:
                self._left.setdefault(library, {})[f"-{name} of {word}"] = None
        names = _names(written)
        if _TILES.search(written):
            raise MeshError(
                f"{library} - {word} is a set of tiles (UDIM; got {written!r:.60}), which are not read - bake them "
                "into one picture, with texture coordinates from 0 to 1"
            )
        file = neighbour(self.path, self._there(names) or names[0], "texture", outside=self._outside)
        return _Map(file, self._pixels(file), numbers, words)

    def _texture(self, one: _Map | None, *, srgb: bool) -> Texture | None:
        return None if one is None else self._made(one.file, srgb, one.wrap)


def _key(name: str) -> str:
    """Return a name as materials are found by it: exporters do not agree with themselves on case and quotes."""
    return bare_name(name).casefold()


def _number(entry: dict[str, str], word: str, default: float, place: int = 0) -> float:
    """Return the number of a word, the first or that at a place; the default where it has none that is finite."""
    try:
        value = float(entry[word].split()[place])
    except (KeyError, ValueError, IndexError):
        return default
    return value if math.isfinite(value) else default


def _of_phong(entry: dict[str, str], default: float) -> float:
    """Return the roughness of a Phong exponent; the default without a highlight."""
    exponent = _number(entry, "ns", -1.0)
    return (2.0 / (exponent + 2.0)) ** 0.25 if exponent >= 0.0 and _number(entry, "ks", 0.0) > 0.0 else default


def _changes_nothing(word: str, entry: dict[str, str]) -> bool:
    """Return whether a material looks as without a word that is not read."""
    plain = _CHANGE_NOTHING.get(word, ())
    try:
        return bool(plain) and all(float(value) in plain for value in entry[word].split())
    except ValueError:
        return False


def _eight_bits(image: Pixels) -> NDArray[np.uint8]:
    """Return code values of 8 bits."""
    return np.asarray(image if image.dtype == np.uint8 else image // 257, np.uint8)


def _resized(grey: NDArray[np.uint8], size: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return one channel (h, w) in another size (rows, columns)."""
    import cv2

    return np.asarray(
        grey if grey.shape == size else cv2.resize(grey, (size[1], size[0]), interpolation=cv2.INTER_AREA)
    )


def _alpha(mask: NDArray[np.uint8], size: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the opacity (rows, columns) of a map: its alpha where that varies, else its brightness."""
    clear = mask.shape[2] == 4 and mask[..., 3].min() < 255
    return _resized(np.ascontiguousarray(mask[..., 3] if clear else mask[..., :3].max(axis=-1)), size)


def _has_normals(image: Pixels) -> bool:
    """Return whether an image has the colours of a map of normals in tangent space."""
    red, green, blue = image[..., :3].reshape(-1, 3).mean(axis=0) / np.iinfo(image.dtype).max
    return bool(blue > _NORMAL_BLUE and max(abs(red - 0.5), abs(green - 0.5)) < _NORMAL_RANGE)
