# SPDX-License-Identifier: Apache-2.0
"""What sites of one body see of another: a function of both meshes and of their relative pose alone.

Rays of all pairs whose second is the same mesh are cast in one call: of many bodies each pair has only a few.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.among.relative_pose import RelativePose
from mr360uw.composite.ambient.directions import COUNT, directions
from mr360uw.composite.ambient.mesh_transfer import Transfer, met_sites
from mr360uw.jit import exact
from mr360uw.types import Floats

_UNNOTICED, _NOTICED = 0.004, 0.008
"""Bodies that block less of each other's ambient light than the first share, about a code value, are not looked at;
from the second on they show whole."""

_EXACT, _INTERPOLATED = 1.0, 2.0
"""Sites nearer to another body than so many spacings of the lookouts look themselves, and those beyond so many take
what the lookouts see; between the two they pass from one to the other."""

_RAYS_AT_ONCE = 1 << 21
"""Places times directions that are tried, 8 bytes each, whose rays are cast at once. With half as many there are more
calls."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Places (r, 3) of one mesh that look in their open directions (r, COUNT) for another at a pose in the frame of the
    first, of which a `share` shows.
    """

    transfer: Transfer
    place: Floats
    open_: NDArray[np.bool_]
    other: Transfer
    pose: RelativePose
    share: float


def pair_views(pairs: Sequence[Pair]) -> list[PairView]:
    """Return what the first of each pair sees of the second; rays at one mesh are cast together."""
    found: dict[int, PairView] = {}
    of_scene: dict[int, list[int]] = {}
    for number, pair in enumerate(pairs):
        of_scene.setdefault(id(pair.other.scene), []).append(number)
    near = [_directions_near(pair) for pair in pairs]
    for numbers in of_scene.values():
        tried = np.cumsum([len(pairs[k].place) * len(near[k]) for k in numbers])
        part = (tried - 1) // _RAYS_AT_ONCE
        for one in np.unique(part).tolist():
            few = [numbers[at] for at in np.flatnonzero(part == one).tolist()]
            found |= zip(few, _views_of_one([pairs[k] for k in few], [near[k] for k in few]), strict=True)
    return [found[number] for number in range(len(pairs))]


def _views_of_one(pairs: Sequence[Pair], near: Sequence[NDArray[np.int64]]) -> list[PairView]:
    """Return the views of pairs whose second is the same mesh. near: `_directions_near` each."""
    first = pairs[0].other
    back = np.linalg.inv(np.array([pair.pose.linear for pair in pairs])).transpose(0, 2, 1)
    there = [(pair.place - pair.pose.shift) @ turn for pair, turn in zip(pairs, back, strict=True)]
    ways, begin, total = directions() @ back, np.zeros(len(pairs) + 1, np.int64), 0
    found = np.empty((2, sum(len(pair.place) * len(ahead) for pair, ahead in zip(pairs, near, strict=True))), np.int32)
    for k, (pair, ahead) in enumerate(zip(pairs, near, strict=True)):
        total += _into_ball(
            pair.place, pair.open_, directions(), ahead, *_ball(pair.other, pair.pose), found[:, total:]
        )
        begin[k + 1] = total
    rows = np.cumsum([0, *(len(of) for of in there)])
    origin, rays = np.empty((2, total, 3), np.float32)
    _set_rays(begin, found, rows, np.concatenate(there), ways, origin, rays)
    triangle = first.scene.first_hit(origin, rays)
    hit = np.flatnonzero(triangle >= 0)
    number, (site, direction) = np.searchsorted(begin, hit, side="right") - 1, found[:, hit]
    starts, along = np.concatenate(there)[rows[number] + site], ways[number, direction]
    met, distance, _ = met_sites(first, starts, along, triangle[hit])
    ends = np.searchsorted(hit, begin)
    lookout, away = first.lookouts.of[met].astype(np.int32), distance.astype(np.float32)
    of_pair = [slice(ends[k], ends[k + 1]) for k in range(len(pairs))]
    return [
        PairView(site[one], direction[one], lookout[one], away[one], pair.share)
        for one, pair in zip(of_pair, pairs, strict=True)
    ]


def _directions_near(pair: Pair) -> NDArray[np.int64]:
    """Return the directions that lead from some site of a mesh into the ball around another: few if it stands apart."""
    center, radius = _ball(pair.other, pair.pose)
    to = center - pair.transfer.mesh.center_m
    apart = _norm(to)
    sine = (pair.transfer.mesh.radius_m + radius) / max(apart, 1e-12)
    if sine >= 1.0:
        return np.arange(COUNT)
    return np.flatnonzero(directions() @ to >= apart * np.sqrt(1.0 - sine * sine))


@exact
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


@exact
def _set_rays(begin: Any, found: Any, rows: Any, there: Any, ways: Any, origin: Any, rays: Any) -> None:
    """Set where rays (n, 3) of p pairs start and lead, those of pair k from begin[k] on, from their sites and
    directions `found` (2, n). there: (m, 3) places of all pairs, those of pair k from rows[k] on; ways: (p, COUNT, 3).
    """
    for k in range(len(begin) - 1):
        for n in range(begin[k], begin[k + 1]):
            for c in range(3):
                origin[n, c] = there[rows[k] + found[0, n], c]
                rays[n, c] = ways[k, found[1, n], c]


@exact
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
