# SPDX-License-Identifier: Apache-2.0
"""Bodies that take light away: visible fractions of a distant disc of light, by rays and by maps, and first hits of
camera rays.

A point needs shadow rays only where its cone of directions meets a body's bounding sphere. With t the distance of the
sphere's centre along the cone's axis, h that across it, R its radius and alpha the half angle of the cone:

    t > -R        h < R/cos(alpha) + max(t, 0) tan(alpha)

A shadow map is a square across the bounding sphere of a body and holds, for parallel light of one direction, how far up
along that direction the body reaches, seen from the sphere's centre. A point is in shadow where it lies below that:
exact but for the width of a pixel, also between the parts of a body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Same
from mr360uw.base.parameters import numbers
from mr360uw.base.rays import PlacedScene, RayScene, raise_to_triangles
from mr360uw.base.sphere import basis
from mr360uw.errors import ParameterError
from mr360uw.jit import exact, exact_making
from mr360uw.types import Array, Floats

_BEYOND_M = 1e-4
"""How far [m] behind a hit the next one is searched for: above the roundings of rays, below the size of a body."""
_ROUND = 1.001
"""Factor on the radius of a body's sphere within which rays are cast at it: above the roundings of rays."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Step from place to place along a segment, as a fraction of it."""


@runtime_checkable
class Occluder(Protocol):
    """A body of any kind. Origins (n, 3) [m] in the world, directions (n, 3) unit.

    An attribute `bounding_sphere`, (centre (3,), radius) [m], spares rays to points that the body cannot shade.
    """

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) meets the body nearer than `reach_m` [m]."""

    def distance(self, origins: Floats, directions: Floats) -> Floats:
        """Return the distance (n,) [m] at which each ray meets the body first, infinity where it does not."""


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Bodies with the spheres around them. centre: (k, 3), radius: (k,) [m]; infinite where it is not known.

    passed: (k,) fraction of light that each lets through; rays of the camera end at those of none.
    """

    occluders: tuple[Occluder, ...]
    centre: Array
    radius: Array
    passed: Array

    def first_clear_m(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Return the distance (n,) [m] of the nearest body that lets light through along rays (n, 3), infinity for
        none, and the fraction (n,) that all of them let through together.
        """
        nearest, passed = np.full(len(directions), np.inf), np.ones(len(directions))
        for number in np.flatnonzero(self.passed > 0.0).tolist():
            distance = self.occluders[number].distance(origin, directions)
            nearest = np.minimum(nearest, distance)
            passed[np.isfinite(distance)] *= self.passed[number]
        return nearest, passed

    def first_hit_m(self, origin: Array, directions: Array) -> Array:
        """Return the distance (n,) [m] of the nearest opaque body along rays (n, 3) from one point, else infinity."""
        nearest = np.full(len(directions), np.inf)
        for number in np.flatnonzero(self.passed == 0.0).tolist():
            body, centre, radius = self.occluders[number], self.centre[number], _ROUND * self.radius[number]
            to = np.broadcast_to(centre - origin, directions.shape)
            along, away = np.einsum("nk,nk->n", to, directions), np.einsum("nk,nk->n", to, to)
            outside = away - radius**2
            near = np.flatnonzero((outside <= 0.0) | ((along > 0.0) & (along * along >= outside)))
            start = np.broadcast_to(origin, directions.shape)[near]
            nearest[near] = np.minimum(nearest[near], body.distance(start, directions[near]))
        return nearest

    def inside_m(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Return the distances (n,) [m] between which rays (n, 3) from one point are inside their first opaque body."""
        enter = self.first_hit_m(origin, directions)
        leave = np.full(len(directions), np.inf)
        met = np.flatnonzero(np.isfinite(enter))
        start = origin + (enter[met, None] + _BEYOND_M) * directions[met]
        for body in (b for b, passed in zip(self.occluders, self.passed, strict=True) if passed == 0.0):
            leave[met] = np.minimum(leave[met], enter[met] + _BEYOND_M + body.distance(start, directions[met]))
        return enter, leave

    def visible(self, point: Array, directions: Array, along: Array | None = None) -> Array:
        """Return the fraction (n,) of the light of k directions (k, 3) about one axis that is left at points (n, 3).

        along: (n, 3) [m] of straight segments about the points, over which the fraction is averaged: each direction is
        tested from its own place.
        """
        places = np.remainder(np.arange(len(directions)) * GOLDEN + 0.5, 1.0) - 0.5
        left = np.ones((len(directions), len(point)))
        axis = directions.mean(axis=0)
        axis = axis / np.linalg.norm(axis)
        cosine = float(np.min(directions @ axis))
        bodies = zip(self.occluders, self.centre, self.radius, self.passed, strict=True)
        for body, centre, radius, passed in bodies:
            wide = float(radius) + (0.0 if along is None else 0.5 * np.linalg.norm(along, axis=-1))
            near = np.flatnonzero(_meets_cone(centre - point, axis, min(cosine, 1.0), wide))
            for k, direction in enumerate(directions):
                start = point[near] if along is None else point[near] + places[k] * along[near]
                shaded = body.occluded(start, np.broadcast_to(direction, (len(near), 3)))
                left[k, near[shaded]] *= passed
        return np.asarray(left.mean(axis=0))

    def visible_from(self, point: Array, place: Array, least_m: float) -> Array:
        """Return the fraction (n,) of light from a place (3,) that is left at points (n, 3).

        least_m: distance [m] from the place within which nothing takes its light away.
        """
        away = place - point
        length = np.linalg.norm(away, axis=-1)
        towards = away / np.maximum(length, 1e-9)[:, None]
        seen = np.ones(len(point))
        for body, passed in zip(self.occluders, self.passed, strict=True):
            seen[body.occluded(point, towards, np.maximum(length - least_m, 0.0))] *= passed
        return seen


def _meets_cone(to_centre: Array, axis: Array, cosine: float, radius: Floats | float) -> NDArray[np.bool_]:
    along = to_centre @ axis
    across = np.sqrt(np.maximum(np.sum(to_centre * to_centre, axis=-1) - along * along, 0.0))
    tangent = np.sqrt(1.0 - cosine * cosine) / cosine
    return np.asarray((along > -radius) & (across <= radius / cosine + np.maximum(along, 0.0) * tangent))


def bodies_of(bodies: Sequence[Any] | Bodies) -> Bodies:
    """Return bodies that are given as triangles (T, 3, 3) [m] in the world, objects with such `triangles`, or
    `Occluder`s.

    Raises `ParameterError` for anything else.
    """
    # Take occluders as they are, with their bounding spheres where they have one
    if isinstance(bodies, Bodies):
        return bodies
    occluders: list[Occluder] = []
    centres, radii = [np.zeros((0, 3))], []
    for body in bodies:
        triangles = body if isinstance(body, np.ndarray) else getattr(body, "triangles", None)
        if triangles is None:
            if not isinstance(body, Occluder):
                raise ParameterError(
                    f"bodies - not a body (got {type(body).__name__}) - give triangles (T, 3, 3), a mesh with "
                    "`triangles`, or an object with the methods of `Occluder`"
                )
            occluders.append(body)
            centre, radius = getattr(body, "bounding_sphere", (np.zeros(3), np.inf))
            centres.append(np.asarray(centre, np.float64)[None])
            radii.append(float(radius))
            continue
        # Make one of triangles, bounded by a sphere about the middle of their box
        corners = numbers("bodies", triangles).astype(np.float64, copy=False)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise ParameterError(
                f"bodies - triangles must be (T, 3, 3) (got {corners.shape}) - give three corners each"
            )
        if len(corners):
            points = corners.reshape(-1, 3)
            centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
            occluders.append(RayScene(corners))
            centres.append(centre[None])
            radii.append(float(np.linalg.norm(points - centre, axis=-1).max()))
    return Bodies(tuple(occluders), np.concatenate(centres), np.array(radii), np.zeros(len(radii)))


DISC_PIXELS, HALO_PIXELS = 256, 64
"""Pixels across a body: of the disc's maps, and of the halo's, whose shadows are blurred by degrees. Of more than
`_WHOLE` bodies, which are smaller in the frame or hide each other, all maps together have as many as of so many."""
_WHOLE = 8
_GROUP = 8
"""Segments of a ray for which bodies are sorted out together."""
DISC_TAPS, HALO_TAPS = 16, 32
"""Points of a segment at which disc and halo are tested, one direction each, in turn."""


class ShadowMaps(NamedTuple):
    """Maps of k bodies with bounding spheres in n directions of a disc about an axis.

    frame: (n, 3, 3) rows (u, v, direction). top: (k, n, size, size) [m]. spread: tangent of the widest angle between a
    direction and the axis.
    """

    frame: Array
    top: NDArray[np.float32]
    spread: float

    @classmethod
    def of(cls, bodies: Bodies, axis: Array, directions: Array, size: int, cache: Cache) -> ShadowMaps:
        """Return the maps in directions (n, 3). cache: keeps those of bodies that move without turning."""
        frame = np.array([basis(d) for d in directions])
        spheres = zip(bodies.occluders, bodies.centre, bodies.radius, strict=True)
        keep = 4 * len(bodies.radius)
        top = [_tops(body, centre, radius, frame, size, cache, keep) for body, centre, radius in spheres]
        cosine = min(float(np.min(directions @ axis)), 1.0)
        return cls(frame, np.array(top), math.sqrt(1.0 - cosine * cosine) / cosine)


class Outlines(NamedTuple):
    """Bodies as the sun sees them. centre, radius: (k, 3), (k,) [m] spheres around them. passed: (k,) of `Bodies`.

    axes: (3, 3) rows (u, v, towards the sun). apart: (k, size, size) distance [m] of a place across the sun's direction
    from the nearest that a body covers.
    """

    centre: Array
    radius: Array
    passed: Array
    axes: Array
    apart: NDArray[np.float32]


def shadows_in(
    bodies: Bodies, towards: Array, disc: Array | None, halo: Array, cache: Cache
) -> tuple[ShadowMaps, ShadowMaps, Outlines]:
    """Return maps of bodies for the sun's disc and for its halo, and their outlines. disc, halo: directions (n, 3) over
    those; without disc its middle (3,) alone.
    """
    fewer = min(math.sqrt(_WHOLE / len(bodies.occluders)), 1.0)
    of_disc, of_halo = round(DISC_PIXELS * fewer), round(HALO_PIXELS * fewer)
    middle = ShadowMaps.of(bodies, towards, towards[None], of_disc, cache)
    wide = middle if disc is None else ShadowMaps.of(bodies, towards, disc, of_disc, cache)
    covered = np.isfinite(middle.top[:, 0])
    pixel = 2.0 * bodies.radius / covered.shape[1]
    apart = [cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) for mask in covered]
    metres = (np.array(apart) * pixel[:, None, None]).astype(np.float32)
    outlines = Outlines(bodies.centre, bodies.radius, bodies.passed, middle.frame[0], metres)
    return wide, ShadowMaps.of(bodies, towards, halo, of_halo, cache), outlines


