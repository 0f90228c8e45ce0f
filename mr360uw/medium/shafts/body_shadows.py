# SPDX-License-Identifier: Apache-2.0
"""Maps of bodies from every direction of the sun's disc and of its halo: visible fractions without a ray a point.

A map is a square across the bounding sphere of a body and holds, for parallel light of one direction, how far up along
that direction the body reaches, seen from the sphere's centre. A point is in shadow where it lies below that: exact but
for the width of a pixel, also between the parts of a body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, Same
from mr360uw.jit import exact
from mr360uw.medium.shafts.occluders import GOLDEN, Bodies, Occluder
from mr360uw.medium.shafts.shaft_scene import BeamPattern
from mr360uw.rays import PlacedScene, RayScene, raise_to_triangles
from mr360uw.sphere import basis, unit
from mr360uw.types import Floats

Array = NDArray[np.float64]

DISC_PIXELS, HALO_PIXELS = 256, 64
"""Pixels across a body: of the disc's maps, and of the halo's, whose shadows are blurred by degrees. Of more than
`_WHOLE` bodies, which are smaller in the frame or hide each other, all maps together have as many as of so many."""
_WHOLE = 8
_SMALL_RAD = 0.01
"""Radius of a disc up to which one direction stands for it: 10 m behind a body its shadow's edge is then 20 cm wide at
most, less than half a segment."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Shadows:
    """Maps of bodies for the sun's disc and for its halo, and their outlines."""

    disc: ShadowMaps
    halo: ShadowMaps
    outlines: Outlines


def shadows_of(pattern: BeamPattern, cache: Cache) -> Shadows | None:
    """Return the shadows of a beam's bodies, None without bodies or where one has no bounds. cache: holds them."""
    bodies, towards = pattern.bodies, unit(pattern.sun.direction)
    if not bodies.occluders or not np.all(np.isfinite(bodies.radius)):
        return None
    wide = pattern.sun.half_angle_rad > _SMALL_RAD
    return cache.of(_shadows, bodies, towards, pattern.disc if wide else None, pattern.halo, cache)


def _shadows(bodies: Bodies, towards: Array, disc: Array | None, halo: Array, cache: Cache) -> Shadows:
    """Return the shadows of bodies. disc, halo: directions (n, 3) over those; without disc its middle (3,) alone."""
    fewer = min(math.sqrt(_WHOLE / len(bodies.occluders)), 1.0)
    of_disc, of_halo = round(DISC_PIXELS * fewer), round(HALO_PIXELS * fewer)
    middle = ShadowMaps.of(bodies, towards, towards[None], of_disc, cache)
    wide = middle if disc is None else ShadowMaps.of(bodies, towards, disc, of_disc, cache)
    covered = np.isfinite(middle.top[:, 0])
    pixel = 2.0 * bodies.radius / covered.shape[1]
    apart = [cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) for mask in covered]
    metres = (np.array(apart) * pixel[:, None, None]).astype(np.float32)
    outlines = Outlines(bodies.centre, bodies.radius, bodies.passed, middle.frame[0], metres)
    return Shadows(wide, ShadowMaps.of(bodies, towards, halo, of_halo, cache), outlines)


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


@exact
def visible_parts(rays: Any, start: Any, end: Any, outlines: Any, maps: Any, taps: Any, seen: Any) -> None:
    """Write the visible fraction of a disc of light, a mean over each segment of rays, to `seen` (n, count).

    rays: their origin (3,) and directions (n, 3). start, end: (n, count) [m] of their segments. outlines, maps:
    `Outlines`, `ShadowMaps`. taps: points of a segment that are tested, with the directions in turn.
    """
    origin, directions = rays
    centre, radius, passed, axes, apart = outlines
    frame, top, spread = maps
    size, last, count = top.shape[2], apart.shape[1] - 1, seen.shape[1]
    every, few, near = np.arange(len(radius)), np.empty(len(radius), np.int64), np.empty(len(radius), np.int64)
    some, wide = np.empty(len(radius), np.int64), radius * (1.0 + spread + 4.0 / (last + 1))
    for n in range(len(directions)):
        d0, d1, d2 = directions[n, 0], directions[n, 1], directions[n, 2]
        met = _bodies_met(origin, directions[n], start[n, 0], end[n, count - 1], centre, wide, axes, spread, every, few)
        if met == 0:
            seen[n] = 1.0
            continue
        listed = 0
        for k in range(count):
            if k % _GROUP == 0:
                until = end[n, min(k + _GROUP, count) - 1]
                of_ray = few[:met]
                listed = _bodies_met(
                    origin, directions[n], start[n, k], until, centre, wide, axes, spread, of_ray, some
                )
            length = end[n, k] - start[n, k]
            middle = start[n, k] + 0.5 * length
            of_group = some[:listed]
            met_here = _bodies_met(
                origin, directions[n], start[n, k], end[n, k], centre, wide, axes, spread, of_group, near
            )
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
def _bodies_met(
    origin: Any, direction: Any, first: Any, last: Any, centre: Any, wide: Any, axes: Any, spread: Any, asked: Any,
    met: Any,
) -> Any:  # fmt: skip
    """Write those of the bodies `asked` (m,) whose shadows a ray may meet between two distances to `met`; return how
    many there are.

    wide: (k,) radius of their shadows [m] at the bodies, which grows by `spread` a metre below.
    """
    along_u = direction[0] * axes[0, 0] + direction[1] * axes[0, 1] + direction[2] * axes[0, 2]
    along_v = direction[0] * axes[1, 0] + direction[1] * axes[1, 1] + direction[2] * axes[1, 2]
    rise = direction[0] * axes[2, 0] + direction[1] * axes[2, 1] + direction[2] * axes[2, 2]
    squared = max(along_u * along_u + along_v * along_v, 1e-300)
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
