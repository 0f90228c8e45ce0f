# SPDX-License-Identifier: Apache-2.0
"""Flux of triangles in every pixel of a periodic map, accumulated along their edges.

In one row of pixels, a triangle's covered area is the area right of its edges that run down less the area right of
those that run up. Each edge stores the *change* of that area from pixel to pixel where it crosses the row, times the
intensity. A running sum along the row then gives the flux. The work grows with the length of the edges, not with the
area of the triangles, and two triangles share an edge. Font rasterisers work the same way; `coverage` gives the same
result pixel by pixel, as graphics hardware needs it. In a periodic row an edge in the n-th tile lies right of the row's
beginning n times, which `start` accounts for. Compiled; float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact

Array = NDArray[np.floating[Any]]


@exact
def add_edge(change: Array, start: Array, ax: float, ay: float, bx: float, by: float, light: float) -> None:
    """Add the intensity `light` [1/pixel^2] right of the edge from a to b [pixel], positive where it runs down (+y).

    change: (size, size + 1) difference of each pixel to the one left of it; the last column belongs to the next tile
    and is not summed. start: (size,) value of each row before its first pixel. Both are changed in place.
    """
    if light == 0.0 or ay == by:
        return
    size = start.shape[0]
    if ay > by:
        ax, ay, bx, by, light = bx, by, ax, ay, -light
    run, low, high = (bx - ax) / (by - ay), min(ax, bx), max(ax, bx)
    bottom = np.floor(ay)
    row = int(bottom)
    if row < 0 or row >= size:
        row %= size
    x0, y0 = ax, ay
    while y0 < by:
        bottom += 1.0
        y1 = min(bottom, by)
        # the slope of an edge that hardly falls may overflow
        x1 = min(high, max(low, ax + run * (y1 - ay))) if bottom < by else bx
        height = light * (y1 - y0)
        left, right = min(x0, x1), max(x0, x1)
        pixel = np.floor(left)
        column = int(pixel)
        if column < 0 or column >= size:  # divisions are slow, and most edges lie in the first tile
            tile = column // size
            column -= tile * size
            start[row] -= height * tile
        before = 0.0
        if right > pixel + 1.0:
            slope = height / (right - left)
            while right > pixel + 1.0:
                # the part of the pixel right of an edge that enters it, or enters and leaves it
                inside = 0.5 * slope * (pixel + 1.0 - left) ** 2 if left > pixel else slope * (pixel + 0.5 - left)
                change[row, column] += inside - before
                before = inside
                pixel += 1.0
                column += 1
                if column == size:
                    column = 0
                    start[row] -= height - before
            inside = height - 0.5 * slope * (right - pixel) ** 2
        else:
            inside = height * (pixel + 1.0 - 0.5 * (left + right))
        change[row, column] += inside - before
        change[row, column + 1] += height - inside
        x0, y0 = x1, y1
        row = row + 1 if row + 1 < size else 0


def running_sum(change: Array, start: Array) -> Array:
    """Return the flux (size, size) of all added edges; negative values, which are roundings, become 0."""
    light = np.concatenate([start[:, None], change[:, :-1]], axis=1).cumsum(axis=1)
    return np.maximum(light[:, 1:], 0.0)
