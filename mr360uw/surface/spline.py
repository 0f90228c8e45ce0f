# SPDX-License-Identifier: Apache-2.0
"""Displacement of a sampled sea and its derivatives at a rest position: compiled, for one point at a time.

A particle at rest at (a, b) stands at (a + shift_x, height, b + shift_z). Arrays are those of `SampledSea`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mr360uw.caustics.flux.compiled import compiled


@compiled
def displacement(
    coefficients: Any, start: Any, size: Any, tile_m: float, level: float, a: float, b: float, out: Any
) -> None:
    """Write height, shift_x and shift_z, their derivatives by a and those by b into `out` (9,)."""
    lower = min(int(level), len(size) - 1)
    share = level - lower
    for i in range(9):
        out[i] = 0.0
    add_level(coefficients, start[lower], size[lower], tile_m, a, b, 1.0 - share, out)
    if share > 0.0 and lower + 1 < len(size):
        add_level(coefficients, start[lower + 1], size[lower + 1], tile_m, a, b, share, out)


@compiled
def add_level(coefficients: Any, first: int, n: int, tile_m: float, a: float, b: float, share: float, out: Any) -> None:
    """Add `share` times the splines of one level to `out` (9,)."""
    u, v = a / tile_m * n, b / tile_m * n
    i, j = math.floor(u), math.floor(v)
    p, q = u - i, v - j
    per_m = n / tile_m
    for row in range(4):
        value_z, slope_z = basis(q, row)
        line = first + (int(j) + row - 1) % n * n
        for column in range(4):
            value_x, slope_x = basis(p, column)
            at = line + (int(i) + column - 1) % n
            weight, by_a, by_b = value_x * value_z, slope_x * value_z * per_m, value_x * slope_z * per_m
            for field in range(3):
                c = share * coefficients[at, field]
                out[field] += weight * c
                out[3 + field] += by_a * c
                out[6 + field] += by_b * c


@compiled
def basis(t: float, k: int) -> tuple[float, float]:
    """Return the k-th of the four cubic B-splines about a place t in [0, 1) between points, and its derivative."""
    if k == 0:
        r = 1.0 - t
        return r * r * r / 6.0, -0.5 * r * r
    if k == 1:
        return (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0, 0.5 * t * (3.0 * t - 4.0)
    if k == 2:
        r = 1.0 - t
        return (4.0 - 6.0 * r * r + 3.0 * r * r * r) / 6.0, -0.5 * r * (3.0 * r - 4.0)
    return t * t * t / 6.0, 0.5 * t * t


@compiled
def rest_position(
    coefficients: Any, start: Any, size: Any, tile_m: float, level: float, x: float, z: float, rest: Any, out: Any
) -> None:
    """Find the rest position of the particle above (x, z) by Newton's method from `rest` (2,), which it overwrites.

    `out` (9,) is the displacement there. Where the surface folds over, one of several is found.
    """
    for _ in range(8):
        displacement(coefficients, start, size, tile_m, level, rest[0], rest[1], out)
        off_x, off_z = rest[0] + out[1] - x, rest[1] + out[2] - z
        if abs(off_x) + abs(off_z) < 1e-11 * tile_m:
            return
        xx, xz, zx, zz = 1.0 + out[4], out[7], out[5], 1.0 + out[8]
        across = xx * zz - xz * zx
        if across < 0.1:  # near a cusp: the slower iteration, which does not divide by the derivative
            rest[0] -= 0.5 * off_x
            rest[1] -= 0.5 * off_z
        else:
            rest[0] -= (zz * off_x - xz * off_z) / across
            rest[1] -= (xx * off_z - zx * off_x) / across


@compiled
def heights_at(coefficients: Any, start: Any, size: Any, tile_m: float, x: Any, z: Any, result: Any) -> None:
    """Write the height of the surface over the mean at places (n,) into `result` (n,)."""
    rest, out = np.zeros(2), np.zeros(9)
    for n in range(len(x)):
        rest[0], rest[1] = x[n], z[n]
        rest_position(coefficients, start, size, tile_m, 0.0, x[n], z[n], rest, out)
        result[n] = out[0]
