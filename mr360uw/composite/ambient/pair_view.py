# SPDX-License-Identifier: Apache-2.0
"""What sites of one body see of another: a function of both meshes and of their relative pose alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.directions import COUNT, directions
from mr360uw.composite.ambient.mesh_transfer import Transfer, met_sites
from mr360uw.composite.ambient.relative_pose import RelativePose
from mr360uw.types import Floats

_UNNOTICED, _NOTICED = 0.004, 0.008
"""Bodies that block less of each other's ambient light than the first share, about a code value, are not looked at;
from the second on they show whole."""
_EXACT, _INTERPOLATED = 1.0, 2.0
"""Sites nearer to another body than so many spacings of the lookouts look themselves, and those beyond so many take
what the lookouts see; between the two they pass from one to the other."""


@dataclass(frozen=True, slots=True, eq=False)
class PairView:
    """What r sites see of another body, as m rays that meet it first.

    site: (m,) ascending numbers below r; direction: (m,); met: (m,) lookout of the other that is nearest to the place;
    distance: (m,) in the first mesh's metres. share: the part of it that shows.
    """

    site: NDArray[np.int32]
    direction: NDArray[np.int32]
    met: NDArray[np.int32]
    distance: NDArray[np.float32]
    share: float


def share_shown(transfer: Transfer, other: Transfer, pose: RelativePose) -> float:
    """Return the part of another mesh, at a pose in the frame of a first, that shows in the light of the first."""
    center, radius = _ball(other, pose)
    gap = max(_norm(center - transfer.mesh.center_m) - transfer.mesh.radius_m, radius)
    t = min(max(((radius / gap) ** 2 - _UNNOTICED) / (_NOTICED - _UNNOTICED), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def may_show(center: Floats, radius: Floats, number: int) -> NDArray[np.bool_]:
    """Return which of the bodies in balls (n, 3), (n,) may show in the light of one of them, never that one itself."""
    gap = np.maximum(np.linalg.norm(center - center[number], axis=-1) - radius[number], radius)
    shown = (radius / gap) ** 2 > 0.999 * _UNNOTICED
    shown[number] = False
    return np.asarray(shown)


def _norm(way: Floats) -> float:
    return math.hypot(*way.tolist())


def _ball(other: Transfer, pose: RelativePose) -> tuple[Floats, float]:
    return pose.linear @ other.mesh.center_m + pose.shift, other.mesh.radius_m * pose.scale


def pair_view(
    transfer: Transfer,
    place: Floats,
    open_: NDArray[np.bool_],
    other: Transfer,
    pose: RelativePose,
) -> PairView:
    """Return what places (r, 3) of a mesh see of another in the directions that are open (r, COUNT).

    pose: of the other in the frame of the first.
    """
    center, radius = _ball(other, pose)
    site, direction = _towards(place, open_, center - transfer.mesh.center_m, transfer.mesh.radius_m, center, radius)
    back = np.linalg.inv(pose.linear).T
    origin, rays = ((place - pose.shift) @ back)[site], (directions() @ back)[direction]
    triangle = other.scene.first_hit(origin, rays)
    hit = np.flatnonzero(triangle >= 0)
    met, distance, _ = met_sites(other, origin[hit], rays[hit], triangle[hit])
    narrow = (site[hit].astype(np.int32), direction[hit].astype(np.int32), other.lookouts.of[met].astype(np.int32))
    return PairView(*narrow, distance.astype(np.float32), share_shown(transfer, other, pose))


def _towards(
    place: Floats, open_: NDArray[np.bool_], to: Floats, radius: float, center: Floats, other_radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the open directions, as pairs of site and direction, into the ball around another body."""
    apart = _norm(to)
    sine = (radius + other_radius) / max(apart, 1e-12)
    # directions that lead into it from some site: few of a body that stands apart
    near = np.arange(COUNT)
    if sine < 1.0:
        near = np.flatnonzero(directions() @ to >= apart * np.sqrt(1.0 - sine * sine))
    found = np.empty((2, len(place) * len(near)), np.int64)
    total = _into_ball(place, open_, directions(), near, center, other_radius, found)
    return found[0, :total], found[1, :total]


@numba.njit(nogil=True, cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _into_ball(place: Any, open_: Any, d: Any, near: Any, center: Any, radius: Any, found: Any) -> Any:
    """Write site and direction of the open rays into a ball to `found` (2, most); return how many there are."""
    total = 0
    for s in range(len(place)):
        x, y, z = center[0] - place[s, 0], center[1] - place[s, 1], center[2] - place[s, 2]
        squared = x * x + y * y + z * z
        outside = squared - radius * radius
        for k in near:
            if open_[s, k]:
                along = x * d[k, 0] + y * d[k, 1] + z * d[k, 2]
                if along * along >= outside and (along > 0.0 or outside < 0.0):
                    found[0, total], found[1, total] = s, k
                    total += 1
    return total


@numba.njit(nogil=True, cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def find_nearest_within(points: Any, places: Any, reach: Any, distance: Any) -> None:
    """Set the distances (n,) of points (n, 3) from the nearest of places (m, 3), infinite where it is `reach` or more.

    places: ascending in x. They are tried from a point's own x on, both ways, while the difference in x allows.
    """
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        low, high = 0, len(places)
        while low < high:
            middle = (low + high) // 2
            if places[middle, 0] < x:
                low = middle + 1
            else:
                high = middle
        bound = reach * reach
        best = bound
        for step in (1, -1):
            k = low if step == 1 else low - 1
            while 0 <= k < len(places):
                dx = places[k, 0] - x
                if dx * dx >= best:
                    break
                dy, dz = places[k, 1] - y, places[k, 2] - z
                best = min(best, dx * dx + dy * dy + dz * dz)
                k += step
        distance[n] = np.sqrt(best) if best < bound else np.inf


def near_sites(transfer: Transfer, other: Transfer, pose: RelativePose) -> NDArray[np.float64] | None:
    """Return (S,) how far the sites of a mesh have passed from interpolating (0) to looking themselves (1); None where
    the bodies are so far apart that none has.
    """
    mesh, spacing, position = transfer.mesh, transfer.lookouts.spacing_m, transfer.lattice.position
    (center, radius), reach = _ball(other, pose), _INTERPOLATED * spacing
    if _norm(center - mesh.center_m) > mesh.radius_m + radius + reach:
        return None
    part = np.zeros(len(position))
    close = np.flatnonzero(np.linalg.norm(position - center, axis=-1) < radius + reach)
    there = (position[close] - pose.shift) @ np.linalg.inv(pose.linear).T
    distance = np.empty(len(there))
    find_nearest_within(there, other.along_x, reach / pose.scale, distance)
    t = np.clip((_INTERPOLATED - distance * pose.scale / spacing) / (_INTERPOLATED - _EXACT), 0.0, 1.0)
    part[close] = t * t * (3.0 - 2.0 * t)
    return part
