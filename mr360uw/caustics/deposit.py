# SPDX-License-Identifier: Apache-2.0
"""Deposits the flux of refracted surface cells into a periodic map by exact pixel coverage.

`hit`: (N + 1, N + 1, 2) where the grid's rays meet the plane, in pixels of the map, the last row and column one period
on. `flux`: (N, N, 2) flux of each cell's two triangles (a, b, c) and (a, c, d), a = (i, j), b = (i + 1, j), c =
(i + 1, j + 1), d = (i, j + 1). Maps are (size, size), row = z, flux per pixel. Compiled; float64.

Each triangle has an intensity, flux over signed area [1/pixel^2]. Intensity times signed coverage is the flux in a
pixel, for folded triangles too. It is accumulated along edges. In one row of pixels, a triangle's covered area is the
area right of its edges that run down less the area right of those that run up. Each edge stores the *change* of that
area from pixel to pixel where it crosses the row, times the intensity. A running sum along the row then gives the flux.
The work grows with the length of the edges, not with the area of the triangles, and two triangles share an edge. Font
rasterisers work the same way; `coverage` gives the same result pixel by pixel. In a periodic row an edge in the n-th
tile lies right of the row's beginning n times, which `start` accounts for.
"""

from __future__ import annotations

import numpy as np

from mr360uw.jit import exact
from mr360uw.types import Floats

_UPRIGHT = 1e-150
"""Width [pixel] of an edge up to which it is upright: where it crosses a pixel's side its slope may overflow."""


@exact
def add_edge(change: Floats, start: Floats, ax: float, ay: float, bx: float, by: float, light: float) -> None:
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
        if right > pixel + 1.0 and right - left > _UPRIGHT:
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


_THINNEST = 2e-3
"""Twice the area [pixel^2] below which a triangle gives its flux to the other one of its cell.

Single precision resolves no smaller areas. Twice as large, cells at folds are drawn twice as wide, which is still about
a hundredth of a pixel.
"""

Cell = tuple[float, float, float, float, float, float, float, float]


@exact
def _twice_area(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle, positive if a, b, c run from +x to +y."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@exact
def opened(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> Cell:
    """Return the corners, pulled apart where both triangles are thinner than `_THINNEST`.

    At a fold of the caustic a cell becomes a line without area. The longer diagonal stays (or is drawn out to a
    twentieth of a pixel) and becomes a c; the two other corners move to either side of it.
    """
    if abs(_twice_area(ax, ay, bx, by, cx, cy)) >= _THINNEST or abs(_twice_area(ax, ay, cx, cy, dx, dy)) >= _THINNEST:
        return ax, ay, bx, by, cx, cy, dx, dy
    if (dx - bx) ** 2 + (dy - by) ** 2 > (cx - ax) ** 2 + (cy - ay) ** 2:
        ax, ay, cx, cy = bx, by, dx, dy
    ex, ey = cx - ax, cy - ay
    length2 = ex * ex + ey * ey
    if length2 < 0.0025:
        ex, ey, length2 = 0.05, 0.0, 0.0025
        cx, cy = ax + ex, ay
    wide = 1.5 * _THINNEST / length2
    mx, my = ax + 0.5 * ex, ay + 0.5 * ey
    return ax, ay, mx + wide * ey, my - wide * ex, cx, cy, mx - wide * ey, my + wide * ex


@exact
def intensities(corners: Cell, flux_b: float, flux_d: float) -> tuple[float, float]:
    """Return the signed intensities of the triangles (a, b, c) and (a, c, d) of an opened cell.

    A triangle thinner than `_THINNEST` gives its flux to the other one.
    """
    ax, ay, bx, by, cx, cy, dx, dy = corners
    b = _twice_area(ax, ay, bx, by, cx, cy)
    d = _twice_area(ax, ay, cx, cy, dx, dy)
    if abs(b) < _THINNEST:
        return 0.0, 2.0 * (flux_b + flux_d) / d
    if abs(d) < _THINNEST:
        return 2.0 * (flux_b + flux_d) / b, 0.0
    return 2.0 * flux_b / b, 2.0 * flux_d / d


def deposit_exact(hit: Floats, flux: Floats, size: int) -> Floats:
    """Return each cell's flux shared over pixels by the area it covers of them; the sum is that of the flux.

    The light of a cell as wide as the whole map is spread evenly.
    """
    cells = flux.shape[0]
    change, start = np.zeros((size, size + 1)), np.zeros(size)
    evenly = _add_cells(hit, flux, change, start, np.zeros((cells + 1, cells + 1, 2)))
    # Sum the edges along the rows; negative values are roundings
    light = np.concatenate([start[:, None], change[:, :-1]], axis=1).cumsum(axis=1)
    return np.maximum(light[:, 1:], 0.0) + evenly / (size * size)


@exact
def _add_cells(hit: Floats, flux: Floats, change: Floats, start: Floats, light: Floats) -> float:
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
            corners = opened(
                hit[j, i, 0], hit[j, i, 1], hit[j, i + 1, 0], hit[j, i + 1, 1],
                hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], hit[j + 1, i, 0], hit[j + 1, i, 1],
            )  # fmt: skip
            ax, ay, bx, by, cx, cy, dx, dy = corners
            wide = np.ceil(max(ax, bx, cx, dx)) - np.floor(min(ax, bx, cx, dx))
            high = np.ceil(max(ay, by, cy, dy)) - np.floor(min(ay, by, cy, dy))
            if wide >= size or high >= size:
                evenly += flux_b + flux_d
                continue
            in_b, in_d = intensities(corners, flux_b, flux_d)
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
