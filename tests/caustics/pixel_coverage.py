# SPDX-License-Identifier: Apache-2.0
"""Light of a cell in one pixel, by the closed form of a polygon's area in the unit square (Green's theorem)."""

from __future__ import annotations


def edge_coverage(ax: float, ay: float, bx: float, by: float) -> float:
    """Return the integral of clamp(x, 0, 1) dy along the edge from a to b where 0 <= y <= 1."""
    y0, y1 = min(max(ay, 0.0), 1.0), min(max(by, 0.0), 1.0)
    if y0 == y1:
        return 0.0
    inverse = (bx - ax) / (by - ay)
    x0, x1 = ax + inverse * (y0 - ay), ax + inverse * (y1 - ay)
    c0, c1, run = min(max(x0, 0.0), 1.0), min(max(x1, 0.0), 1.0), x1 - x0
    if abs(run) < 1e-6:
        return (y1 - y0) * 0.5 * (c0 + c1)
    return (y1 - y0) * (0.5 * (c1 - c0) * (c0 + c1) + max(x1, 1.0) - max(x0, 1.0)) / run


def cell_light(
    ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float,
    intensity_b: float, intensity_d: float,
) -> float:  # fmt: skip
    """Return the flux of a cell in the unit square, from the intensities of its two triangles."""
    across = edge_coverage(cx, cy, ax, ay)
    b = edge_coverage(ax, ay, bx, by) + edge_coverage(bx, by, cx, cy) + across
    d = edge_coverage(cx, cy, dx, dy) + edge_coverage(dx, dy, ax, ay) - across
    return intensity_b * b + intensity_d * d
