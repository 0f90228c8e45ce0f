# SPDX-License-Identifier: Apache-2.0
"""Which axis of a mesh file points up, where its format does not say (STL, OBJ, PLY), and what kind of thing it shows.

The axis is told by words in the file's comments or name, by the program that wrote it, or by the shape: things are as a
rule mirror-symmetric across a vertical plane and stand on something flat. Where none of these tells, it is y. Kinds are
known by words in the names of files and parts.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

from mr360uw.base.input_files import own_table
from mr360uw.composite.mesh.material import MeshFile
from mr360uw.types import Floats

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
