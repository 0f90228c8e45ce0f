# SPDX-License-Identifier: Apache-2.0
"""Heights of an uneven floor: where rays meet it, its slopes and its shadows, compiled, for one ray at a time.

e: (size, size) heights [m] at the centres of pixels over a tile, read bilinearly; column = +x, row = +z.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.jit import exact
from mr360uw.surface.tracing.ray_optics import Vector

_LEAST_STEP = 0.05
"""Least step of a ray over the distance of pixels: it may pass through ridges that are thinner."""
_MOST_STEPS = 4000
"""Steps after which a ray counts as free."""
_HALVINGS = 40
"""Bisections of a step: the hit is right to 1e-11 m."""
_LIFT = 1e-6
"""Height over the floor, over the distance of pixels, that rays towards the sun and down to the floor start at."""


class Relief(NamedTuple):
    """The numbers of an uneven floor. tile_m: after which it repeats. y: of the height 0 over the mean surface. low,
    high: least and greatest height; both 0 for a level floor. steepest: bound of its slope.
    """

    tile_m: float
    y: float
    low: float
    high: float
    steepest: float


@exact
def relief_height(e: Any, tile_m: float, x: float, z: float) -> float:
    """Return the height [m] of the floor at (x, z)."""
    size = e.shape[0]
    u, v = x / tile_m * size - 0.5, z / tile_m * size - 0.5
    column, row = math.floor(u), math.floor(v)
    i, j, fx, fy = int(column), int(row), u - column, v - row
    i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
    above = (1.0 - fx) * e[j0, i0] + fx * e[j0, i1]
    return (1.0 - fy) * above + fy * ((1.0 - fx) * e[j1, i0] + fx * e[j1, i1])


@exact
def relief_distance(e: Any, r: Relief, origin: Vector, direction: Vector, reach: float) -> float:
    """Return the distance at which a ray first goes through the floor from above, infinity for nowhere within reach."""
    (ox, oy, oz), (dx, dy, dz) = (origin[0], origin[1] - r.y, origin[2]), direction
    t, end = 0.0, reach
    if dy < 0.0:
        lift = _LIFT * r.tile_m / e.shape[0]  # a ray that began on a level top would not go through it
        t, end = max((r.high + lift - oy) / dy, 0.0), min(end, (r.low - oy) / dy)
    elif oy > r.high:
        return math.inf
    elif dy > 0.0:
        end = min(end, (r.high - oy) / dy)
    speed = max(abs(dy) + r.steepest * math.hypot(dx, dz), 1e-12)
    least = _LEAST_STEP * r.tile_m / e.shape[0]
    before, over_before = t, -1.0
    for _ in range(_MOST_STEPS):
        over = oy + t * dy - relief_height(e, r.tile_m, ox + t * dx, oz + t * dz)
        if over <= 0.0 and (over_before > 0.0 or t >= end):
            low, high = before, t
            for _ in range(_HALVINGS):
                t = 0.5 * (low + high)
                if oy + t * dy - relief_height(e, r.tile_m, ox + t * dx, oz + t * dz) > 0.0:
                    low = t
                else:
                    high = t
            return high
        if t >= end:
            break
        before, over_before = t, over
        t = min(t + max(abs(over) / speed, least), end)
    return math.inf


@exact
def relief_slopes(e: Any, tile_m: float, x: float, z: float, footprint: float) -> tuple[float, float]:
    """Return the slopes of the floor over x and z, averaged over a footprint, at least a pixel."""
    half = 0.5 * max(tile_m / e.shape[0], footprint)
    by_x = relief_height(e, tile_m, x + half, z) - relief_height(e, tile_m, x - half, z)
    by_z = relief_height(e, tile_m, x, z + half) - relief_height(e, tile_m, x, z - half)
    return 0.5 * by_x / half, 0.5 * by_z / half


@exact
def in_shadow(e: Any, r: Relief, x: float, z: float, to_sun: Vector) -> bool:
    """Return whether the floor hides a sun in a direction from its point at (x, z)."""
    pixel = r.tile_m / e.shape[0]
    y = relief_height(e, r.tile_m, x, z) + _LIFT * pixel
    closing = r.steepest * math.hypot(to_sun[0], to_sun[2]) - to_sun[1]
    if closing <= 0.0:
        return False
    t = _LEAST_STEP * pixel
    for _ in range(_MOST_STEPS):
        high = y + t * to_sun[1]
        if high > r.high:
            return False
        over = high - relief_height(e, r.tile_m, x + t * to_sun[0], z + t * to_sun[2])
        if over < 0.0:
            return True
        t += max(over / closing, _LEAST_STEP * pixel)
    return False
