# SPDX-License-Identifier: Apache-2.0
"""Deposits the flux of refracted surface cells into a periodic map by exact pixel coverage.

`hit`: (N + 1, N + 1, 2) where the grid's rays meet the plane, in pixels of the map, the last row and column one period
on. `flux`: (N, N, 2) flux of each cell's two triangles (a, b, c) and (a, c, d), a = (i, j), b = (i + 1, j), c =
(i + 1, j + 1), d = (i, j + 1). Maps are (size, size), row = z, flux per pixel. Compiled; float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.cell import intensities, opened
from mr360uw.caustics.flux.edges import add_edge, running_sum
from mr360uw.jit import exact

Array = NDArray[np.floating[Any]]


def deposit_exact(hit: Array, flux: Array, size: int) -> Array:
    """Return each cell's flux shared over pixels by the area it covers of them; the sum is that of the flux.

    The light of a cell as wide as the whole map is spread evenly.
    """
    cells = flux.shape[0]
    change, start = np.zeros((size, size + 1)), np.zeros(size)
    evenly = _add_cells(hit, flux, change, start, np.zeros((cells + 1, cells + 1, 2)))
    return running_sum(change, start) + evenly / (size * size)


@exact
def _add_cells(hit: Array, flux: Array, change: Array, start: Array, light: Array) -> float:
    """Add the edges of all cells, see `add_edge`; return the flux of cells as wide as the map.

    light: (N + 1, N + 1, 2) zeros, room for that of each cell's triangles behind a row and a column without cells.
    """
    cells, size = flux.shape[0], start.shape[0]
    evenly = 0.0
    for j in range(cells):
        for i in range(cells):
            flux_b, flux_d = flux[j, i, 0], flux[j, i, 1]
            if flux_b + flux_d == 0.0:
                continue
            ax, ay, bx, by, cx, cy, dx, dy = opened(
                hit[j, i, 0], hit[j, i, 1], hit[j, i + 1, 0], hit[j, i + 1, 1],
                hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], hit[j + 1, i, 0], hit[j + 1, i, 1],
            )  # fmt: skip
            wide = np.ceil(max(ax, bx, cx, dx)) - np.floor(min(ax, bx, cx, dx))
            high = np.ceil(max(ay, by, cy, dy)) - np.floor(min(ay, by, cy, dy))
            if wide >= size or high >= size:
                evenly += flux_b + flux_d
                continue
            in_b, in_d = intensities(ax, ay, bx, by, cx, cy, dx, dy, flux_b, flux_d)
            if bx == hit[j, i + 1, 0] and by == hit[j, i + 1, 1]:
                light[j + 1, i + 1, 0], light[j + 1, i + 1, 1] = in_b, in_d
                continue
            add_edge(change, start, ax, ay, bx, by, -in_b)
            add_edge(change, start, bx, by, cx, cy, -in_b)
            add_edge(change, start, ax, ay, cx, cy, in_b - in_d)
            add_edge(change, start, cx, cy, dx, dy, -in_d)
            add_edge(change, start, dx, dy, ax, ay, -in_d)
    for i in range(cells + 1):  # rows close on themselves; columns close one tile on
        light[0, i, 0], light[0, i, 1] = light[cells, i, 0], light[cells, i, 1]
    for j in range(cells):
        for i in range(cells):
            ax, ay = hit[j, i, 0], hit[j, i, 1]
            in_b, in_d = light[j + 1, i + 1, 0], light[j + 1, i + 1, 1]
            add_edge(change, start, ax, ay, hit[j, i + 1, 0], hit[j, i + 1, 1], light[j, i + 1, 1] - in_b)
            add_edge(change, start, ax, ay, hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], in_b - in_d)
            add_edge(change, start, ax, ay, hit[j + 1, i, 0], hit[j + 1, i, 1], in_d - light[j + 1, i, 0])
        bx, by = hit[j, cells, 0], hit[j, cells, 1]
        add_edge(change, start, bx, by, hit[j + 1, cells, 0], hit[j + 1, cells, 1], -light[j + 1, cells, 0])
    return evenly