def _tops(
    body: Occluder, centre: Array, radius: float, frame: Array, size: int, cache: Cache, keep: int
) -> NDArray[np.float32]:
    """Return the maps (n, size, size) of a body in directions of `ShadowMaps.frame`."""
    if isinstance(body, PlacedScene):
        place = PartOf((body.scene, body.inside(centre)), Same(body.scene), body.linear)
        return cache.of(_drawn, place, body.linear, radius, frame, size, keep=keep)
    if isinstance(body, RayScene):
        return _drawn(PartOf((body, centre)), np.eye(3), radius, frame, size)
    top = np.full((len(frame), size, size), -np.inf, np.float32)
    at = radius * (2.0 * (np.arange(size) + 0.5) / size - 1.0)
    u, v = np.meshgrid(at, at)
    inside = u * u + v * v <= radius * radius
    for f, of_direction in zip(frame, top, strict=True):
        start = centre + u[inside, None] * f[0] + v[inside, None] * f[1] + radius * f[2]
        of_direction[inside] = radius - body.distance(start, np.broadcast_to(-f[2], start.shape))
    return top


def _drawn(
    place: PartOf[tuple[RayScene, Floats]], linear: Floats, radius: float, frame: Array, size: int
) -> NDArray[np.float32]:
    """Return `_tops` of triangles about a centre (3,) in their own axes, which `linear` (3, 3) turns to the world's."""
    scene, centre = place.whole
    top = np.full((len(frame), size, size), -np.inf)
    low, step = np.full(2, radius * (1.0 / size - 1.0)), np.full(2, 2.0 * radius / size)
    for f, of_direction in zip(frame, top, strict=True):
        raise_to_triangles(scene.triangles, centre, f[[1, 0, 2]] @ linear, low, step, of_direction)
    return top.astype(np.float32)


