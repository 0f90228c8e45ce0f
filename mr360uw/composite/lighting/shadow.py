# SPDX-License-Identifier: Apache-2.0
"""Fraction of a light's disc that bodies leave visible, along rays of the reference renderer, and bodies in the water.

Visibility is the mean over directions that fill the disc, each from a place of its own in the footprint. Light that the
water has scattered forwards comes from a wider disc: a Gaussian spread of standard deviation sigma is taken as a disc
of the same second moment (`sphere.effective_half_angle`). The device traces the same rays through filtered columns
(gl/light_visibility.py).

A surface of alpha a lets 1 - a of the light through, n of them the product (glTF 2.0, section 3.9.4); a mask all or
nothing. In the water a body's clear triangles let the same fraction through everywhere, the mean over the body.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, Same
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.raycast import Geometry, gather, opacity_key, surfaces_along
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.rays import PlacedScene, RayScene
from mr360uw.types import Floats

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_STRIDE = 0.24
"""Step through the lattice of places, as a fraction of its points: of those tried, the one of least error at straight
edges whose penumbra is as wide as a pixel, 0.015 by 24 rays. Neighbours in the lattice (1/n) have twice that error."""
_WIDE_STRIDE = 0.54
"""The same for wide rays: edges at all angles, penumbrae of 0.03 to 3 pixels. RMS error 0.015 by 24 rays, 0.021
by 12; with `pixel_offsets` 0.018 and 0.027."""

_ROUNDS = 4
"""Places for each direction at the edge of a shadow. RMS error at straight edges: 0.006 of the
light; with one place 0.014."""
_TURN_OF_PLACES = np.array([0.7549, 0.5698])
"""Shift of the places from round to round: the additive sequence in two dimensions of least discrepancy (1/g and 1/g^2,
g^3 = g + 1)."""


def pixel_offsets(count: int) -> Floats:
    """Return places (count, 2) in [-0.5, 0.5]^2, one for each of `disc_offsets`, that fill a footprint evenly.

    A Fibonacci lattice, in an order in which every ring of the disc meets places all over the footprint: rays of
    direction k from place k sample the disc and the footprint at once.
    """
    k = _strided(count, _STRIDE)
    return np.stack([(k + 0.5) / count, np.remainder(0.5 + k * _GOLDEN, 1.0)], axis=-1) - 0.5


def wide_pixel_offsets(count: int) -> Floats:
    """Return what `pixel_offsets` does, for rays as wide as the part of the footprint that they represent.

    Wide rays fill the gaps of a grid. It has half as many columns as rows, because most footprints on the ground are
    twice as long as wide; every place has a row of its own.
    """
    k, columns = _strided(count, _WIDE_STRIDE), max(round(np.sqrt(0.5 * count)), 1)
    return np.stack([(k % columns + 0.5) / columns, (k + 0.5) / count], axis=-1) - 0.5


def _strided(count: int, stride: float) -> NDArray[np.int64]:
    """Return the numbers below `count` in steps of about a fraction of it, each once."""
    step = next(n for n in range(max(round(stride * count), 1), 2 * count + 2) if math.gcd(n, count) == 1)
    return np.arange(count) * step % count


Passed = Callable[[NDArray[np.int64], Floats, NDArray[np.int64]], Floats]
"""Fraction (m,) of the light that is left of rays in directions of given numbers from starts (m, 3), moved points of
indices (m,)."""
_RAYS_AT_ONCE = 1 << 16
"""Rays traced together, which bounds memory."""


def visible_fraction(passed: Passed, start: Floats, sides: Floats | None, count: int) -> Floats:
    """Return the fraction (n,) of the light of rays in `count` directions that is left, each from its own place of the
    footprint.

    start: (n, 3) middles, sides: (n, 2, 3) of the footprints; None for points. At the edge of a shadow,
    every direction is taken from `_ROUNDS` places.
    """
    every, directions, places = np.arange(len(start)), np.arange(count), pixel_offsets(count)
    foot = start, np.zeros((len(start), 2, 3)) if sides is None else sides
    seen = _free(passed, foot, (directions, places), every)
    if sides is None:
        return seen / count
    partly = (seen > 0) & (seen < count)
    fine = np.flatnonzero(partly | _reaches_edge(passed, foot, seen, count))
    turns = np.arange(1, _ROUNDS)[:, None, None] * _TURN_OF_PLACES
    more = (np.remainder(places + 0.5 + turns, 1.0) - 0.5).reshape(-1, 2)
    fraction = seen / count
    again = _free(passed, foot, (np.tile(directions, _ROUNDS - 1), more), fine)
    fraction[fine] = (seen[fine] + again) / (_ROUNDS * count)
    return np.asarray(fraction)


def _free(
    passed: Passed, foot: tuple[Floats, Floats], rays: tuple[NDArray[np.int64], Floats], chosen: NDArray[np.int64]
) -> Floats:
    """Return how many (m,) of the rays from chosen footprints (m,) are free, each by the fraction of its light that is
    left. foot: middles and sides of all. rays: numbers of their directions (r,), and places (r, 2) in [-0.5, 0.5]^2 of
    their footprints at which they start.
    """
    seen, (directions, places) = np.zeros(len(chosen)), rays
    begin, across, at_once = foot[0][chosen], foot[1][chosen], max(_RAYS_AT_ONCE // max(len(chosen), 1), 1)
    for first in range(0, len(places), at_once):
        some, number = places[first : first + at_once], directions[first : first + at_once]
        begins = begin + np.einsum("rp,mpk->rmk", some, across)
        free = passed(np.repeat(number, len(chosen)), begins.reshape(-1, 3), np.tile(chosen, len(some)))
        seen += free.reshape(len(some), -1).sum(axis=0)
    return seen


def _reaches_edge(passed: Passed, foot: tuple[Floats, Floats], seen: Floats, count: int) -> NDArray[np.bool_]:
    """Return where (n,) all rays were free, or all blocked, but one from a corner of the footprint is not."""
    other = np.zeros(len(seen), np.bool_)
    same = np.flatnonzero((seen == 0) | (seen == count))
    outermost = count - 1 - np.arange(4) * max(count // 13, 1)
    corners = np.repeat([(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)], len(outermost), axis=0)
    free = _free(passed, foot, (np.tile(outermost, 4), corners), same)
    other[same] = free != np.where(seen[same] > 0, len(corners), 0)
    return other


def casting_bodies(shot: Shot, cache: Cache) -> Bodies:
    """Return the bodies of a shot's objects that cast shadows, in the world. cache: holds them."""
    return cache.of(_in_world, shot.casters, cache)


