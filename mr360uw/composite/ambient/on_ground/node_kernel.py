# SPDX-License-Identifier: Apache-2.0
"""Interpolation between the nodes of the ground below a body."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import fast


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
