# SPDX-License-Identifier: Apache-2.0
"""What a mesh shows by itself: the kind of thing, its size in metres, its front, and whether it stands on a floor.

The kind is told by words in the names of its file and parts. Of the axes x and z, that one is its left-right axis about
which it is clearly more mirror-symmetric. The other one points to its front; of a body that is longest along it, the
thicker end is the front (heads are thicker than tails). Where that does not tell, +z is the front, as glTF has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw.composite import Mesh
from mr360uw.composite.mesh.kinds import Habit, Kind, kind_of
from mr360uw.composite.mesh.mesh import METRES, Unit, mesh_of_file, object_from_file
from mr360uw.composite.mesh.mesh_file import read_mesh_file
from mr360uw.composite.mesh.up_axis import Up, asymmetry, surface_points, up_axis
from mr360uw.composite.object_settings import Front
from mr360uw.types import Floats

_UNITS: dict[Unit, str] = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
_LOW_M, _HIGH_M, _TYPICAL_M = 0.1, 20.0, 1.0
"""Sizes of things of an unknown kind."""
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
    of thing, or None. clips: names of its animations. up: the axis of its file that is up, or "auto" where the file
    says it; why_up: what tells it.
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
    up: Up = "auto"
    why_up: str = ""


def look_at_mesh(path: Path, *, up: Up = "auto", outside_files: bool = False) -> MeshLook:
    """Return what a mesh shows; raise `MeshError` where it cannot be read. up: its upward axis, if known."""
    file = read_mesh_file(path, outside=outside_files)
    axis, why_up = (up, "asked for") if up != "auto" else up_axis(path, file)
    mesh = mesh_of_file(path, file, object_from_file(path, file, "auto", axis)[0])
    clips = () if file.rigging is None else file.rigging.clips
    kind = kind_of(path.stem, (part.name for part in file.parts))
    longest = float(np.max(mesh.extent_m))
    size, why = _size(kind, longest, cad=file.cad or (file.head is not None and axis == "z"))
    front, why_front, long = _front(mesh, kind)
    x, y, z = (mesh.extent_m / longest).tolist()
    habit: Habit = kind.habit if kind else "stands"
    known = up == "auto" and file.head is None
    return MeshLook(
        path, kind, size, why, (x, y, z), front, why_front, long, habit, clips, "auto" if known else axis,
        why_up or "nothing shows another",
    )  # fmt: skip


def _size(kind: Kind | None, units: float, *, cad: bool) -> tuple[float, str]:
    """Return the length [m] of the longest side, which the file has in `units`, and the reason.

    Metres where they fit. Of other units that fit, machines are in millimetres (cad), and other things are in that of
    which their size is nearer to the usual one.
    """
    low, high, typical = (kind.low_m, kind.high_m, kind.typical_m) if kind else (_LOW_M, _HIGH_M, _TYPICAL_M)
    what = f"a {kind.word}" if kind else "a thing"
    sizes = {name: units * METRES[unit] for unit, name in _UNITS.items()}
    fitting = [name for name, size in sizes.items() if low <= size <= high]
    if not fitting:
        return typical, f"its {units:.3g} units fit no unit for {what}, so a typical size"
    usual = min(fitting, key=lambda name: abs(math.log(sizes[name] / typical)))
    name = fitting[0] if "metres" in fitting else fitting[-1] if cad else usual
    return float(f"{sizes[name]:.3g}"), f"its {units:.3g} units are {name}"


def _front(mesh: Mesh, kind: Kind | None) -> tuple[Front, str, bool]:
    """Return the front, the reason, and whether the body is longer than wide."""
    points = surface_points(mesh.positions) - mesh.center_m
    unlike = {axis: asymmetry(points, axis) for axis in (0, 2)}
    length = {axis: float(mesh.extent_m[axis]) for axis in (0, 2)}
    lateral = min(unlike, key=lambda axis: unlike[axis])
    if unlike[lateral] < _CLEARLY * unlike[2 - lateral]:
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


def _thicker_end(points: Floats, axis: int, extent: Floats) -> float:
    """Return the logarithm of the cross-section near the positive end of an axis over that near the negative end."""
    along = points[:, axis] / extent[axis]
    ends = []
    for low, high in ((0.2, 0.4), (-0.4, -0.2)):
        there = points[(along > low) & (along < high)]
        ends.append(np.ptp(there[:, 1]) * np.ptp(there[:, 2 - axis]) if len(there) > 1 else 0.0)
    least = 1e-9 * float(np.max(extent)) ** 2
    return float(np.log((ends[0] + least) / (ends[1] + least)))
