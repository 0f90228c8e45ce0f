# SPDX-License-Identifier: Apache-2.0
"""Refracted image of one cell of the surface grid: two triangles whose flux is shared over pixels.

Corners a, b, c, d run around the cell; the triangles are (a, b, c) and (a, c, d). Each has an intensity, flux over
signed area [1/pixel^2]. Intensity times signed coverage is the flux in a pixel, for folded triangles too. Compiled; a
cell is eight coordinates in pixels.
"""

from __future__ import annotations

from mr360uw.jit import exact

THINNEST = 2e-3
"""Twice the area [pixel^2] below which a triangle gives its flux to the other one of its cell.

Single precision resolves no smaller areas. Twice as large, cells at folds are drawn twice as wide, which is still about
a hundredth of a pixel.
"""

Cell = tuple[float, float, float, float, float, float, float, float]


@exact
def twice_area(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle, positive if a, b, c run from +x to +y."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@exact
def opened(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> Cell:
    """Return the corners, pulled apart where both triangles are thinner than `THINNEST`.

    At a fold of the caustic a cell becomes a line without area. The longer diagonal stays (or is drawn out to a
    twentieth of a pixel) and becomes a c; the two other corners move to either side of it.
    """
    if abs(twice_area(ax, ay, bx, by, cx, cy)) >= THINNEST or abs(twice_area(ax, ay, cx, cy, dx, dy)) >= THINNEST:
        return ax, ay, bx, by, cx, cy, dx, dy
    if (dx - bx) ** 2 + (dy - by) ** 2 > (cx - ax) ** 2 + (cy - ay) ** 2:
        ax, ay, cx, cy = bx, by, dx, dy
    ex, ey = cx - ax, cy - ay
    length2 = ex * ex + ey * ey
    if length2 < 0.0025:
        ex, ey, length2 = 0.05, 0.0, 0.0025
        cx, cy = ax + ex, ay
    wide = 1.5 * THINNEST / length2
    mx, my = ax + 0.5 * ex, ay + 0.5 * ey
    return ax, ay, mx + wide * ey, my - wide * ex, cx, cy, mx - wide * ey, my + wide * ex


@exact
def intensities(
    ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float, flux_b: float, flux_d: float
) -> tuple[float, float]:
    """Return the signed intensities of the triangles (a, b, c) and (a, c, d) of an opened cell.

    A triangle thinner than `THINNEST` gives its flux to the other one.
    """
    b = twice_area(ax, ay, bx, by, cx, cy)
    d = twice_area(ax, ay, cx, cy, dx, dy)
    if abs(b) < THINNEST:
        return 0.0, 2.0 * (flux_b + flux_d) / d
    if abs(d) < THINNEST:
        return 2.0 * (flux_b + flux_d) / b, 0.0
    return 2.0 * flux_b / b, 2.0 * flux_d / d
