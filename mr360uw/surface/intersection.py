# SPDX-License-Identifier: Apache-2.0
"""First intersection of rays with a sampled sea, from above and from below: compiled, for one ray at a time.

Outside of the layer between trough and crest a ray is free. Inside it goes over the height maps in steps of its height
over the surface divided by the speed at which the steepest wave could meet it, at least half a step of the splines,
until it has changed sides. From there Newton's method in rest position and distance finds the point on the splines;
where that does not converge, bisection does. The level of the splines follows the ray's footprint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mr360uw.base.texels import Vector
from mr360uw.jit import exact
from mr360uw.surface.sampled_sea import Displacement, SampledSea, displacement, read_height, read_shift, rest_position
from mr360uw.types import Array


class Ray(NamedTuple):
    """A ray of light. origin: [m], y over the mean surface. side: 1 in the air, -1 in the water. width, spread: of its
    footprint at its origin, and its growth per metre.
    """

    origin: Vector
    direction: Vector
    side: float
    width: float
    spread: float


@exact
def reflectance(cosine: float, m: float) -> tuple[float, float]:
    """Return `optics.fresnel` of a cosine of incidence and the cosine of refraction."""
    before = max(cosine, 1e-300)
    behind = math.sqrt(max(1.0 - (1.0 - before * before) / (m * m), 0.0))
    across, along = (before - m * behind) / (before + m * behind), (m * before - behind) / (m * before + behind)
    return 0.5 * (across * across + along * along), behind


@exact
def bent(dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, eta: float) -> Vector:
    """Return the unit direction of `optics.refract_clamped`; a normal (nx, ny, nz) against the travel (dx, dy, dz)."""
    cosine = dx * nx + dy * ny + dz * nz
    k = eta * cosine + math.sqrt(max(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0))
    x, y, z = eta * dx - k * nx, eta * dy - k * ny, eta * dz - k * nz
    length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    return x / length, y / length, z / length


@exact
def mirrored(dx: float, dy: float, dz: float, nx: float, ny: float, nz: float) -> Vector:
    """Return the direction of `optics.reflect`."""
    twice = 2.0 * (dx * nx + dy * ny + dz * nz)
    return dx - twice * nx, dy - twice * ny, dz - twice * nz


_PIXEL_SIGMA = 1.0 / math.sqrt(12.0)
"""Standard deviation of a pixel of width 1."""
_LEAST_UP = 0.05
"""Least |y| of a direction that stretches a footprint on the surface, by the mean of its two axes, up to 4.5 times."""
_MOST_STEPS = 4000
"""Steps after which a ray in the layer of waves counts as free."""
_BESIDE = 0.1
"""Height below the map of the surface, over the distance of the splines' points, at which a ray may still start on it:
five times what the map is off."""
_NEAR = 1e-6
"""Distance [m] from the solution from where one more step of Newton's method is right to 1e-11 m: it squares it, times
curvatures of 10/m."""


class SeaWaves(NamedTuple):
    """Arrays of a `SampledSea` that rays read: numbers, coefficients and table of its splines, and its `HeightMaps`."""

    tile_m: float
    step_m: float
    lowest_m: float
    highest_m: float
    splines: Any
    table: Any
    height: Any
    shift: Any
    maps: Any
    steepest: Any


class Hit(NamedTuple):
    """Intersection of a ray with the surface. distance: [m], infinity for nowhere. normal: up. a, b: rest position over
    (x, z) of the particle. sigma_m: of the footprint that the surface was smoothed to. level: of the splines for it.
    """

    distance: float
    normal: Vector
    a: float
    b: float
    sigma_m: float
    level: float


NOWHERE = Hit(math.inf, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0)
"""Intersection of a ray that does not meet the surface."""


@exact
def sigma_at(width: float, spread: float, t: float, up: float) -> float:
    """Return the standard deviation [m] of a ray's footprint on the level surface after a distance t."""
    return _PIXEL_SIGMA * (width + spread * t) / math.sqrt(max(abs(up), _LEAST_UP))


