# SPDX-License-Identifier: Apache-2.0
"""Interpolation between the nodes of the ground below a body."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import exact, fast


@fast
def between_nodes(place: Any, values: Any, out: Any) -> None:
    """Set `out` (n, c) to values (k, k, c) of a grid of nodes at places (n, 2), 0 to k - 1.

    A cubic spline through the nodes whose slopes there are half the differences of their neighbours: light has no bends
    along lines of nodes. It is cut to the range of the four nodes around.
    """
    last = values.shape[0] - 1
    weight, index = np.zeros((2, 4)), np.zeros((2, 4), np.int64)
    for n in range(len(place)):
        for axis in range(2):
            i = min(int(place[n, axis]), last - 1)
            t = place[n, axis] - i
            weight[axis, 0] = 0.5 * t * (t * (2.0 - t) - 1.0)
            weight[axis, 1] = 0.5 * (t * t * (3.0 * t - 5.0) + 2.0)
            weight[axis, 2] = 0.5 * t * (t * (4.0 - 3.0 * t) + 1.0)
            weight[axis, 3] = 0.5 * t * t * (t - 1.0)
            for k in range(4):
                index[axis, k] = min(max(i + k - 1, 0), last)
        for c in range(out.shape[1]):
            total, least, most = 0.0, 1e30, -1e30
            for k in range(4):
                for m in range(4):
                    value = values[index[0, k], index[1, m], c]
                    total += weight[0, k] * weight[1, m] * value
                    if 0 < k < 3 and 0 < m < 3:
                        least, most = min(least, value), max(most, value)
            out[n, c] = min(max(total, least), most)


@exact
def from_nodes(points: Any, ends: Any, factor: Any, side: Any, begin: Any, column: Any, weight: Any) -> None:
    """Set `begin`, `column` and `weight` of a sparse matrix that gives the sum over b bodies of the values of their
    side^2 nodes at places (n, 3), bilinear, times factors (b, n).

    ends: (b, 2, 3) places of the first and the last node of each.
    """
    used = 0
    for n in range(len(points)):
        for m in range(len(ends)):
            if factor[m, n] == 0.0:
                continue
            low, high = ends[m, 0], ends[m, 1]
            x = min(max((points[n, 0] - low[0]) / (high[0] - low[0]) * (side - 1), 0.0), side - 1.001)
            z = min(max((points[n, 2] - low[2]) / (high[2] - low[2]) * (side - 1), 0.0), side - 1.001)
            i, j = int(x), int(z)
            for corner in range(4):
                a, b = corner // 2, corner % 2
                share = (x - i if a else 1.0 - (x - i)) * (z - j if b else 1.0 - (z - j))
                column[used] = (m * side + i + a) * side + j + b
                weight[used] = share * factor[m, n]
                used += 1
        begin[n + 1] = used
