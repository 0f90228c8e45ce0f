# SPDX-License-Identifier: Apache-2.0
"""What compiled rays read of a sea: its splines, and maps of its height over places instead of particles.

Rays march in the maps, which are read bilinearly and cost a fiftieth of the splines, and then find the exact point on
the splines. Between nodes a map is off by 3 % of the height of the shortest wave.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact, inlined
from mr360uw.surface.spline import rest_position
from mr360uw.texels import between_four, periodic_four

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
    """Return the maps of all levels. coefficients, table: of `spline`. steepest: bound of the greatest slope."""
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


@exact
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


@exact
def read_height(h: Any, n: Any, tile_m: float, level: float, x: float, z: float) -> float:
    """Return the height [m] above (x, z) at a fractional level. h, n: `height` and `table` of the maps."""
    lower = min(int(level), len(n) - 1)
    share = level - lower
    value = _height(h, n[lower, 0], n[lower, 1], tile_m, x, z)
    if share > 0.0 and lower + 1 < len(n):
        value += share * (_height(h, n[lower + 1, 0], n[lower + 1, 1], tile_m, x, z) - value)
    return value


@exact
def _height(h: Any, first: int, size: int, tile_m: float, x: float, z: float) -> float:
    per_m = size / tile_m
    a, b, c, d, fx, fy = _periodic_four(first, size, x * per_m, z * per_m)
    value: float = _between_four(h[a], h[b], h[c], h[d], fx, fy)
    return value


@exact
def read_shift(s: Any, n: Any, tile_m: float, level: float, x: float, z: float) -> tuple[float, float]:
    """Return the shift over (x, z) [m] of the particle above (x, z) at the next lower level. s: `shift` of the maps."""
    lower = min(int(level), len(n) - 1)
    per_m = n[lower, 1] / tile_m
    a, b, c, d, fx, fy = _periodic_four(n[lower, 0], n[lower, 1], x * per_m, z * per_m)
    return (
        _between_four(s[a, 0], s[b, 0], s[c, 0], s[d, 0], fx, fy),
        _between_four(s[a, 1], s[b, 1], s[c, 1], s[d, 1], fx, fy),
    )