@exact
def _level_at(sigma: float, step_m: float, last: int) -> float:
    """Return `SampledSea.level_of` of one number."""
    s = sigma / step_m
    return min(float(last), s if s < 1.0 else 1.0 + math.log2(s))


@exact
def first_hit(sea: SeaWaves, ray: Ray, reach: float) -> Hit:
    """Return where a ray first meets the surface. reach: [m] at most."""
    (ox, oy, oz), (dx, dy, dz), side, width, spread = ray
    last = len(sea.table) - 1
    # the part of the ray in the layer of waves
    t, end = 0.0, reach
    if dy > 0.0:
        t, end = max((sea.lowest_m - oy) / dy, 0.0), min(end, (sea.highest_m - oy) / dy)
    elif dy < 0.0:
        t, end = max((sea.highest_m - oy) / dy, 0.0), min(end, (sea.lowest_m - oy) / dy)
    elif oy < sea.lowest_m or oy > sea.highest_m:
        end = -1.0
    across = math.hypot(dx, dz)
    inside = sea.lowest_m <= oy <= sea.highest_m  # a ray from the surface may start a little on its wrong side
    before, was, right = t, 0.0, False
    for _ in range(_MOST_STEPS):
        if t > end:
            break
        sigma = sigma_at(width, spread, t, dy)
        level = _level_at(sigma, sea.step_m, last)
        over = side * (oy + t * dy - read_height(sea.height, sea.maps, sea.tile_m, level, ox + t * dx, oz + t * dz))
        steep = sea.steepest[min(int(level), last)] * across
        if side * dy > steep and over > -_BESIDE * sea.step_m:  # away from the surface, faster than it can follow
            break
        if over <= 0.0 and right:
            guess = before + (t - before) * (was / (was - over) if was > 0.0 else 0.5)
            sigma = sigma_at(width, spread, guess, dy)
            hit = _refined(sea, ray, sigma, before, t, guess)
            if (sigma_at(width, 0.0, 0.0, dy) if inside else 0.0) <= hit.distance < math.inf:
                return hit
            right = hit.distance == math.inf  # the maps are wrong: by the splines it is not there yet
        right = right or over > 0.0
        if t >= end:
            break
        before, was = t, over
        t = min(t + max(abs(over) / (abs(dy) + steep), 0.5 * sea.step_m, 0.5 * sigma), end)
    return NOWHERE


@exact
def _refined(sea: SeaWaves, ray: Ray, sigma: float, low: float, high: float, t: float) -> Hit:
    """Return the hit between two distances, from about a distance t, infinite if there is none after all."""
    (ox, oy, oz), (dx, dy, dz) = ray.origin, ray.direction
    tile = sea.tile_m
    level = _level_at(sigma, sea.step_m, len(sea.table) - 1)
    x, z = ox + t * dx, oz + t * dz
    shift_x, shift_z = read_shift(sea.shift, sea.maps, tile, level, x, z)
    a, b = x - shift_x, z - shift_z
    for _ in range(12):
        p = displacement(sea.splines, sea.table, tile, level, a, b)
        gx, gy, gz = a + p[1] - ox - t * dx, p[0] - oy - t * dy, b + p[2] - oz - t * dz
        near = abs(gx) + abs(gy) + abs(gz) < _NEAR
        # columns: the tangents by a and b, and minus the direction (Cramer's rule)
        ux, uy, uz, vx, vy, vz = 1.0 + p[4], p[3], p[5], p[7], p[6], 1.0 + p[8]
        cx, cy, cz = vy * dz - vz * dy, vz * dx - vx * dz, vx * dy - vy * dx
        volume = ux * cx + uy * cy + uz * cz
        if abs(volume) < 1e-14:
            break
        a -= (gx * cx + gy * cy + gz * cz) / volume
        b -= (gx * (uz * dy - uy * dz) + gy * (ux * dz - uz * dx) + gz * (uy * dx - ux * dy)) / volume
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        t += (gx * nx + gy * ny + gz * nz) / volume
        if near:
            if max(low - max(sea.step_m, sigma), 0.0) <= t <= high + max(sea.step_m, sigma):
                return Hit(t, _normal(p), a, b, sigma, level)
            break
    return _bisected(sea, ray, sigma, low, high)


