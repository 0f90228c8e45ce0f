# SPDX-License-Identifier: Apache-2.0
"""Semi-global smoothing of matching costs on the sphere (Hirschmueller 2008), along eight directions, seam closed."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import fast
from mr360uw.types import Floats

_PATHS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


@fast
def _add_path(cost: Any, total: Any, down: int, right: int, small: Any, large: Any) -> None:
    """Add the path costs of a direction to total (h, w, n). Rows are gone round twice to begin as they end."""
    height, width, count = cost.shape
    last = np.zeros((width, count), np.float32)
    row = np.zeros((width, count), np.float32)
    for j0 in range(height):
        j = j0 if down >= 0 else height - 1 - j0
        for turn in range(2 if down == 0 else 1):
            for i0 in range(width):
                i = i0 if right >= 0 else width - 1 - i0
                before = (i - right) % width
                path = row[before] if down == 0 else last[before]
                if (down != 0 and j0 == 0) or (down == 0 and turn == 0 and i0 == 0):
                    for k in range(count):
                        row[i, k] = cost[j, i, k]
                else:
                    least = path[0]
                    for k in range(1, count):
                        least = min(least, path[k])
                    for k in range(count):
                        best = min(path[k], least + large)
                        if k > 0:
                            best = min(best, path[k - 1] + small)
                        if k < count - 1:
                            best = min(best, path[k + 1] + small)
                        row[i, k] = cost[j, i, k] + best - least
                if down != 0 or turn == 1:
                    for k in range(count):
                        total[j, i, k] += row[i, k]
        for i in range(width):
            for k in range(count):
                last[i, k] = row[i, k]


def smoothed(cost: Floats, small: float, large: float) -> Floats:
    """Return the mean path costs (h, w, n), float32, of matching costs (h, w, n) over n trial distances.

    small: penalty of neighbours that differ by one trial; large: by more.
    """
    total = np.zeros_like(cost)
    for down, right in _PATHS:
        _add_path(cost, total, down, right, np.float32(small), np.float32(large))
    return np.asarray(total / np.float32(len(_PATHS)))
