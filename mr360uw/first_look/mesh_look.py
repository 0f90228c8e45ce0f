# SPDX-License-Identifier: Apache-2.0
"""What a mesh shows by itself: the kind of thing, its size in metres, its front, and whether it stands on a floor.

The kind is told by words in the names of its file and parts. Of the axes x and z, that one is its left-right axis about
which it is clearly more mirror-symmetric. The other one points to its front; of a body that is longest along it, the
thicker end is the front (heads are thicker than tails). Where that does not tell, +z is the front, as glTF has it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.composite import Mesh
from mr360uw.composite.mesh.mesh import METRES, mesh_of_file
from mr360uw.composite.mesh.mesh_file import read_mesh_file
from mr360uw.composite.object_settings import Front
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
    blunt: bool = True


def _kinds(rows: str, habit: Habit, *, blunt: bool = True) -> list[Kind]:
    found = []
    for row in rows.split(";"):
        word, low, high, typical = row.split()
        found.append(Kind(word, float(low), float(high), float(typical), habit, blunt))
    return found


KINDS: tuple[Kind, ...] = (
    *_kinds(
        "whaleshark 3 14 7; whale 3 30 8; orca 3 9 6; dolphin 1 4 2.5; porpoise 1 2.5 1.6; shark 0.5 7 2.5; "
        "hammerhead 0.9 6 3; seahorse 0.02 0.4 0.12; cuttlefish 0.1 1.2 0.4; clownfish 0.05 0.18 0.1; "
        "goldfish 0.05 0.4 0.15; jellyfish 0.05 2.5 0.4; starfish 0.05 0.6 0.2; crayfish 0.1 0.6 0.25; "
        "fish 0.05 2.5 0.4; barramundi 0.2 1.8 0.8; snapper 0.1 1.2 0.4; grouper 0.2 2.5 0.8; tuna 0.4 4 1.5; "
        "salmon 0.3 1.5 0.8; barracuda 0.3 2 1; manta 1 8 4; ray 0.3 8 1.5; eel 0.3 3 1; turtle 0.2 2.5 1; "
        "seal 0.8 4 1.8; squid 0.1 13 0.5; octopus 0.1 4 0.8; penguin 0.3 1.2 0.7; duck 0.05 0.7 0.4",
        "swims",
    ),
    *_kinds(
        "jelly 0.05 2.5 0.4; scuba 1.2 2.6 1.9; diver 1.2 2.6 1.9; swimmer 1.2 2.5 1.8; mermaid 1.2 2.8 1.9; "
        "submarine 2 180 12; rov 0.3 3 0.9; auv 0.8 7 2; drone 0.1 2 0.4; robot 0.2 3 1; torpedo 1 8 5",
        "swims",
        blunt=False,
    ),
    *_kinds(
        "bird 0.1 3 0.6; gull 0.3 1.7 1.2; pelican 1 3.4 2.5; parrot 0.15 1 0.4; eagle 0.6 2.5 2; balloon 0.2 30 0.4; "
        "kite 0.3 5 1; butterfly 0.02 0.3 0.08; airship 10 250 60",
        "flies",
        blunt=False,
    ),
    *_kinds(
        "crab 0.05 0.6 0.25; lobster 0.15 0.9 0.4; bunny 0.1 0.6 0.3; rabbit 0.1 0.7 0.4; cow 1.2 3 2.2; "
        "horse 1.2 3 2.3; dog 0.3 1.5 0.9",
        "stands",
    ),
    *_kinds(
        "shipwreck 3 150 15; wreck 3 150 12; ship 4 300 20; boat 1.5 20 5; anchor 0.3 4 1.2; propeller 0.2 9 1.5; "
        "cannon 0.8 4 2.2; amphora 0.3 1.5 0.8; chest 0.3 1.5 0.9; barrel 0.5 1.5 0.9; coral 0.05 4 0.6; "
        "sponge 0.05 2 0.6; rock 0.1 10 1.2; boulder 0.4 10 1.5; statue 0.3 6 1.8; column 0.5 12 3; temple 3 60 12; "
        "car 2.5 6 4.3; truck 3 18 5; bus 5 19 11; plane 5 75 10; bottle 0.08 0.5 0.25; person 1.2 2.2 1.75; "
        "human 1.2 2.2 1.75; "
        "mannequin 1.2 2.2 1.8; dummy 0.5 2.2 1.8; man 1.4 2.2 1.8; woman 1.3 2.1 1.7; soldier 1.2 2.2 1.8; "
        "crate 0.3 2.5 0.8; chair 0.4 1.6 0.9; table 0.4 3 1.4",
        "stands",
        blunt=False,
    ),
)
"""Kinds in the order in which their words are looked for. Lengths of grown animals and common things, with margins for
young and large ones; the limits only decide which unit a file is in."""


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
    for kind in KINDS:
        hit = kind.word in words or f"{kind.word}s" in words or (len(kind.word) > 4 and kind.word in joined)
        if hit or (kind.word == "fish" and any(word.endswith("fish") for word in words)):
            return kind
    return None


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