@exact_making
def visible_parts(rays: Any, start: Any, end: Any, outlines: Any, maps: Any, taps: Any, seen: Any) -> None:
    """Write the visible fraction of a disc of light, a mean over each segment of rays, to `seen` (n, count).

    rays: their origin (3,) and directions (n, 3). start, end: (n, count) [m] of their segments. outlines, maps:
    `Outlines`, `ShadowMaps`. taps: points of a segment that are tested, with the directions in turn.
    """
    # Take the inputs apart
    origin, directions = rays
    centre, radius, passed, axes, apart = outlines
    frame, top, spread = maps
    size, last, count = top.shape[2], apart.shape[1] - 1, seen.shape[1]
    every, few, near = np.arange(len(radius)), np.empty(len(radius), np.int64), np.empty(len(radius), np.int64)
    some, wide = np.empty(len(radius), np.int64), radius * (1.0 + spread + 4.0 / (last + 1))
    spheres = centre, wide, axes, spread
    # Leave out rays that pass by all shadows
    for n in range(len(directions)):
        d0, d1, d2 = directions[n, 0], directions[n, 1], directions[n, 2]
        met = _bodies_met(spheres, origin, directions[n], start[n, 0], end[n, count - 1], every, few)
        if met == 0:
            seen[n] = 1.0
            continue
        # Narrow the bodies down: of the ray, of a group of segments, of the segment
        listed = 0
        for k in range(count):
            if k % _GROUP == 0:
                until = end[n, min(k + _GROUP, count) - 1]
                listed = _bodies_met(spheres, origin, directions[n], start[n, k], until, few[:met], some)
            length = end[n, k] - start[n, k]
            middle = start[n, k] + 0.5 * length
            met_here = _bodies_met(spheres, origin, directions[n], start[n, k], end[n, k], some[:listed], near)
            # Keep bodies whose outline, widened by the light's disc, is near the segment's middle
            blocked, close = 0.0, 0
            for number in range(met_here):
                body = near[number]
                x = origin[0] + middle * d0 - centre[body, 0]
                y = origin[1] + middle * d1 - centre[body, 1]
                z = origin[2] + middle * d2 - centre[body, 2]
                below = radius[body] - x * axes[2, 0] - y * axes[2, 1] - z * axes[2, 2] + 0.5 * length
                if below <= 0.0:
                    continue
                u = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]
                v = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]
                scale, pixel = 0.5 * (last + 1) / radius[body], 2.0 * radius[body] / (last + 1)
                i = min(max(int(u * scale + 0.5 * (last + 1)), 0), last)
                j = min(max(int(v * scale + 0.5 * (last + 1)), 0), last)
                beside = max(apart[body, j, i], math.sqrt(u * u + v * v) - radius[body])
                if beside <= below * spread + 0.5 * length + 2.0 * pixel:
                    near[close] = body
                    close += 1
            # Look points of the segment up in their shadow maps, with the disc's directions in turn
            for tap in range(taps if close else 0):
                m = tap % len(frame)
                left = 1.0
                s = start[n, k] + (tap * GOLDEN + 0.5) % 1.0 * length
                for number in range(close):
                    body = near[number]
                    x = origin[0] + s * d0 - centre[body, 0]
                    y = origin[1] + s * d1 - centre[body, 1]
                    z = origin[2] + s * d2 - centre[body, 2]
                    f = frame[m]
                    scale = 0.5 * size / radius[body]
                    i = math.floor((x * f[0, 0] + y * f[0, 1] + z * f[0, 2]) * scale + 0.5 * size)
                    j = math.floor((x * f[1, 0] + y * f[1, 1] + z * f[1, 2]) * scale + 0.5 * size)
                    below = x * f[2, 0] + y * f[2, 1] + z * f[2, 2]
                    if 0 <= i < size and 0 <= j < size and below < top[body, m, j, i]:
                        left *= passed[body]
                        if left == 0.0:
                            break
                blocked += 1.0 - left
            seen[n, k] = 1.0 - blocked / taps


