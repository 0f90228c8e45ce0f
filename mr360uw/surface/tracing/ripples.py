# SPDX-License-Identifier: Apache-2.0
"""Slopes of ripples, and of waves that a footprint takes: compiled, for one ray at a time."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.jit import exact
from mr360uw.surface.tracing.ray_optics import Vector

_GONE = 1e-6
"""Share of the ripples' slopes below which they are not looked up."""


class Ripples(NamedTuple):
    """The numbers of the ripples of a sea. a, b: repeats of the two maps in a tile. ax, az, bx, bz: their scroll, in
    repeats. wave: [rad/m] of the dominant one. variance: of slope along each axis, 0 for none. blur: variance of slope
    along each axis of waves that are not drawn.
    """

    tile_m: float
    a: float
    b: float
    ax: float
    az: float
    bx: float
    bz: float
    wave: float
    variance: float
    blur: float


@exact
def level_slopes(lost: Any, blur: float, level: float) -> Vector:
    """Return `SampledSea.unresolved` of one level: the covariance xx, xz, zz of the slopes that it lacks."""
    lower = min(int(level), max(len(lost) - 2, 0))
    share = min(level - lower, 1.0)
    upper = min(lower + 1, len(lost) - 1)
    xx = lost[lower, 0] + share * (lost[upper, 0] - lost[lower, 0])
    xz = lost[lower, 1] + share * (lost[upper, 1] - lost[lower, 1])
    zz = lost[lower, 2] + share * (lost[upper, 2] - lost[lower, 2])
    return xx + blur, xz, zz + blur


@exact
def tilted(r: Any, ripples: Ripples, normal: Vector, x: float, z: float, sigma_m: float) -> tuple[Vector, float]:
    """Return a normal with the ripples' slopes at a rest position, and the slope variance along each axis of ripples
    that are smaller than a footprint. r: (size, size, 2) slopes of their map.

    Twin of the sum of slopes: caustics/sea/detail.py.
    """
    if ripples.variance <= 0.0:
        return normal, 0.0
    kept = math.exp(-0.5 * (ripples.wave * sigma_m) ** 2)
    gone = (1.0 - kept * kept) * ripples.variance
    if kept < _GONE:
        return normal, gone
    u, v = x / ripples.tile_m, z / ripples.tile_m
    first_x, first_z = _slope(r, ripples.a * u + ripples.ax, ripples.a * v + ripples.az)
    second_z, second_x = _slope(r, ripples.b * v + ripples.bz, ripples.b * u + ripples.bx)
    nx = normal[0] - normal[1] * kept * (first_x + second_x)
    nz = normal[2] - normal[1] * kept * (first_z + second_z)
    length = math.sqrt(nx * nx + normal[1] * normal[1] + nz * nz)
    return (nx / length, normal[1] / length, nz / length), gone


@exact
def _slope(r: Any, u: float, v: float) -> tuple[float, float]:
    """Return `caustics.sea.detail.periodic_slope` of one place."""
    size = r.shape[0]
    x, y = u * size, v * size
    column, row = math.floor(x), math.floor(y)
    i, j = int(column), int(row)
    i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
    fx, fy = x - column, y - row
    a, b, c, d = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        a * r[j0, i0, 0] + b * r[j0, i1, 0] + c * r[j1, i0, 0] + d * r[j1, i1, 0],
        a * r[j0, i0, 1] + b * r[j0, i1, 1] + c * r[j1, i0, 1] + d * r[j1, i1, 1],
    )
