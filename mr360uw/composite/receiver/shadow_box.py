# SPDX-License-Identifier: Apache-2.0
"""Which places of the receiver a body may shade from the sun or from ambient light, by its box."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import fast


@fast
def mark_shaded(point: Any, reach_m: Any, axes: Any, low: Any, high: Any, spread: Any, marks: Any) -> None:
    """Set the marks (n,) of places between which and the sun a body's box may be.

    axes: (3, 3), one a row, the last towards the sun. low, high: (3,) of the box along them. spread: tangent of the
    sun's radius. reach_m: (n,) of the receiver around each place, which stands for it.
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


@fast
def mark_occluded(point: Any, normal: Any, reach_m: Any, center: Any, radius: Any, axes: Any, half: Any, least: Any,
                  marks: Any) -> None:  # fmt: skip
    """Set the marks (n,) of places that a body touches, or of whose ambient light it may block at least this part.

    center, radius: of a ball around the body. axes, half: (3, 3) rows and (3,) of a box around it. reach_m: (n,) of the
    receiver around each place, which stands for it. Of the box, what faces a place bounds what the body blocks there.
    """
    for i in range(len(marks)):
        if marks[i]:
            continue
        p, n = point[i], normal[i]
        x, y, z = center[0] - p[0], center[1] - p[1], center[2] - p[2]
        near = radius + reach_m[i]
        squared = x * x + y * y + z * z
        if squared < near * near:
            marks[i] = True
            continue
        away = np.sqrt(squared)
        face = 0.0
        for c in range(3):
            d = abs(x * axes[c, 0] + y * axes[c, 1] + z * axes[c, 2]) / away
            face += d * 4.0 * half[(c + 1) % 3] * half[(c + 2) % 3]
        rising = max(x * n[0] + y * n[1] + z * n[2] + near, 0.0) / (away - reach_m[i])
        distance = away - reach_m[i]
        marks[i] = face * min(rising, 1.0) > least * np.pi * distance * distance
