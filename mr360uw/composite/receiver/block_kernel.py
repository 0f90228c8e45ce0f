# SPDX-License-Identifier: Apache-2.0
"""Size of blocks of the receiver, and evenness of light on them, each found in one compiled pass."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import exact


@exact
def survey_blocks(j: Any, i: Any, corner: Any, middle: Any, reach_m: Any, balls: Any, change: Any, near: Any) -> None:
    """Find how values change over blocks (n,), and which blocks reach into a ball.

    corner: (R + 1, C + 1, k). middle: (R, C, 3) and reach_m: (R, C) of the blocks, balls: (b, 4) middle and radius, all
    [m]. change: (n,) set to the largest difference of two corners in any channel; near: (n,) set.
    """
    for n in range(len(j)):
        r, c = j[n], i[n]
        change[n], near[n] = 0.0, False
        for k in range(corner.shape[2]):
            v00, v01, v10, v11 = corner[r, c, k], corner[r, c + 1, k], corner[r + 1, c, k], corner[r + 1, c + 1, k]
            change[n] = max(change[n], max(v00, v01, v10, v11) - min(v00, v01, v10, v11))
        for b in range(len(balls)):
            x, y, z = middle[r, c, 0] - balls[b, 0], middle[r, c, 1] - balls[b, 1], middle[r, c, 2] - balls[b, 2]
            far = balls[b, 3] + reach_m[r, c]
            near[n] |= x * x + y * y + z * z < far * far


@exact
def measure_blocks(
    j: Any, i: Any, corner: Any, middle: Any, limit: Any, factor: Any, rough: Any, reach_m: Any
) -> None:  # fmt: skip
    """Mark blocks (n,) as rough whose corners or middle do not lie on the receiver, or farther away than `limit` [m].

    corner: (R + 1, C + 1, 3), middle: (R, C, 3), from the camera. reach_m: (R, C) set to `factor` times the distance of
    the farthest corner from the middle.
    """
    for n in range(len(j)):
        r, c = j[n], i[n]
        u, v, w = np.float64(middle[r, c, 0]), np.float64(middle[r, c, 1]), np.float64(middle[r, c, 2])
        far = u * u + v * v + w * w
        off, longest = far == 0.0, 0.0
        for k in range(4):
            p = corner[r + k // 2, c + k % 2]
            x, y, z = np.float64(p[0]), np.float64(p[1]), np.float64(p[2])
            squared = x * x + y * y + z * z
            off |= squared == 0.0
            far = max(far, squared)
            longest = max(longest, (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2)
        rough[r, c] |= off or far > limit * limit
        reach_m[r, c] = factor * np.sqrt(longest)


@exact
def mark_changed(j: Any, i: Any, corner: Any, middle: Any, reach_m: Any, balls: Any, least: Any, marks: Any) -> None:
    """Set the marks (n,) of blocks that reach into a ball, or where a factor at a corner is not 1 by more than `least`.

    corner: (R + 1, C + 1, k) factors; the others are those of `survey_blocks`.
    """
    one = corner.dtype.type(1)
    for n in range(len(j)):
        r, c = j[n], i[n]
        for k in range(corner.shape[2]):
            v00, v01, v10, v11 = corner[r, c, k], corner[r, c + 1, k], corner[r + 1, c, k], corner[r + 1, c + 1, k]
            marks[n] |= max(abs(v00 - one), abs(v01 - one), abs(v10 - one), abs(v11 - one)) > least
        for b in range(len(balls)):
            x, y, z = middle[r, c, 0] - balls[b, 0], middle[r, c, 1] - balls[b, 1], middle[r, c, 2] - balls[b, 2]
            far = balls[b, 3] + reach_m[r, c]
            marks[n] |= x * x + y * y + z * z < far * far
