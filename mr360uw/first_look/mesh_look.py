# SPDX-License-Identifier: Apache-2.0
"""What a mesh shows by itself: its size in metres, its front, and whether it stands on a floor.

Of the axes x and z, that one is its left-right axis about which it is clearly more mirror-symmetric. The other one
points to its front; of a body that is longest along it, the thicker end is the front (heads are thicker than tails).
Where that does not tell, +z is the front, as glTF has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw.composite import Mesh
from mr360uw.composite.mesh.mesh import METRES, mesh_of_file
from mr360uw.composite.mesh.mesh_file import read_mesh_file
from mr360uw.composite.object_settings import Front
from mr360uw.first_look.mesh_words import Habit, Kind, kind_of
from mr360uw.types import Floats

_LOW_M, _HIGH_M, _TYPICAL_M = 0.1, 20.0, 1.0
"""Sizes of things of an unknown kind."""
_POINTS = 3000
"""Points on the surface that are looked at: the symmetry differs by a tenth with another choice of them."""
_CLEARLY = 0.6
"""Ratio of the asymmetries about two axes below which the lesser one is the left-right axis."""
_LONG = 0.8
"""Length over width from which a body counts as long, so that its thicker end may be a head."""
_THICKER = 0.4
"""Logarithm of the ratio of cross-sections near both ends from which one is the thicker."""


@dataclass(frozen=True, slots=True)
class MeshLook:
    """What was found in a mesh. size_m: its longest side. why_size: the reason, in words.

    extent: (3,) sides over the longest. front: the side that is its front. long: whether it is longer than wide. kind:
    of thing, or None. clips: names of its animations.
    """

    path: Path
    kind: Kind | None
    size_m: float
    why_size: str
    extent: tuple[float, float, float]
    front: Front
    why_front: str
    long: bool
    habit: Habit
    clips: tuple[str, ...]


def look_at_mesh(path: Path, *, outside_files: bool = False) -> MeshLook:
    """Return what a mesh shows; raise `MeshError` where it cannot be read."""
    file = read_mesh_file(path, outside=outside_files)
    mesh, clips = mesh_of_file(path, file), () if file.rigging is None else file.rigging.clips
    kind = kind_of(path.stem, (part.name for part in file.parts))
    longest = float(np.max(mesh.extent_m))
    size, why = _size(kind, longest)
    front, why_front, long = _front(mesh, kind)
    x, y, z = (mesh.extent_m / longest).tolist()
    return MeshLook(path, kind, size, why, (x, y, z), front, why_front, long, kind.habit if kind else "stands", clips)


def _size(kind: Kind | None, units: float) -> tuple[float, str]:
    """Return the length [m] of the longest side, which the file has in `units`, and the reason."""
    low, high, typical = (kind.low_m, kind.high_m, kind.typical_m) if kind else (_LOW_M, _HIGH_M, _TYPICAL_M)
    what = f"a {kind.word}" if kind else "a thing"
    for unit, name in (("m", "metres"), ("cm", "centimetres"), ("mm", "millimetres")):
        size = units * METRES[unit]  # type: ignore[index]
        if low <= size <= high:
            return float(f"{size:.3g}"), f"its {units:.3g} units are {name}"
    return typical, f"its {units:.3g} units fit no unit for {what}, so a typical size"


def _front(mesh: Mesh, kind: Kind | None) -> tuple[Front, str, bool]:
    """Return the front, the reason, and whether the body is longer than wide."""
    points = _surface_points(mesh) - mesh.center_m
    asymmetry = {axis: _asymmetry(points, axis) for axis in (0, 2)}
    length = {axis: float(mesh.extent_m[axis]) for axis in (0, 2)}
    lateral = min(asymmetry, key=lambda axis: asymmetry[axis])
    if asymmetry[lateral] < _CLEARLY * asymmetry[2 - lateral]:
        axis, why = 2 - lateral, "by its symmetry"
    else:
        axis, why = (0 if length[0] > 1.05 * length[2] else 2), "by its length"
    long = length[axis] > _LONG * length[2 - axis]
    thicker = _thicker_end(points, axis, mesh.extent_m)
    if long and (kind is None or kind.blunt) and abs(thicker) > _THICKER:
        sign, why = "+" if thicker > 0.0 else "-", f"{why}, its thicker end"
    else:
        sign = "+"
    return _named(sign, axis), why, long


def _named(sign: str, axis: int) -> Front:
    names: dict[tuple[str, int], Front] = {("+", 0): "+x", ("-", 0): "-x", ("+", 2): "+z", ("-", 2): "-z"}
    return names[sign, axis]


def _surface_points(mesh: Mesh) -> Floats:
    """Return points (n, 3) spread evenly over the area of a mesh, the same for the same mesh."""
    a, b, c = (mesh.positions[:, k] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(area), _POINTS, p=area / area.sum())
    u, v = rng.random((2, _POINTS, 1))
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    return np.asarray(a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen])


def _asymmetry(points: Floats, axis: int) -> float:
    """Return the mean distance from mirrored points (n, 3) to the nearest points, [m]."""
    from scipy.spatial import cKDTree

    mirrored = points.copy()
    mirrored[:, axis] *= -1.0
    return float(np.mean(cKDTree(points).query(mirrored)[0]))


def _thicker_end(points: Floats, axis: int, extent: Floats) -> float:
    """Return the logarithm of the cross-section near the positive end of an axis over that near the negative end."""
    along = points[:, axis] / extent[axis]
    ends = []
    for low, high in ((0.2, 0.4), (-0.4, -0.2)):
        there = points[(along > low) & (along < high)]
        ends.append(np.ptp(there[:, 1]) * np.ptp(there[:, 2 - axis]) if len(there) > 1 else 0.0)
    least = 1e-9 * float(np.max(extent)) ** 2
    return float(np.log((ends[0] + least) / (ends[1] + least)))
