# SPDX-License-Identifier: Apache-2.0
"""Which places of the receiver the shadow of a body may fall on, by its box."""

from __future__ import annotations

from typing import Any

import numba

_compiled = numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def mark_shaded(point: Any, reach_m: Any, axes: Any, low: Any, high: Any, spread: Any, marks: Any) -> None:
    """Set the marks (n,) of places between which and the sun a body's box may be.

    axes: (3, 3), one a row, the last towards the sun. low, high: (3,) of the box along them. spread: tangent of the
    sun's radius. reach_m: (n,) of the receiver around each place,
    which stands for it.
    """
    for i in range(len(marks)):
        p, reach = point[i], reach_m[i]
        above = high[2] - (p[0] * axes[2, 0] + p[1] * axes[2, 1] + p[2] * axes[2, 2]) + reach
        wide = reach + spread * max(above, 0.0)
        u = p[0] * axes[0, 0] + p[1] * axes[0, 1] + p[2] * axes[0, 2]
        v = p[0] * axes[1, 0] + p[1] * axes[1, 1] + p[2] * axes[1, 2]
        beside = max(low[0] - u, u - high[0], low[1] - v, v - high[1])
        if above > 0.0 and beside <= wide:
            marks[i] = True
