# SPDX-License-Identifier: Apache-2.0
"""What compiled rays read of a sea: its splines, and maps of its height over places instead of particles.

Rays march in the maps, which are read bilinearly and cost a fiftieth of the splines, and then find the exact point on
the splines. Between nodes a map is off by 3 % of the height of the shortest wave.

Splines give the displacement and its derivatives at a rest position, one point at a time. A particle at rest at (a, b)
stands at (a + shift_x, height, b + shift_z). c: (n, 3) coefficients; n: (L, 2) of every level its first coefficient and
its points across the tile, powers of two: see `SampledSea`.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import borrowing, exact, inlined
from mr360uw.texels import between_four, periodic_four

Displacement = tuple[float, float, float, float, float, float, float, float, float]
"""Height, shift_x and shift_z, their derivatives by a and those by b."""


@borrowing
def displacement(c: Any, n: Any, tile_m: float, level: float, a: float, b: float) -> Displacement:
    """Return the displacement of a particle, between the splines of two levels."""
    lower = min(int(level), len(n) - 1)
    share = level - lower
    p = at_level(c, n[lower, 0], n[lower, 1], tile_m, a, b)
    if share <= 0.0 or lower + 1 >= len(n):
        return p
    q, rest = at_level(c, n[lower + 1, 0], n[lower + 1, 1], tile_m, a, b), 1.0 - share
    return (
        rest * p[0] + share * q[0], rest * p[1] + share * q[1], rest * p[2] + share * q[2],
        rest * p[3] + share * q[3], rest * p[4] + share * q[4], rest * p[5] + share * q[5],
        rest * p[6] + share * q[6], rest * p[7] + share * q[7], rest * p[8] + share * q[8],
    )  # fmt: skip


@borrowing
def at_level(c: Any, first: int, size: int, tile_m: float, a: float, b: float) -> Displacement:
    """Return the displacement of a particle by the splines of one level."""
    per_m, last = size / tile_m, size - 1
    u, v = a * per_m, b * per_m
    column, row = math.floor(u), math.floor(v)
    i, j = int(column), int(row)
    x0, x1, x2, x3 = _basis(u - column)
    y0, y1, y2, y3 = _slopes(u - column)
    i0, i1, i2, i3 = (i - 1) & last, i & last, (i + 1) & last, (i + 2) & last
    weights, slopes = _basis(v - row), _slopes(v - row)
    h, sx, sz, h_a, sx_a, sz_a, h_b, sx_b, sz_b = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        line = first + ((j + k - 1) & last) * size
        p, q, r, t = line + i0, line + i1, line + i2, line + i3
        w, g = weights[k], slopes[k] * per_m
        e = w * per_m
        f = x0 * c[p, 0] + x1 * c[q, 0] + x2 * c[r, 0] + x3 * c[t, 0]
        h, h_b = h + w * f, h_b + g * f
        h_a += e * (y0 * c[p, 0] + y1 * c[q, 0] + y2 * c[r, 0] + y3 * c[t, 0])
        f = x0 * c[p, 1] + x1 * c[q, 1] + x2 * c[r, 1] + x3 * c[t, 1]
        sx, sx_b = sx + w * f, sx_b + g * f
        sx_a += e * (y0 * c[p, 1] + y1 * c[q, 1] + y2 * c[r, 1] + y3 * c[t, 1])
        f = x0 * c[p, 2] + x1 * c[q, 2] + x2 * c[r, 2] + x3 * c[t, 2]
        sz, sz_b = sz + w * f, sz_b + g * f
        sz_a += e * (y0 * c[p, 2] + y1 * c[q, 2] + y2 * c[r, 2] + y3 * c[t, 2])
    return h, sx, sz, h_a, sx_a, sz_a, h_b, sx_b, sz_b


@exact
def _basis(t: float) -> tuple[float, float, float, float]:
    """Return the four cubic B-splines about a place t in [0, 1) between points."""
    r = 1.0 - t
    return (
        r * r * r / 6.0, (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * r * r + 3.0 * r * r * r) / 6.0, t * t * t / 6.0,
    )  # fmt: skip


@exact
def _slopes(t: float) -> tuple[float, float, float, float]:
    """Return the derivatives of the four cubic B-splines."""
    r = 1.0 - t
    return -0.5 * r * r, 0.5 * t * (3.0 * t - 4.0), -0.5 * r * (3.0 * r - 4.0), 0.5 * t * t


@borrowing
def rest_position(
    c: Any, n: Any, tile_m: float, level: float, x: float, z: float, a: float, b: float, slack: float
) -> tuple[float, float, Displacement]:
    """Return the rest position of the particle above (x, z) and its displacement, by Newton's method from (a, b).

    slack: [m] that it may be beside (x, z). Where the surface folds over, one of several is found.
    """
    p = displacement(c, n, tile_m, level, a, b)
    for _ in range(8):
        off_x, off_z = a + p[1] - x, b + p[2] - z
        if abs(off_x) + abs(off_z) < slack:
            break
        xx, xz, zx, zz = 1.0 + p[4], p[7], p[5], 1.0 + p[8]
        across = xx * zz - xz * zx
        if across < 0.1:  # near a cusp: the slower iteration, which does not divide by the derivative
            a, b = a - 0.5 * off_x, b - 0.5 * off_z
        else:
            a, b = a - (zz * off_x - xz * off_z) / across, b - (xx * off_z - zx * off_x) / across
        p = displacement(c, n, tile_m, level, a, b)
    return a, b, p


@borrowing
def heights_at(c: Any, n: Any, tile_m: float, x: Any, z: Any, result: Any) -> None:
    """Write the height of the surface over the mean at places (n,) into `result` (n,)."""
    for k in range(len(x)):
        result[k] = rest_position(c, n, tile_m, 0.0, x[k], z[k], x[k], z[k], 1e-11 * tile_m)[2][0]


_between_four = inlined(between_four)
_periodic_four = inlined(periodic_four)

Array = NDArray[np.float64]

_FINEST = 512
"""Most nodes across the tile of the map of the sea itself. Maps of smoothed seas have one for every two points of the
splines: their rays are as wide as two."""
_SLACK = 1e-3
"""How far beside its node a particle of the maps may stand, over the distance of the nodes."""
_MARGIN = 1.1
"""Factor on the greatest slope between nodes."""
_ROWS = 32
"""Rows that are made on one thread at a time."""


class HeightMaps(NamedTuple):
    """height: (n,) and shift: (n, 2) over (x, z) [m] of the particles above the nodes x = column tile/size, z = row
    tile/size, level after level. table: (L, 2) first node and nodes across the tile of each. steepest: (L,) greatest
    slope of each.
    """

    height: NDArray[np.float32]
    shift: NDArray[np.float32]
    table: NDArray[np.int64]
    steepest: Array


def height_maps(
    coefficients: NDArray[np.float32], table: NDArray[np.int64], tile_m: float, steepest: float
) -> HeightMaps:
    """Return the maps of all levels. coefficients, table: of the splines. steepest: bound of the greatest slope."""
    sizes = [min(int(table[0, 1]), _FINEST)] + [max(int(n) // 2, 4) for n in table[1:, 1]]
    start = np.cumsum([0, *(n * n for n in sizes)])
    height, shift = np.zeros(start[-1], np.float32), np.zeros((start[-1], 2), np.float32)
    bands = [(level, row, min(row + _ROWS, n)) for level, n in enumerate(sizes) for row in range(0, n, _ROWS)]

    def make(band: tuple[int, int, int]) -> None:
        level, first, last = band
        part = slice(start[level] + first * sizes[level], start[level] + last * sizes[level])
        _fill(coefficients, table, tile_m, level, sizes[level], first, last, height[part], shift[part])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(make, bands))  # to see their errors
    slopes = [
        _steepest(height[a:b].reshape(n, n), tile_m / n) for a, b, n in zip(start, start[1:], sizes, strict=False)
    ]
    bound = np.minimum(_MARGIN * np.array(slopes) + 1e-6, steepest)
    bound[0] = steepest
    return HeightMaps(height, shift, np.stack([start[:-1], sizes], axis=-1), bound)


def _steepest(height: NDArray[np.float32], step_m: float) -> float:
    return max(float(np.abs(height - np.roll(height, 1, axis)).max()) for axis in (0, 1)) * math.sqrt(2.0) / step_m


@borrowing
def _fill(c: Any, n: Any, tile_m: float, level: int, size: int, first: int, last: int, height: Any, shift: Any) -> None:
    step = tile_m / size
    slack = _SLACK * step
    for row in range(first, last):
        z = row * step
        a, b = 0.0, z
        for column in range(size):
            x = column * step
            a, b, p = rest_position(c, n, tile_m, float(level), x, z, a + step, b, slack)
            at = (row - first) * size + column
            height[at], shift[at, 0], shift[at, 1] = p[0], x - a, z - b


@borrowing
def read_height(h: Any, n: Any, tile_m: float, level: float, x: float, z: float) -> float:
    """Return the height [m] above (x, z) at a fractional level. h, n: `height` and `table` of the maps."""
    lower = min(int(level), len(n) - 1)
    share = level - lower
    value = _height(h, n[lower, 0], n[lower, 1], tile_m, x, z)
    if share > 0.0 and lower + 1 < len(n):
        value += share * (_height(h, n[lower + 1, 0], n[lower + 1, 1], tile_m, x, z) - value)
    return value


@borrowing
def _height(h: Any, first: int, size: int, tile_m: float, x: float, z: float) -> float:
    per_m = size / tile_m
    a, b, c, d, fx, fy = _periodic_four(first, size, x * per_m, z * per_m)
    value: float = _between_four(h[a], h[b], h[c], h[d], fx, fy)
    return value


@borrowing
def read_shift(s: Any, n: Any, tile_m: float, level: float, x: float, z: float) -> tuple[float, float]:
    """Return the shift over (x, z) [m] of the particle above (x, z) at the next lower level. s: `shift` of the maps."""
    lower = min(int(level), len(n) - 1)
    per_m = n[lower, 1] / tile_m
    a, b, c, d, fx, fy = _periodic_four(n[lower, 0], n[lower, 1], x * per_m, z * per_m)
    return (
        _between_four(s[a, 0], s[b, 0], s[c, 0], s[d, 0], fx, fy),
        _between_four(s[a, 1], s[b, 1], s[c, 1], s[d, 1], fx, fy),
    )
