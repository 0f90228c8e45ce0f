# SPDX-License-Identifier: Apache-2.0
"""Caustics along straight lines of the beam's footprint: running sums, so that the mean over any part costs two reads.

A camera ray meets beams whose places on the mean surface lie on a straight line, and all rays in one plane through the
sun share that line: at a distance s and an angle alpha from the sun a ray is r = s sin(alpha) along it. One set of
running sums over r, one for each plane of a `CausticStack`, thus serves every ray of that plane ("epipolar" slices of
Engelhardt & Dachsbacher 2010; the sums are those of Crow 1984 in one dimension).

Steps of r are as wide as a pixel of the maps, and as wide as the distance to the next line where that is more. The maps
are read at the mip level of a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mr360uw.types import CausticStack

_compiled = njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
_inlined = njit(nogil=True, fastmath=True, error_model="numpy", inline="always")


@dataclass(frozen=True, slots=True, eq=False)
class PatternMaps:
    """Mip levels of a stack in one array, as deviations from 1: sharp red, green, blue and soft in the last axis.

    values: (pixels of all levels, 4) float32, level after level, each (planes, rows, columns). start: (levels,) first
    pixel of each. size: of the finest. depth_m: (planes,). tile_m: side of a map. lean: (2,) x and z of the sun's
    direction over its y, which places points on the mean surface.
    """

    values: NDArray[np.float32]
    start: NDArray[np.int64]
    size: int
    depth_m: NDArray[np.float64]
    tile_m: float
    lean: NDArray[np.float64]

    @classmethod
    def of(cls, stack: CausticStack) -> PatternMaps:
        """Return the maps of a stack."""
        planes, size = stack.ratio.shape[:2]
        pixels = [planes * (size >> k) ** 2 for k in range(size.bit_length())]
        start = np.concatenate([[0], np.cumsum(pixels)])
        values = np.zeros((start[-1], 4), np.float32)
        soft = np.ones((1, 1, 1, 1)) if stack.soft is None else stack.soft
        _fill_levels(stack.ratio, soft, start, values)
        towards = stack.sun_direction
        lean = np.array([towards[0], towards[2]]) / towards[1]
        depth = np.asarray(stack.depth_m, np.float64)
        return cls(values, start[:-1], size, depth, float(stack.tile_m), lean)


@_compiled
def _fill_levels(sharp: Any, soft: Any, start: Any, values: Any) -> None:
    """Write maps (planes, size, size, 3) and (planes, size, size, 1), or (1, 1, 1, 1), with all their halves."""
    planes, size = sharp.shape[:2]
    step = 1 if soft.shape[1] == size else 0
    for plane in range(planes):
        for j in range(size):
            for i in range(size):
                p = (plane * size + j) * size + i
                for c in range(3):
                    values[p, c] = sharp[plane, j, i, c] - 1.0
                values[p, 3] = soft[plane * step, j * step, i * step, 0] - 1.0
    for level in range(1, len(start) - 1):
        fine = size >> (level - 1)
        for row in range(planes * (fine // 2)):
            plane, j = row // (fine // 2), row % (fine // 2)
            above = start[level - 1] + (plane * fine + 2 * j) * fine
            for i in range(fine // 2):
                p, q = above + 2 * i, above + fine + 2 * i
                for c in range(4):
                    total = values[p, c] + values[p + 1, c] + values[q, c] + values[q + 1, c]
                    values[start[level] + row * (fine // 2) + i, c] = 0.25 * total


@_compiled
def line_steps(pixel_m: Any, widening: Any, reach_m: Any) -> Any:
    """Return the edges (n,) [m] of the steps of a line: `pixel_m` wide, or `widening` times the distance if wider."""
    narrow = pixel_m / widening
    even = math.ceil(min(reach_m, narrow) / pixel_m)
    wide = 0
    if reach_m > even * pixel_m:
        wide = math.ceil(math.log(reach_m / (even * pixel_m)) / math.log1p(widening))
    edge = np.empty(even + wide + 1)
    for i in range(even + 1):
        edge[i] = i * pixel_m
    for i in range(wide):
        edge[even + 1 + i] = edge[even] * math.exp((i + 1) * math.log1p(widening))
    return edge


@_compiled
def fill_line(
    values: Any, start: Any, size: Any, first: Any, last: Any, u: Any, v: Any, du: Any, dv: Any, edge: Any,
    sums: Any,
) -> None:  # fmt: skip
    """Write running sums of the maps along a line to `sums` (planes, n + 1, 4), for planes first to last.

    u, v: where it starts, in pixels of the finest map. du, dv: pixels per metre of r. edge: (n + 1,) of `line_steps`.
    """
    most = len(start) - 1
    for plane in range(first, last + 1):
        for c in range(4):
            sums[plane, 0, c] = 0.0
    speed = math.hypot(du, dv)
    for n in range(len(edge) - 1):
        width = edge[n + 1] - edge[n]
        r = 0.5 * (edge[n] + edge[n + 1])
        wanted = max(math.log2(max(width * speed / 1.7320508075688772, 1.0)), 0.0)
        level = min(int(wanted), most)
        part = min(wanted - level, 1.0) if level < most else 0.0
        x, y = u + r * du, v + r * dv
        for plane in range(first, last + 1):
            a0, a1, a2, a3 = _bilinear(values, start[level], size >> level, plane, x / (1 << level), y / (1 << level))
            if part > 0.0:
                k = level + 1
                b0, b1, b2, b3 = _bilinear(values, start[k], size >> k, plane, x / (1 << k), y / (1 << k))
                a0 += (b0 - a0) * part
                a1 += (b1 - a1) * part
                a2 += (b2 - a2) * part
                a3 += (b3 - a3) * part
            sums[plane, n + 1, 0] = sums[plane, n, 0] + a0 * width
            sums[plane, n + 1, 1] = sums[plane, n, 1] + a1 * width
            sums[plane, n + 1, 2] = sums[plane, n, 2] + a2 * width
            sums[plane, n + 1, 3] = sums[plane, n, 3] + a3 * width


@_inlined
def _bilinear(values: Any, start: Any, size: Any, plane: Any, x: Any, y: Any) -> Any:
    """Return the four values of a level of a plane, periodic and bilinear, at pixels (x, y) of that level."""
    x -= 0.5
    y -= 0.5
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    i0, j0 = i % size, j % size
    i1 = i0 + 1 if i0 + 1 < size else 0
    j1 = j0 + 1 if j0 + 1 < size else 0
    top, low = start + (plane * size + j0) * size, start + (plane * size + j1) * size
    w00, w10, w01, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    p, q, s, t = top + i0, top + i1, low + i0, low + i1
    return (
        values[p, 0] * w00 + values[q, 0] * w10 + values[s, 0] * w01 + values[t, 0] * w11,
        values[p, 1] * w00 + values[q, 1] * w10 + values[s, 1] * w01 + values[t, 1] * w11,
        values[p, 2] * w00 + values[q, 2] * w10 + values[s, 2] * w01 + values[t, 2] * w11,
        values[p, 3] * w00 + values[q, 3] * w10 + values[s, 3] * w01 + values[t, 3] * w11,
    )
