# SPDX-License-Identifier: Apache-2.0
"""Deviation of the sun's beam along rays through one pole: compiled loops of `froxels` (Hillaire 2015, eq. of slices).

Rays of one column share a plane through the sun and with it the running sums of `pattern_lines`. A segment takes the
mean of the caustics over its part of the line, at the depth of its middle, and the exact integral of its smooth light.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from mr360uw.medium.shafts.pattern_lines import fill_line, line_steps

_compiled = njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
_inlined = njit(nogil=True, fastmath=True, error_model="numpy", inline="always")

SHORTEST_M = 1e-6
"""Part of a line [m] over which the difference of two sums is still free of roundings."""


@_inlined
def node_edges(rate: Any, reach: Any, count: Any, edge: Any) -> None:
    """Write the edges (count + 1,) [m] of a ray's segments: `ray_segments.radius_at`."""
    x = rate * reach
    for k in range(count + 1):
        t = k / count
        edge[k] = reach * t if abs(x) < 1e-6 else -reach * math.log1p(t * math.expm1(-x)) / x


@_compiled
def add_beam(
    starts: Any, up: Any, sine: Any, rate: Any, reach: Any, turned: Any, weights: Any, seen: Any, depth_m: Any,
    values: Any, level_start: Any, size: Any, planes: Any, tile_m: Any, place: Any, course: Any, widening: Any,
    light: Any,
) -> None:  # fmt: skip
    """Add the deviation of each segment to `light` (n, count, 3) for rays sorted by column.

    starts: (columns + 1,) first ray of each column. up, sine: (n,) height of rays, and sine of their angle from the
    sun. rate, reach: (n,) of `ShaftScene.layout`. turned: (n, 2) phase functions. weights: (m, count, 12) of
    `beam_weights`. seen: (n, count, 2) visible fractions of disc and halo, or (0, 0, 2). depth_m: of the camera.
    values to tile_m: `PatternMaps`, planes (0,) without caustics. place: (2,) of the camera on the mean surface [m].
    course: (columns, 2) its change per metre of a line. widening: angle between columns.
    """
    count = light.shape[1]
    edge = np.empty(count + 1)
    c = np.zeros(4)
    last_plane = len(planes) - 1
    pixel = tile_m / size
    sums = np.empty((max(last_plane + 1, 1), 1, 4))
    for column in range(len(starts) - 1):
        first, end = starts[column], starts[column + 1]
        if first == end:
            continue
        if last_plane >= 0:
            farthest, highest, lowest = pixel, depth_m, depth_m
            for n in range(first, end):
                farthest = max(farthest, reach[n] * sine[n])
                highest = min(highest, depth_m - reach[n] * up[n])
                lowest = max(lowest, depth_m - reach[n] * up[n])
            speed = math.hypot(course[column, 0], course[column, 1])
            step = pixel / speed
            lines = line_steps(step, widening, farthest)
            even = _even(step, widening, farthest)
            if sums.shape[1] < len(lines):
                sums = np.empty((last_plane + 1, len(lines), 4))
            low, _ = _plane(planes, highest)
            high, _ = _plane(planes, lowest)
            scale = size / tile_m
            fill_line(
                values, level_start, size, low, min(high + 1, last_plane), place[0] * scale, place[1] * scale,
                course[column, 0] * scale, course[column, 1] * scale, lines, sums,
            )  # fmt: skip
        for n in range(first, end):
            node_edges(rate[n], reach[n], count, edge)
            x = (up[n] + 1.0) * 0.5 * (len(weights) - 1)
            row = min(int(x), len(weights) - 2)
            part = x - row
            i0, f0 = 0, 0.0
            for k in range(count):
                c[0] = c[1] = c[2] = c[3] = 0.0
                if last_plane >= 0:
                    i1, f1 = _position(edge[k + 1] * sine[n], lines, even, step, widening)
                    middle = max(depth_m - 0.5 * (edge[k] + edge[k + 1]) * up[n], 0.0)
                    plane, between = _plane(planes, middle)
                    _mean(sums, lines, plane, i0, f0, i1, f1, 1.0 - between, c)
                    if between > 0.0:
                        _mean(sums, lines, plane + 1, i0, f0, i1, f1, between, c)
                    focused = min(middle / planes[0], 1.0)
                    for j in range(4):
                        c[j] *= focused
                    i0, f0 = i1, f1
                disc, halo = (seen[n, k, 0], seen[n, k, 1]) if len(seen) else (1.0, 1.0)
                soft = (1.0 + c[3]) * halo
                for j in range(3):
                    whole = sharp = 0.0
                    for kind in range(2):
                        a, b = 3 * kind + j, 6 + 3 * kind + j
                        lower, upper = weights[row, k, a], weights[row + 1, k, a]
                        whole += turned[n, kind] * (lower + (upper - lower) * part)
                        lower, upper = weights[row, k, b], weights[row + 1, k, b]
                        sharp += turned[n, kind] * (lower + (upper - lower) * part)
                    crisp = (1.0 + c[j]) * disc
                    light[n, k, j] += whole * (soft - 1.0) + sharp * (crisp - soft)


@_inlined
def _plane(planes: Any, depth: Any) -> Any:
    """Return the plane above a depth and the fraction of the way to the next one, 0 beyond the first and the last."""
    last = len(planes) - 1
    if depth <= planes[0] or last == 0:
        return 0, 0.0
    if depth >= planes[last]:
        return last, 0.0
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if planes[middle] <= depth:
            low = middle
        else:
            high = middle
    return low, (depth - planes[low]) / (planes[high] - planes[low])


@_inlined
def _even(step: Any, widening: Any, reach: Any) -> Any:
    """Return the number of steps of equal width in `line_steps`."""
    return math.ceil(min(reach, step / widening) / step)


@_inlined
def _position(r: Any, edge: Any, even: Any, step: Any, widening: Any) -> Any:
    """Return the step that r lies in, and where in it as a fraction."""
    last = len(edge) - 2
    i = int(r / step)
    if i >= even:
        i = even + int(math.log(r / edge[even]) / math.log1p(widening)) if last >= even else last
    i = min(max(i, 0), last)
    return i, min(max((r - edge[i]) / (edge[i + 1] - edge[i]), 0.0), 1.0)


@_inlined
def _mean(sums: Any, edge: Any, plane: Any, i0: Any, f0: Any, i1: Any, f1: Any, weight: Any, c: Any) -> None:
    """Add `weight` times the mean over the part of a line between two positions to `c` (4,)."""
    start, end = edge[i0] + f0 * (edge[i0 + 1] - edge[i0]), edge[i1] + f1 * (edge[i1 + 1] - edge[i1])
    if end - start < SHORTEST_M:
        width = edge[i0 + 1] - edge[i0]
        for j in range(4):
            c[j] += weight * (sums[plane, i0 + 1, j] - sums[plane, i0, j]) / width
        return
    scale = weight / (end - start)
    for j in range(4):
        before = sums[plane, i0, j] + f0 * (sums[plane, i0 + 1, j] - sums[plane, i0, j])
        behind = sums[plane, i1, j] + f1 * (sums[plane, i1 + 1, j] - sums[plane, i1, j])
        c[j] += scale * (behind - before)
