# SPDX-License-Identifier: Apache-2.0
"""Area of a polygon inside a pixel, in closed form.

By Green's theorem the area of a polygon clipped to the unit square is the sum over its edges of the integral of
clamp(x(y), 0, 1) dy over the part of the edge with y in [0, 1]. No polygon is clipped and there are no cases: the
primitive of clamp is quadratic inside the square and linear right of it. Compiled; numbers in and out. Twin:
coverage.glsl.
"""

from __future__ import annotations

from mr360uw.jit import exact


@exact
def edge_coverage(ax: float, ay: float, bx: float, by: float) -> float:
    """Return the integral of clamp(x, 0, 1) dy along the edge from a to b where 0 <= y <= 1."""
    y0 = min(max(ay, 0.0), 1.0)
    y1 = min(max(by, 0.0), 1.0)
    if y0 == y1:
        return 0.0
    inverse = (bx - ax) / (by - ay)
    x0 = ax + inverse * (y0 - ay)
    x1 = ax + inverse * (y1 - ay)
    c0 = min(max(x0, 0.0), 1.0)
    c1 = min(max(x1, 0.0), 1.0)
    run = x1 - x0
    if abs(run) < 1e-6:
        return (y1 - y0) * 0.5 * (c0 + c1)
    return (y1 - y0) * (0.5 * (c1 - c0) * (c0 + c1) + max(x1, 1.0) - max(x0, 1.0)) / run


@exact
def twice_area(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle, positive if a, b, c run from +x to +y."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
