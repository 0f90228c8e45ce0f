# SPDX-License-Identifier: Apache-2.0
"""Displacement of a sampled sea and its derivatives at a rest position: compiled, for one point at a time.

A particle at rest at (a, b) stands at (a + shift_x, height, b + shift_z). c: (n, 3) coefficients; n: (L, 2) of every
level its first coefficient and its points across the tile, powers of two: see `SampledSea`. Arrays are passed one by
one, as those in a tuple would be counted at every call.
"""

from __future__ import annotations

import math
from typing import Any

from mr360uw.jit import exact

Displacement = tuple[float, float, float, float, float, float, float, float, float]
"""Height, shift_x and shift_z, their derivatives by a and those by b."""


@exact
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


@exact
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


@exact
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


@exact
def heights_at(c: Any, n: Any, tile_m: float, x: Any, z: Any, result: Any) -> None:
    """Write the height of the surface over the mean at places (n,) into `result` (n,)."""
    for k in range(len(x)):
        result[k] = rest_position(c, n, tile_m, 0.0, x[k], z[k], x[k], z[k], 1e-11 * tile_m)[2][0]
