# SPDX-License-Identifier: Apache-2.0
"""Radiance of the floor at one place, and heights of an uneven floor: where rays meet it, slopes and shadows. Compiled.

A level floor has one plane. Between the planes of an uneven one light is interpolated, and every pattern followed along
its beam. A facet of it gets the sun's light times the cosine that it is lit at, over that of a level plane, and the
share (1 + n_y)/2 of the even light, that of an even sky over a slope.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.jit import borrowing
from mr360uw.surface.tracing.table_reads import Vector, add, between, level_for, periodic, times

_LEAST_STEP = 0.05
"""Least step of a ray over the distance of pixels: it may pass through ridges that are thinner."""
_MOST_STEPS = 4000
"""Steps after which a ray counts as free."""
_ROOT_STEPS, _ROOT_M = 40, 1e-11
"""Most steps to the hit within the last step of the ray, and the height [m] over the floor at which it is found."""
_LIFT = 1e-6
"""Height over the floor, over the distance of pixels, that rays towards the sun and down to the floor start at."""


class Relief(NamedTuple):
    """An uneven floor. tile_m: after which it repeats. y: of the height 0 over the mean surface. low, high: least and
    greatest height; both 0 for a level floor. steepest: bound of its slope. heights: (size, size) [m] at the centres of
    pixels over a tile, read bilinearly; column = +x, row = +z. cells: (k, k, 2) greatest height and bound of the slope
    in squares of the tile.
    """

    tile_m: float
    y: float
    low: float
    high: float
    steepest: float
    heights: Any
    cells: Any


@borrowing
def relief_height(e: Any, tile_m: float, x: float, z: float) -> float:
    """Return the height [m] of a floor of `Relief.heights` e at (x, z)."""
    size = e.shape[0]
    u, v = x / tile_m * size - 0.5, z / tile_m * size - 0.5
    column, row = math.floor(u), math.floor(v)
    i, j, fx, fy = int(column), int(row), u - column, v - row
    i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
    above = (1.0 - fx) * e[j0, i0] + fx * e[j0, i1]
    return (1.0 - fy) * above + fy * ((1.0 - fx) * e[j1, i0] + fx * e[j1, i1])


@borrowing
def relief_distance(r: Relief, origin: Vector, direction: Vector, reach: float) -> float:
    """Return the distance at which a ray first goes through the floor from above, infinity for nowhere within reach."""
    (ox, oy, oz), (dx, dy, dz) = (origin[0], origin[1] - r.y, origin[2]), direction
    e, t, end = r.heights, 0.0, reach
    if dy < 0.0:
        lift = _LIFT * r.tile_m / e.shape[0]  # a ray that began on a level top would not go through it
        t, end = max((r.high + lift - oy) / dy, 0.0), min(end, (r.low - oy) / dy)
    elif oy > r.high:
        return math.inf
    elif dy > 0.0:
        end = min(end, (r.high - oy) / dy)
    across, side = math.hypot(dx, dz), r.tile_m / r.cells.shape[0]
    least = _LEAST_STEP * r.tile_m / e.shape[0]
    before, over_before = t, -1.0
    for _ in range(_MOST_STEPS):
        over = oy + t * dy - relief_height(e, r.tile_m, ox + t * dx, oz + t * dz)
        if over <= 0.0 and (over_before > 0.0 or t >= end):
            return _root(r, origin, direction, (before, over_before), (t, over))
        if t >= end:
            break
        before, over_before = t, over
        # Step to where the ray leaves the cell if it stays above its top, else no further than its slopes allow
        u, v = (ox + t * dx) / side, (oz + t * dz) / side
        out = min(_to_edge(u, dx), _to_edge(v, dz)) * side
        cell = r.cells[math.floor(v) % len(r.cells), math.floor(u) % len(r.cells)]
        y, step = oy + t * dy, out + least
        if min(y, y + out * dy) <= cell[0]:
            step = min(step, max(abs(over) / max(abs(dy) + cell[1] * across, 1e-12), least))
        t = min(t + step, end)
    return math.inf


@borrowing
def _root(
    r: Relief, origin: Vector, direction: Vector, above: tuple[float, float], below: tuple[float, float]
) -> float:
    """Return the distance at which a ray goes through the floor between two distances, each given with its height over
    the floor: the false position with halved ends (Illinois), or bisection where the ray began below the floor.
    """
    (low, f), (high, g), last = above, below, 0
    for _ in range(_ROOT_STEPS):
        t = low + (high - low) * (f / (f - g) if f > 0.0 > g else 0.5)
        y = origin[1] - r.y + t * direction[1]
        over = y - relief_height(r.heights, r.tile_m, origin[0] + t * direction[0], origin[2] + t * direction[2])
        if abs(over) <= _ROOT_M:
            return t
        if over > 0.0:
            low, f, g, last = t, over, 0.5 * g if last > 0 else g, 1
        else:
            high, g, f, last = t, over, 0.5 * f if last < 0 else f, -1
    return high


@borrowing
def _to_edge(u: float, speed: float) -> float:
    """Return the time after which a place u leaves the interval between whole numbers that it is in."""
    if speed == 0.0:
        return math.inf
    part = u - math.floor(u)
    return (1.0 - part) / speed if speed > 0.0 else part / -speed


@borrowing
def relief_slopes(r: Relief, x: float, z: float, footprint: float) -> tuple[float, float]:
    """Return the slopes of the floor over x and z, averaged over a footprint, at least a pixel."""
    e, tile_m = r.heights, r.tile_m
    half = 0.5 * max(tile_m / e.shape[0], footprint)
    by_x = relief_height(e, tile_m, x + half, z) - relief_height(e, tile_m, x - half, z)
    by_z = relief_height(e, tile_m, x, z + half) - relief_height(e, tile_m, x, z - half)
    return 0.5 * by_x / half, 0.5 * by_z / half


@borrowing
def in_shadow(r: Relief, x: float, z: float, to_sun: Vector) -> bool:
    """Return whether the floor hides a sun in a direction from its point at (x, z)."""
    e = r.heights
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


class LitFloor(NamedTuple):
    """The floor and its light. relief: its heights. albedo_m, light_m: after which albedo and patterns repeat. dry_sky,
    dry_sun: irradiance of a level plane above the water. sun_wet, sun_dry: directions to the sun in water and air.

    texels: (n, 3) of the albedo and of the light's patterns, each with its halves. levels: (k, 3) first texel, width
    and height of every level of each. pictures: (1 + p q, 2) first row of `levels` and number of levels of the albedo,
    then of the q patterns of each of p planes. planes: (p, 4 + 3 q) of each plane: its depth and its even light, then
    the origin over (x, z) of each pattern and whether the sun makes it.
    """

    relief: Relief
    albedo_m: float
    light_m: float
    dry_sky: Vector
    dry_sun: Vector
    sun_wet: Vector
    sun_dry: Vector
    texels: Any
    levels: Any
    pictures: Any
    planes: Any


@borrowing
def floor_radiance(g: LitFloor, x: float, z: float, footprint: float, dry: bool) -> Vector:
    """Return the radiance of the floor at (x, z), averaged over a footprint [m]; dry: above the water."""
    albedo = _picture(g, 0, g.albedo_m, x, z, footprint)
    r, fe, sky, sun, depth = g.relief, g.planes, 1.0, 1.0, -g.relief.y
    if r.low < r.high:
        to_sun = g.sun_dry if dry else g.sun_wet
        depth -= relief_height(r.heights, r.tile_m, x, z)
        by_x, by_z = relief_slopes(r, x, z, footprint)
        up = 1.0 / math.sqrt(1.0 + by_x * by_x + by_z * by_z)
        sky = 0.5 + 0.5 * up
        sun = max(up * (to_sun[1] - by_x * to_sun[0] - by_z * to_sun[2]) / to_sun[1], 0.0)
        if sun > 0.0 and in_shadow(r, x, z, to_sun):
            sun = 0.0
    if dry:
        light = add((0.0, 0.0, 0.0), g.dry_sky, sky)
        light = add(light, g.dry_sun, sun)
    else:
        lower, share = 0, 0.0
        while lower < len(fe) - 2 and fe[lower + 1, 0] < depth:
            lower += 1
        light = _plane_light(g, lower, x, z, depth, footprint, sky, sun)
        if len(fe) > 1:
            share = min(max((depth - fe[lower, 0]) / (fe[lower + 1, 0] - fe[lower, 0]), 0.0), 1.0)
            below = _plane_light(g, lower + 1, x, z, depth, footprint, sky, sun)
            light = between(light, below, share)
    value = times(albedo, light)
    return value[0] / math.pi, value[1] / math.pi, value[2] / math.pi


@borrowing
def _plane_light(
    g: LitFloor, plane: int, x: float, z: float, depth: float, footprint: float, sky: float, sun: float
) -> Vector:
    """Return the irradiance by one plane at (x, z) and a depth; sky, sun: factors on even light and on the sun's."""
    fe = g.planes
    count = (fe.shape[1] - 4) // 3
    light = sky * fe[plane, 1], sky * fe[plane, 2], sky * fe[plane, 3]
    along = depth / fe[plane, 0] if len(fe) > 1 else 1.0
    for k in range(count):
        at = 4 + 3 * k
        share = sun if fe[plane, at + 2] > 0.0 else sky
        if share > 0.0:
            at_x, at_z = x - along * fe[plane, at], z - along * fe[plane, at + 1]
            light = add(light, _picture(g, 1 + plane * count + k, g.light_m, at_x, at_z, footprint), share)
    return light


@borrowing
def _picture(g: LitFloor, number: int, tile_m: float, x: float, z: float, footprint: float) -> Vector:
    """Return a picture of the floor at (x, z), averaged over a footprint."""
    first, levels = g.pictures[number, 0], g.pictures[number, 1]
    level = level_for(footprint, tile_m / g.levels[first, 1], levels - 1)
    return periodic(g.texels, g.levels, first, levels, x / tile_m, z / tile_m, level)