def _in_world(casters: tuple[PlacedObject, ...], cache: Cache) -> Bodies:
    keep = 2 * len(casters)
    found: list[tuple[RayScene, PlacedObject, float]] = []
    for placed in casters:
        solid, clear = cache.of(_scenes, _shape(placed.mesh), keep=keep)
        found.append((solid, placed, 0.0))
        if len(clear.triangles):
            found.append((clear, placed, cache.of(_mean_passed, _shape(placed.mesh.still), keep=keep)))
    found = [(scene, placed, passed) for scene, placed, passed in found if len(scene.triangles) and passed < 1.0]
    return Bodies(
        tuple(PlacedScene(scene, placed.world_from_object) for scene, placed, _ in found),
        np.array([placed.to_world(placed.mesh.center_m) for _, placed, _ in found]).reshape(-1, 3),
        np.array([placed.mesh.radius_m * placed.scale for _, placed, _ in found]),
        np.array([passed for *_, passed in found]),
    )


def _shape(mesh: Mesh) -> PartOf[Mesh]:
    return PartOf(mesh, Same(mesh.positions), Same(mesh.material), opacity_key(mesh))


def _scenes(shape: PartOf[Mesh]) -> tuple[RayScene, RayScene]:
    """Return the opaque triangles of a mesh and the others."""
    mesh = shape.whole
    opaque = np.array([m.alpha_mode == "OPAQUE" for m in mesh.materials])[mesh.material]
    return RayScene(mesh.positions[opaque]), RayScene(mesh.positions[~opaque])


_ACROSS = 48
"""Parallel rays along each side of the square around a mesh that find what its clear triangles let through."""


def _mean_passed(shape: PartOf[Mesh]) -> float:
    """Return the mean fraction of light that a mesh's clear triangles let through, of rays along its axes that meet
    them.
    """
    mesh = shape.whole
    clear = ClearScene(gather([PlacedObject(mesh, np.eye(4))], np.zeros(3)))
    line = ((np.arange(_ACROSS) + 0.5) / _ACROSS * 2.0 - 1.0) * mesh.radius_m
    u, v = (g.ravel() for g in np.meshgrid(line, line))
    origin = np.concatenate([np.roll(np.stack([u, v, 0 * u - 2.0 * mesh.radius_m], -1), k, -1) for k in range(3)])
    rays = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], len(u), axis=0)
    passed, met = clear.passed(origin + mesh.center_m, rays, np.inf)
    return float(passed[met].mean()) if np.any(met) else 1.0


_SHORTEST_M = 1e-6
"""Shortest step [m] behind a surface that lets light through."""


class ClearScene:
    """Those of some triangles that let light through, of MASK and BLEND materials."""

    def __init__(self, every: Geometry) -> None:
        self._geometry = every.some(np.flatnonzero(~_opaque(every)))

    @property
    def there(self) -> bool:
        """Whether there are any such triangles."""
        return len(self._geometry.positions) > 0

    def passed(self, origins: Floats, directions: Floats, reach_m: Floats | float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the fraction (n,) of the light of rays that they leave within `reach_m` [m], and which rays (n,) meet
        any.
        """
        met = surfaces_along(self._geometry, origins, directions, _SHORTEST_M, reach_m)
        passed = np.maximum(1.0 - np.bincount(met.ray, met.part, len(origins)), 0.0)
        return passed, np.bincount(met.ray, minlength=len(origins)) > 0


def _opaque(geometry: Geometry) -> NDArray[np.bool_]:
    """Return which triangles (T,) let no light through."""
    return np.array([m.alpha_mode == "OPAQUE" for m in geometry.materials], np.bool_)[geometry.material]


class Blockers:
    """The triangles of a shot that cast shadows."""

    def __init__(self, shot: Shot) -> None:
        every = gather(shot.casters, shot.view.position)
        self._opaque, self._clear = RayScene(every.positions[_opaque(every)]), ClearScene(every)

    @property
    def there(self) -> bool:
        """Whether there is any such triangle."""
        return len(self._opaque.triangles) > 0 or self._clear.there

    def passed(self, start: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> Floats:
        """Return the fraction (n,) of the light of rays that is left within `reach_m` [m] of their start, (n, 3) from
        the camera.
        """
        passed: Floats = np.asarray(~self._opaque.occluded(start, directions, reach_m), np.float64)
        if self._clear.there:
            free = np.flatnonzero(passed)
            reach = np.broadcast_to(reach_m, len(start))[free]
            passed[free] = self._clear.passed(start[free], directions[free], reach)[0]
        return passed
