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
from typing import Any

import numpy as np

from mr360uw.jit import fast, inlined
from mr360uw.types import CausticStack

_HALF_WAY = math.sqrt(6.0)
"""Width of a step [pixels] at which the next level is as near: sqrt(3) sqrt(2), see `caustic_lookup` for the first."""


class PatternMaps:
    """Mip levels of a `CausticStack` in one array, down to the first of odd size, as deviations from 1.

    The last axis has sharp red, green, blue, and soft.

    values: (pixels of all levels, 4) float32, level after level, each (planes, rows, columns). start: (levels,) first
    pixel of each. size: of the finest. depth_m: (planes,). tile_m: side of a map. lean: (2,) x and z of the sun's
    direction over its y, which places points on the mean surface.
    """

    def __init__(self, stack: CausticStack | None) -> None:
        """Take a stack, None for no planes."""
        if stack is None:
            self.values, self.start, self.size = np.zeros((1, 4), np.float32), np.zeros(1, np.int64), 1
            self.depth_m, self.tile_m, self.lean = np.zeros(0), 1.0, np.zeros(2)
            return
        planes, self.size = stack.ratio.shape[:2]
        halvings = (self.size & -self.size).bit_length()
        start = np.concatenate([[0], np.cumsum([planes * (self.size >> k) ** 2 for k in range(halvings)])])
        self.values, self.start = np.zeros((start[-1], 4), np.float32), start[:-1]
        soft = np.ones((1, 1, 1, 1)) if stack.soft is None else stack.soft
        _fill_levels(stack.ratio, soft, start, self.values)
        towards = stack.sun_direction
        self.depth_m, self.tile_m = np.asarray(stack.depth_m, np.float64), float(stack.tile_m)
        self.lean = np.array([towards[0], towards[2]]) / towards[1]


@fast
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


@fast
def line_steps(pixel_m: Any, widening: Any, reach_m: Any) -> Any:
    """Return the edges (n + 1,) [m] of the steps of a line: `pixel_m` wide, or `widening` times the distance."""
    even = max(math.ceil(min(reach_m / pixel_m, 1.0 / widening)), 1)
    wide = max(math.ceil(math.log(max(reach_m / (even * pixel_m), 1.0)) / math.log1p(widening)), 0)
    edge = np.empty(even + wide + 1)
    for i in range(even + 1):
        edge[i] = i * pixel_m
    for i in range(wide):
        edge[even + 1 + i] = edge[even] * math.exp((i + 1) * math.log1p(widening))
    return edge


@fast
def fill_line(
    values: Any, start: Any, size: Any, used: Any, u: Any, v: Any, du: Any, dv: Any, edge: Any, sums: Any
) -> None:
    """Write running sums of the maps along a line to `sums` (planes, n + 1, 4), each plane from its first step used on.

    used: (planes, 2) first and last step. u, v: where the line starts, in pixels of the finest map. du, dv: pixels per
    metre of r. edge: (n + 1,) of `line_steps`.
    """
    most = len(start) - 1
    speed = math.hypot(du, dv)
    for plane in range(len(used)):
        if used[plane, 1] >= 0:
            sums[plane, used[plane, 0]] = 0.0
        level, widest = 0, _HALF_WAY / speed
        for n in range(used[plane, 0], used[plane, 1] + 1):
            width = edge[n + 1] - edge[n]
            r = 0.5 * (edge[n] + edge[n + 1])
            while width > widest and level < most:
                level, widest = level + 1, 2.0 * widest
            x, y = (u + r * du) / (1 << level), (v + r * dv) / (1 << level)
            a0, a1, a2, a3 = _bilinear(values, start[level], size >> level, plane, x, y)
            sums[plane, n + 1, 0] = sums[plane, n, 0] + a0 * width
            sums[plane, n + 1, 1] = sums[plane, n, 1] + a1 * width
            sums[plane, n + 1, 2] = sums[plane, n, 2] + a2 * width
            sums[plane, n + 1, 3] = sums[plane, n, 3] + a3 * width


@inlined
def _bilinear(values: Any, start: Any, size: Any, plane: Any, x: Any, y: Any) -> Any:
    """Return the four values of a level of a plane, periodic and bilinear, at pixels (x, y) of that level."""
    x -= 0.5
    y -= 0.5
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    i0, j0, i1, j1 = i % size, j % size, (i + 1) % size, (j + 1) % size
    top, low = start + (plane * size + j0) * size, start + (plane * size + j1) * size
    w00, w10, w01, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    p, q, s, t = top + i0, top + i1, low + i0, low + i1
    return (
        values[p, 0] * w00 + values[q, 0] * w10 + values[s, 0] * w01 + values[t, 0] * w11,
        values[p, 1] * w00 + values[q, 1] * w10 + values[s, 1] * w01 + values[t, 1] * w11,
        values[p, 2] * w00 + values[q, 2] * w10 + values[s, 2] * w01 + values[t, 2] * w11,
        values[p, 3] * w00 + values[q, 3] * w10 + values[s, 3] * w01 + values[t, 3] * w11,
    )