@exact
def _bisected(sea: SeaWaves, ray: Ray, sigma: float, low: float, high: float) -> Hit:
    """Return the hit between two distances: the first if the ray is behind the splines there, none if before both."""
    # The ends decide: still before the surface, or behind it at once
    (ox, oy, oz), (dx, dy, dz), side = ray.origin, ray.direction, ray.side
    c, n, tile = sea.splines, sea.table, sea.tile_m
    level, slack = _level_at(sigma, sea.step_m, len(n) - 1), 1e-11 * tile
    x, z, t = ox + high * dx, oz + high * dz, low
    a, b, p = rest_position(c, n, tile, level, (x, z), (x, z), slack)
    if side * (oy + high * dy - p[0]) > 0.0:
        return NOWHERE
    x, z = ox + low * dx, oz + low * dz
    a, b, p = rest_position(c, n, tile, level, (x, z), (a, b), slack)
    if side * (oy + low * dy - p[0]) <= 0.0:
        return Hit(low, _normal(p), a, b, sigma, level)
    # Halve the interval to the last digits
    for _ in range(60):
        t = 0.5 * (low + high)
        x, z = ox + t * dx, oz + t * dz
        a, b, p = rest_position(c, n, tile, level, (x, z), (a, b), slack)
        if side * (oy + t * dy - p[0]) > 0.0:
            low = t
        else:
            high = t
        if high - low < 1e-12 * (1.0 + high):
            break
    return Hit(t, _normal(p), a, b, sigma, level)


@exact
def _normal(p: Displacement) -> Vector:
    """Return the unit normal across the tangents (1 + s_xx, h_x, s_zx) and (s_xz, h_z, 1 + s_zz)."""
    y = (1.0 + p[4]) * (1.0 + p[8]) - p[5] * p[7]
    x, z = p[6] * p[5] - (1.0 + p[8]) * p[3], p[3] * p[7] - (1.0 + p[4]) * p[6]
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceHits:
    """Intersections of rays with the surface.

    distance: (n,) [m], infinity for none. normal: (n, 3), up. rest: (n, 2) rest position over (x, z) of the particle.
    sigma_m: (n,) of the footprint that the surface was smoothed to. level: (n,) of the splines for it.
    """

    distance: Array
    normal: Array
    rest: Array
    sigma_m: Array
    level: Array


def first_hits(
    sea: SampledSea, origins: Array, directions: Array, from_below: bool, width_m: Array, spread: Array, reach_m: Array
) -> SurfaceHits:
    """Return where rays first meet the surface.

    origins: (n, 3) [m] with y over the mean surface. directions: (n, 3) unit. from_below: whether they run in water.
    width_m, spread: (n,) width of a ray's footprint at its origin and its growth per metre. reach_m: (n,) at most.
    """
    out, side = np.zeros((len(origins), 8)), -1.0 if from_below else 1.0
    _hit_all(waves_of(sea), side, origins, directions, width_m, spread, reach_m, out)
    return SurfaceHits(out[:, 0], out[:, 1:4], out[:, 4:6], out[:, 6], out[:, 7])


def waves_of(sea: SampledSea) -> SeaWaves:
    """Return what rays read of a sea."""
    maps, numbers = sea.maps, (sea.tile_m, sea.step_m, sea.lowest_m, sea.highest_m)
    return SeaWaves(*numbers, sea.coefficients, sea.table, maps.height, maps.shift, maps.table, maps.steepest)


@exact
def _hit_all(
    sea: SeaWaves, side: float, origins: Any, directions: Any, width: Any, spread: Any, reach: Any, out: Any
) -> None:
    for k in range(len(origins)):
        o = origins[k, 0], origins[k, 1], origins[k, 2]
        d = directions[k, 0], directions[k, 1], directions[k, 2]
        hit = first_hit(sea, Ray(o, d, side, width[k], spread[k]), reach[k])
        out[k, 0] = hit.distance
        out[k, 1], out[k, 2], out[k, 3] = hit.normal
        out[k, 4], out[k, 5], out[k, 6], out[k, 7] = hit.a, hit.b, hit.sigma_m, hit.level