@exact
def _bodies_met(spheres: Any, origin: Any, direction: Any, first: Any, last: Any, asked: Any, met: Any) -> Any:
    """Write those of the bodies `asked` (m,) whose shadows a ray may meet between two distances to `met`; return how
    many there are.

    spheres: centres (k, 3), radii (k,) of their shadows [m] at the bodies, axes of `Outlines`, and by how much the
    radii grow a metre below.
    """
    # Turn the ray into the axes across the light and along it
    centre, wide, axes, spread = spheres
    along_u = direction[0] * axes[0, 0] + direction[1] * axes[0, 1] + direction[2] * axes[0, 2]
    along_v = direction[0] * axes[1, 0] + direction[1] * axes[1, 1] + direction[2] * axes[1, 2]
    rise = direction[0] * axes[2, 0] + direction[1] * axes[2, 1] + direction[2] * axes[2, 2]
    squared = max(along_u * along_u + along_v * along_v, 1e-300)
    # Keep bodies that it passes below, within the shadow's radius there
    found = 0
    for body in asked:
        x, y, z = origin[0] - centre[body, 0], origin[1] - centre[body, 1], origin[2] - centre[body, 2]
        height = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]
        below = wide[body] - height - min(first * rise, last * rise)
        if below <= 0.0:
            continue
        u = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]
        v = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]
        nearest = min(max(-(u * along_u + v * along_v) / squared, first), last)
        u, v = u + nearest * along_u, v + nearest * along_v
        reach = wide[body] + below * spread
        if u * u + v * v <= reach * reach:
            met[found] = body
            found += 1
    return found
