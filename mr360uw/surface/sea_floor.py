# SPDX-License-Identifier: Apache-2.0
"""The sea floor: its heights, its albedo and the light on it; and of one ray, compiled, where it meets the floor.

A ray steps over an uneven floor to the edges of cells whose greatest height it clears, else no further than the slopes
allow; the false position finds the root within the last step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.caustic_lookup import mip_level, mip_levels, periodic_trilinear
from mr360uw.base.constants import PI
from mr360uw.base.parameters import number, numbers
from mr360uw.base.texels import Vector, add, between, level_for, periodic, times
from mr360uw.errors import ParameterError
from mr360uw.jit import exact
from mr360uw.types import Array, Floats

_CELL = 16
"""Pixels along each side of the squares of a relief whose height is bounded. With 8 and 32 rays take as long."""


class Tiled:
    """A picture (size, size, C) that repeats every tile_m [m], column = +x, row = +z; pixel (0, 0) spans [0,
    tile_m/size) from `origin` (2,) over (x, z) [m]; with its halves for footprints."""

    def __init__(self, picture: Floats, tile_m: float, origin: tuple[float, float] = (0.0, 0.0)) -> None:
        self.levels, self.tile_m, self.origin = mip_levels(np.asarray(picture, np.float64)[None]), tile_m, origin

    def at(self, x_m: Array, z_m: Array, footprint_m: Array) -> Array:
        """Return values (n, 3) at places (n,), averaged over footprints (n,) [m]."""
        level = mip_level(footprint_m, self.tile_m / self.levels[0].shape[1], len(self.levels) - 1.0)
        u, v = (x_m - self.origin[0]) / self.tile_m, (z_m - self.origin[1]) / self.tile_m
        return np.asarray(periodic_trilinear(self.levels, np.zeros(len(x_m), np.int64), u, v, level))


class Floor:
    """A diffuse floor, level or uneven.

    It sends light up equally in all directions. A relief shades itself from the sun, with a hard edge, but not from the
    sky.

    Parameters
    ----------
    height_m : float
        Its y [m] in the world.
    albedo : array_like
        In [0, 1]: a number, (3,), or an image (size, size, 3) or (size, size), `size` a power of two, that repeats
        every albedo_tile_m from the world's origin, column = +x, row = +z.
    tile_m : float, optional
        Length [m] after which the relief repeats.
    relief : array_like
        Heights (size, size) [m] over height_m at the centres of pixels, read bilinearly.
    albedo_tile_m : float, optional
        Length [m] after which the albedo repeats; `tile_m` unless given.

    Raises
    ------
    ParameterError
        If a shape or a value is out of its domain.

    See Also
    --------
    uw.surface.SeaScene : Takes a floor.
    uw.floor_from_track : A mesh of a real floor.

    Examples
    --------
    >>> uw.surface.Floor(-4.0, albedo=[0.4, 0.35, 0.3]).mean_albedo
    array([0.4 , 0.35, 0.3 ])
    """

    def __init__(
        self,
        height_m: float,
        albedo: ArrayLike = 0.3,
        tile_m: float | None = None,
        *,
        relief: ArrayLike = 0.0,
        albedo_tile_m: float | None = None,
    ) -> None:
        # Check the albedo, and repeat it over its tile
        self.height_m = number("floor.height_m", height_m)
        for name, length in (("tile_m", tile_m), ("albedo_tile_m", albedo_tile_m)):
            if length is not None:
                number(f"floor.{name}", length)
        image = numbers("floor.albedo", albedo).astype(np.float64)
        if image.size == 0 or image.min() < 0.0 or image.max() > 1.0:
            raise ParameterError(f"floor.albedo - must lie in [0, 1] (got {image.ravel()[:3]}) - give fractions")
        given = tile_m if albedo_tile_m is None else albedo_tile_m
        if image.shape in ((), (3,)):
            image, given = np.broadcast_to(image, (1, 1, 3)), 1.0
        elif image.ndim == 2:
            image = image[..., None]
        size = image.shape[0]
        if image.ndim != 3 or image.shape[1] != size or image.shape[2] not in (1, 3) or size & (size - 1):
            raise ParameterError(
                f"floor.albedo - must be a number, (3,) or a square image (got shape {image.shape}) - "
                "sides of a power of two tile"
            )
        self.mean_albedo: Array = np.broadcast_to(image.mean(axis=(0, 1)), (3,)).copy()
        self.image = Tiled(image, _metres("tile_m" if albedo_tile_m is None else "albedo_tile_m", given))
        # Check the relief; a single number is a level floor at another height
        heights = numbers("floor.relief", relief).astype(np.float64)
        level = heights.ndim == 0
        if not level and (heights.ndim != 2 or heights.shape[0] != heights.shape[1] or len(heights) < 2):
            raise ParameterError(f"floor.relief - must be (size, size) (got shape {heights.shape}) - give heights")
        self.height_m += float(heights) if level else 0.0
        self.relief: Array = np.zeros((1, 1)) if level else np.ascontiguousarray(heights)
        self.tile_m = 1.0 if level else _metres("tile_m", tile_m)
        self.lowest_m, self.highest_m = float(self.relief.min()), float(self.relief.max())
        self.cells = _cells(self.relief, self.tile_m)
        """(k, k, 2) greatest height and bound of the slope in squares of the tile."""
        self.steepest = float(self.cells[..., 1].max())

    def height_at(self, x_m: float, z_m: float) -> float:
        """Return the y [m] in the world of the floor at a place in the world."""
        return self.height_m + _relief_height(self.relief, self.tile_m, x_m, z_m)

    def albedo(self, x_m: Array, z_m: Array, footprint_m: Array) -> Array:
        """Return the albedo (n, 3) at places (n,) in the world, averaged over footprints (n,) [m]."""
        return self.image.at(x_m, z_m, footprint_m)


def _cells(relief: Array, tile_m: float) -> Array:
    """Return `Floor.cells`. A bilinear surface is highest in its nodes, and steepest along the edges between them."""
    size = len(relief)
    edges = np.linspace(0.0, size, max(size // _CELL, 1) + 1)
    # The nodes about each interval of pixels, whose centres are at i + .5
    spans = [np.arange(int(a - 0.5) - 1, int(b + 0.5) + 1) % size for a, b in pairwise(edges)]

    def most(values: Array) -> Array:
        rows = np.stack([values[span].max(axis=0) for span in spans])
        return np.stack([rows[:, span].max(axis=1) for span in spans], axis=1)

    by_z, by_x = (most(np.abs(np.roll(relief, -1, axis) - relief)) for axis in (0, 1))
    return np.stack([most(relief), np.hypot(by_x, by_z) * size / tile_m], axis=-1)


def _metres(name: str, length: float | None) -> float:
    if length is None or not number(f"floor.{name}", length) > 0.0:
        raise ParameterError(f"floor.{name} - an image needs its size (got {length}) - give metres above 0")
    return float(length)


@dataclass(frozen=True, slots=True, eq=False)
class FloorIrradiance:
    """Irradiance of the floor: an even part (3,) and patterns that repeat with the sea, each times a factor (3,).

    dry: (3,) irradiance of what stands out of the water; dry_sun: the sun's part of it. skies: how many of the
    patterns, the first, are of the sky; the others are of the sun.
    """

    even: Array
    patterns: tuple[tuple[Tiled, Array], ...]
    dry: Array
    dry_sun: Array
    skies: int = 0

    def irradiance(self, x_m: Array, z_m: Array, footprint_m: Array) -> Array:
        """Return the irradiance (n, 3) at places (n,) in the world, averaged over footprints (n,) [m]."""
        light = np.broadcast_to(self.even, (len(x_m), 3)).copy()
        for pattern, factor in self.patterns:
            light += factor * pattern.at(x_m, z_m, footprint_m)
        return light

    def radiance(self, floor: Floor, x_m: Array, z_m: Array, footprint_m: Array, dry: bool) -> Array:
        """Return the radiance (n, 3) of the floor there; dry: above the water."""
        light = self.dry if dry else self.irradiance(x_m, z_m, footprint_m)
        return floor.albedo(x_m, z_m, footprint_m) * light / PI


# What a ray reads of the floor

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


@exact
def _relief_height(e: Any, tile_m: float, x: float, z: float) -> float:
    """Return the height [m] of a floor of `Relief.heights` e at (x, z)."""
    size = e.shape[0]
    u, v = x / tile_m * size - 0.5, z / tile_m * size - 0.5
    column, row = math.floor(u), math.floor(v)
    i, j, fx, fy = int(column), int(row), u - column, v - row
    i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
    above = (1.0 - fx) * e[j0, i0] + fx * e[j0, i1]
    return (1.0 - fy) * above + fy * ((1.0 - fx) * e[j1, i0] + fx * e[j1, i1])


@exact
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
        over = oy + t * dy - _relief_height(e, r.tile_m, ox + t * dx, oz + t * dz)
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


@exact
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
        over = y - _relief_height(r.heights, r.tile_m, origin[0] + t * direction[0], origin[2] + t * direction[2])
        if abs(over) <= _ROOT_M:
            return t
        if over > 0.0:
            low, f, g, last = t, over, 0.5 * g if last > 0 else g, 1
        else:
            high, g, f, last = t, over, 0.5 * f if last < 0 else f, -1
    return high


@exact
def _to_edge(u: float, speed: float) -> float:
    """Return the time after which a place u leaves the interval between whole numbers that it is in."""
    if speed == 0.0:
        return math.inf
    part = u - math.floor(u)
    return (1.0 - part) / speed if speed > 0.0 else part / -speed


@exact
def _relief_slopes(r: Relief, x: float, z: float, footprint: float) -> tuple[float, float]:
    """Return the slopes of the floor over x and z, averaged over a footprint, at least a pixel."""
    e, tile_m = r.heights, r.tile_m
    half = 0.5 * max(tile_m / e.shape[0], footprint)
    by_x = _relief_height(e, tile_m, x + half, z) - _relief_height(e, tile_m, x - half, z)
    by_z = _relief_height(e, tile_m, x, z + half) - _relief_height(e, tile_m, x, z - half)
    return 0.5 * by_x / half, 0.5 * by_z / half


@exact
def in_shadow(r: Relief, x: float, z: float, to_sun: Vector) -> bool:
    """Return whether the floor hides a sun in a direction from its point at (x, z)."""
    e = r.heights
    pixel = r.tile_m / e.shape[0]
    y = _relief_height(e, r.tile_m, x, z) + _LIFT * pixel
    closing = r.steepest * math.hypot(to_sun[0], to_sun[2]) - to_sun[1]
    if closing <= 0.0:
        return False
    t = _LEAST_STEP * pixel
    for _ in range(_MOST_STEPS):
        high = y + t * to_sun[1]
        if high > r.high:
            return False
        over = high - _relief_height(e, r.tile_m, x + t * to_sun[0], z + t * to_sun[2])
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


@exact
def floor_radiance(g: LitFloor, x: float, z: float, footprint: float, dry: bool) -> Vector:
    """Return the radiance of the floor at (x, z), averaged over a footprint [m]; dry: above the water."""
    # Tilt the floor and shade it where it is uneven
    albedo = _picture(g, 0, g.albedo_m, x, z, footprint)
    r, fe, sky, sun, depth = g.relief, g.planes, 1.0, 1.0, -g.relief.y
    if r.low < r.high:
        to_sun = g.sun_dry if dry else g.sun_wet
        depth -= _relief_height(r.heights, r.tile_m, x, z)
        by_x, by_z = _relief_slopes(r, x, z, footprint)
        up = 1.0 / math.sqrt(1.0 + by_x * by_x + by_z * by_z)
        sky = 0.5 + 0.5 * up
        sun = max(up * (to_sun[1] - by_x * to_sun[0] - by_z * to_sun[2]) / to_sun[1], 0.0)
        if sun > 0.0 and in_shadow(r, x, z, to_sun):
            sun = 0.0
    # Light it above the water, or between the planes of light around its depth
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


@exact
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


@exact
def _picture(g: LitFloor, number: int, tile_m: float, x: float, z: float, footprint: float) -> Vector:
    """Return a picture of the floor at (x, z), averaged over a footprint."""
    first, levels = g.pictures[number, 0], g.pictures[number, 1]
    level = level_for(footprint, tile_m / g.levels[first, 1], levels - 1)
    return periodic(g.texels, g.levels, first, levels, x / tile_m, z / tile_m, level)
