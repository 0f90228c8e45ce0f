# SPDX-License-Identifier: Apache-2.0
"""First intersection of rays with a sampled sea, from above and from below.

Outside of the layer between trough and crest a ray is free. Inside it goes in steps of its height over the surface
divided by the speed at which the steepest wave could meet it, at least half a step of the splines, until it has changed
sides. Newton's method in rest position and distance finds the point; where that does not converge, bisection does. The
level of the splines follows the ray's footprint.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.compiled import compiled
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.spline import displacement, rest_position

Array = NDArray[np.float64]

PIXEL_SIGMA = 1.0 / math.sqrt(12.0)
"""Standard deviation of a pixel of width 1."""
_LEAST_UP = 0.05
"""Least |y| of a direction that stretches a footprint on the surface, by the mean of its two axes, up to 4.5 times."""
_MOST_STEPS = 4000
_CHUNK = 4096
"""Steps after which a ray in the layer of waves counts as free; rays that are traced on one thread at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceHits:
    """Where rays meet the surface.

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
    count = len(origins)
    distance, normal, rest, sigma = np.full(count, np.inf), np.zeros((count, 3)), np.zeros((count, 2)), np.zeros(count)
    bounds = (sea.lowest_m, sea.highest_m, sea.steepest, sea.step_m)

    def trace(first: int) -> None:
        part = slice(first, first + _CHUNK)
        _trace(
            sea.coefficients, sea.start, sea.size, sea.tile_m, bounds, origins[part], directions[part],
            -1.0 if from_below else 1.0, width_m[part], spread[part], reach_m[part],
            distance[part], normal[part], rest[part], sigma[part],
        )  # fmt: skip

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(trace, range(0, count, _CHUNK)))  # to see their errors
    return SurfaceHits(distance, normal, rest, sigma, sea.level_of(sigma))


@compiled
def sigma_at(width: float, spread: float, t: float, up: float) -> float:
    """Return the standard deviation [m] of a ray's footprint on the level surface after a distance t."""
    return PIXEL_SIGMA * (width + spread * t) / math.sqrt(max(abs(up), _LEAST_UP))


@compiled
def level_at(sigma: float, step_m: float, last: int) -> float:
    """Return `SampledSea.level_of` of one number."""
    s = sigma / step_m
    return min(s if s < 1.0 else 1.0 + math.log2(s), float(last))


@compiled
def _trace(
    coefficients: Any, start: Any, size: Any, tile_m: float, bounds: Any, origins: Any, directions: Any, side: float,
    width: Any, spread: Any, reach: Any, distance: Any, normal: Any, rests: Any, sigma: Any,
) -> None:  # fmt: skip
    lowest, highest, steepest, step_m = bounds
    rest, out = np.zeros(2), np.zeros(9)
    last = len(size) - 1
    for n in range(len(origins)):
        dx, dy, dz = directions[n]
        oy = origins[n, 1]
        # the part of the ray in the layer of waves
        t, end = 0.0, reach[n]
        if dy > 0.0:
            t, end = max((lowest - oy) / dy, 0.0), min(end, (highest - oy) / dy)
        elif dy < 0.0:
            t, end = max((highest - oy) / dy, 0.0), min(end, (lowest - oy) / dy)
        elif oy < lowest or oy > highest:
            continue
        if t > end:
            continue
        speed = abs(dy) + steepest * math.hypot(dx, dz)
        rest[0], rest[1] = origins[n, 0] + t * dx, origins[n, 2] + t * dz
        before, was = t, 0.0
        shift_x, shift_z = 0.0, 0.0
        for _ in range(_MOST_STEPS):
            x, z = origins[n, 0] + t * dx, origins[n, 2] + t * dz
            s = sigma_at(width[n], spread[n], t, dy)
            level = level_at(s, step_m, last)
            rest[0], rest[1] = x - shift_x, z - shift_z
            rest_position(coefficients, start, size, tile_m, level, x, z, rest, out)
            shift_x, shift_z = x - rest[0], z - rest[1]
            over = side * (oy + t * dy - out[0])
            if over <= 0.0 and was > 0.0:
                found = _refined(
                    coefficients, start, size, tile_m, level, origins[n], directions[n], side, before, t, rest, out
                )
                distance[n], sigma[n] = found, s
                rests[n, 0] = origins[n, 0] + found * dx - out[1]
                rests[n, 1] = origins[n, 2] + found * dz - out[2]
                _write_normal(out, normal[n])
                break
            if t >= end:
                break
            before, was = t, max(over, was if over <= 0.0 else over)
            t = min(t + max(abs(over) / speed, 0.5 * step_m, 0.5 * s), end)


@compiled
def _write_normal(out: Any, normal: Any) -> None:
    """Write the unit normal (3,), across the tangents (1 + s_xx, h_x, s_zx) and (s_xz, h_z, 1 + s_zz)."""
    across = (1.0 + out[4]) * (1.0 + out[8]) - out[5] * out[7]
    nx, nz = out[6] * out[5] - (1.0 + out[8]) * out[3], out[3] * out[7] - (1.0 + out[4]) * out[6]
    length = math.sqrt(nx * nx + across * across + nz * nz)
    normal[0], normal[1], normal[2] = nx / length, across / length, nz / length


@compiled
def _refined(
    coefficients: Any, start: Any, size: Any, tile_m: float, level: float, origin: Any, direction: Any, side: float,
    low: float, high: float, rest: Any, out: Any,
) -> float:  # fmt: skip
    """Return the distance in [low, high] at which a ray crosses the surface; `out` (9,) is the displacement there."""
    dx, dy, dz = direction
    t, a, b = high, rest[0], rest[1]
    slack = 1e-9 * tile_m
    for _ in range(12):
        displacement(coefficients, start, size, tile_m, level, a, b, out)
        gx = a + out[1] - origin[0] - t * dx
        gy = out[0] - origin[1] - t * dy
        gz = b + out[2] - origin[2] - t * dz
        if abs(gx) + abs(gy) + abs(gz) < 1e-12 * (tile_m + t):
            if low - slack <= t <= high + slack:
                return t
            break
        # columns: the tangents by a and b, and minus the direction (Cramer's rule)
        ux, uy, uz, vx, vy, vz = 1.0 + out[4], out[3], out[5], out[7], out[6], 1.0 + out[8]
        cx, cy, cz = vy * dz - vz * dy, vz * dx - vx * dz, vx * dy - vy * dx
        volume = ux * cx + uy * cy + uz * cz
        if abs(volume) < 1e-14:
            break
        a -= (gx * cx + gy * cy + gz * cz) / volume
        b -= (gx * (uz * dy - uy * dz) + gy * (ux * dz - uz * dx) + gz * (uy * dx - ux * dy)) / volume
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        t += (gx * nx + gy * ny + gz * nz) / volume
    for _ in range(60):
        t = 0.5 * (low + high)
        x, z = origin[0] + t * dx, origin[2] + t * dz
        rest_position(coefficients, start, size, tile_m, level, x, z, rest, out)
        if side * (origin[1] + t * dy - out[0]) > 0.0:
            low = t
        else:
            high = t
        if high - low < 1e-12 * (1.0 + high):
            break
    return t
