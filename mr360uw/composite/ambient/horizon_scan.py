# SPDX-License-Identifier: Apache-2.0
"""Horizon scan: intervals of elevation that a body's height field covers, seen from a place, for every azimuth.

Rays in the plan of the body enter and leave at the edges of its convex outline; along them its lower and upper heights
are followed, cell by cell. Bodies that block little are a rectangle of the sky instead, as wide and high as they look.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import inlined

AZIMUTHS, _FROM_OUTSIDE = 32, 24
"""Azimuths all around a place within the outline of a body, and over its width from outside. With 24 within, light
blocked by a box rises by .003 from its middle outwards; the time grows with both.
"""
_HALF, _LEAST = 0.5, 0.25
"""Covered fraction at which a body begins and ends along a ray; from the second on a narrow part blocks a share."""
UNSEEN, SCANNED, _APART = 0.003, 0.03, 3.0
"""A body that cannot block more than the first fraction of uniform light is passed over; it is scanned from the second
on, and nearer than so many radii of its plan: a flat one shows little but its underside, which is no rectangle."""
_ON_EDGE = 1e-9
"""A place nearer to an edge of the outline than this part of the body's size counts as within it."""


@inlined
def most_blocked(squared: Any, beside: Any, wide_squared: Any, highest: Any) -> Any:
    """Return a bound on the fraction of uniform light that a body blocks on level ground: all azimuths of the circle
    around its plan, up to the largest elevation.

    squared, beside, wide_squared: cells of the horizontal distances to the plan's middle and to the plan, and of the
    circle's radius [m^2]. highest: height of the body's upper end above the ground [m].
    """
    if highest <= 0.0:
        return 0.0
    turn = np.arcsin(np.sqrt(wide_squared / squared)) / np.pi if squared > wide_squared else 1.0
    return turn * highest * highest / (beside + highest * highest)


@inlined
def _side(outline: Any, k: Any, a: Any, b: Any) -> Any:
    """Return the k-th edge of an outline (2 numbers) and its cross product with the way to a place, positive inside."""
    n = k + 1 if k + 1 < outline.shape[0] else 0
    ea, eb = outline[n, 0] - outline[k, 0], outline[n, 1] - outline[k, 1]
    return ea, eb, ea * (b - outline[k, 1]) - eb * (a - outline[k, 0])


@inlined
def _corner_side(outline: Any, k: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    """Return on which side of a ray a corner lies: positive where a greater azimuth is."""
    return da * (outline[k, 1] - b) - db * (outline[k, 0] - a)


@inlined
def _width_at(outline: Any, a: Any, b: Any, tiny: Any) -> Any:
    """Return (first azimuth, width, the first edges of the far and the near side, whether it is outside) of a place in
    the plane of an outline. With the azimuth rises the number of the edge on the far side, and falls that on the near.
    Within, the first azimuth is that of an end of the nearest edge, from where on what is blocked may jump.
    """
    count = outline.shape[0]
    start, stop, nearest, least = -1, -1, 0, 1e30
    before = _side(outline, count - 1, a, b)[2] < -tiny
    for k in range(count):
        ea, eb, side = _side(outline, k, a, b)
        seen = side < -tiny
        if seen and not before:
            start = k
        if before and not seen:
            stop = k
        before = seen
        squared = side * side / (ea * ea + eb * eb)
        if squared < least:
            nearest, least = k, squared
    outside = start >= 0 and stop >= 0
    far, near = (stop, stop - 1 if stop > 0 else count - 1) if outside else (nearest, nearest)
    fa, fb = outline[far, 0] - a, outline[far, 1] - b
    first, width = np.arctan2(fb, fa), 2.0 * np.pi
    if outside:
        la, lb = outline[start, 0] - a, outline[start, 1] - b
        width = np.arctan2(max(fa * lb - fb * la, 0.0), fa * la + fb * lb)
    return first, width, far, near, outside


@inlined
def _edges_met(outline: Any, far: Any, near: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    """Return the edges of the far and the near side that a ray meets, from those that the ray before it met."""
    count = outline.shape[0]
    for _ in range(count):
        after = far + 1 if far + 1 < count else 0
        if _corner_side(outline, after, a, b, da, db) > 0.0:
            break
        far = after
    for _ in range(count):
        if _corner_side(outline, near, a, b, da, db) > 0.0:
            break
        near = near - 1 if near > 0 else count - 1
    return far, near


@inlined
def _distance(outline: Any, k: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    """Return how far a place lies from an edge along a direction."""
    ea, eb, side = _side(outline, k, a, b)
    across = ea * db - eb * da
    return max(-side / across, 0.0) if abs(across) > 1e-30 else 0.0


@inlined
def _add_part(found: Any, parts: Any, low: Any, high: Any) -> Any:
    """Add an interval to up to two that do not overlap; return how many there are. A third one widens the second."""
    if parts == 0:
        found[0, 0], found[0, 1] = low, high
        return 1
    which = 0 if low <= found[0, 1] and high >= found[0, 0] else 1
    if which == 1 and parts == 1:
        found[1, 0], found[1, 1] = low, high
        return 2
    found[which, 0], found[which, 1] = min(found[which, 0], low), max(found[which, 1], high)
    if parts == 2 and found[1, 0] <= found[0, 1] and found[1, 1] >= found[0, 0]:
        found[0, 0], found[0, 1] = min(found[0, 0], found[1, 0]), max(found[0, 1], found[1, 1])
        return 1
    return parts


@inlined
def _at(cells: Any, i: Any, j: Any, k: Any, u: Any, v: Any) -> Any:
    """Return the k-th number of cells at (u, v), 0 to 1, between four of them."""
    low = cells[i, j, k] + v * (cells[i, j + 1, k] - cells[i, j, k])
    high = cells[i + 1, j, k] + v * (cells[i + 1, j + 1, k] - cells[i + 1, j, k])
    return low + u * (high - low)


@inlined
def _slopes(cells: Any, y: Any, bounds: Any, way: Any, stride: Any, at: Any, steps: Any, found: Any) -> Any:
    """Set `found` (2, 2) to the least and greatest slopes, in up to two intervals, at which a place at height y meets a
    body along a ray; return how many there are, and the share of the ray's width.

    bounds: least and greatest height. way: the ray's begin and end; at, steps: its begin and stride in cells.
    """
    n = cells.shape[0] - 2
    bottom, top = bounds
    begin, end = way
    parts, inside = 0, False
    low, high, most = 1e30, -1e30, 0.0  # of the part that is followed
    before, s_before, lower_before, upper_before = 0.0, begin, 0.0, 0.0
    number, whole = 0.0, (end - begin) / stride
    while True:
        turns = min(number, whole)
        s, ga, gb = begin + turns * stride, at[0] + turns * steps[0], at[1] + turns * steps[1]
        ia, ib = min(max(int(ga), 0), n), min(max(int(gb), 0), n)
        u, v = min(max(ga - ia, 0.0), 1.0), min(max(gb - ib, 0.0), 1.0)
        covered = _at(cells, ia, ib, 0, u, v)
        now = covered >= _HALF
        if covered > _LEAST or inside:
            lower, upper = _at(cells, ia, ib, 1, u, v) - y, _at(cells, ia, ib, 2, u, v) - y
            if now != inside and number > 0.0:
                t = (_HALF - before) / (covered - before)
                if before <= _LEAST:  # heights beside the body are those of its edge
                    lower_before, upper_before = lower, upper
                away = 1.0 / max(s_before + (s - s_before) * t, 1e-9)
                if now and most < _HALF:  # what was narrow so far belongs to this part
                    low, high = 1e30, -1e30
                low = min(low, (lower_before + t * (lower - lower_before)) * away)
                high = max(high, (upper_before + t * (upper - upper_before)) * away)
            most = max(most, covered)
            if now or (most < _HALF and high < low):
                away = 1.0 / max(s, 1e-9)
                low, high = min(low, lower * away), max(high, upper * away)
            if inside and not now:
                parts = _add_part(found, parts, low, high)
                low, high = 1e30, -1e30
            lower_before, upper_before = lower, upper
        over = high * s >= top and low * end <= bottom and top >= 0.0 and bottom >= 0.0
        if number >= whole or (now and over):  # nothing behind is higher or lower than what was met
            break
        inside, before, s_before = now, covered, s
        number += 1.0
    if high >= low:
        parts = _add_part(found, parts, low, high)
    return parts, min(max(2.0 * most - 0.5, 0.0), 1.0)


@inlined
def place_beside(x: Any, y: Any, z: Any, frame: Any, highest: Any) -> Any:
    """Return where a place lies along both sides of a plan from its middle, whether its body is seen from there, and
    whether it must be scanned.
    """
    a, b = (x - frame[0]) * frame[2] + (z - frame[1]) * frame[3], (z - frame[1]) * frame[2] - (x - frame[0]) * frame[3]
    beside = max(abs(a) - frame[4], 0.0) ** 2 + max(abs(b) - frame[5], 0.0) ** 2
    away, wide = a * a + b * b, frame[4] * frame[4] + frame[5] * frame[5]
    bound = most_blocked(away, beside, wide, highest - y)
    return a, b, bound >= UNSEEN, bound >= SCANNED or away < _APART * _APART * wide


@inlined
def as_rectangle(
    a: Any, b: Any, y: Any, frame: Any, outline: Any, heights: Any, filled: Any, begin: Any, blocked: Any
) -> None:
    """Set one interval for a body at a distance: its width across the view, and its height, of which a part is filled.

    The arguments are those of `scan`. filled: of `HeightField`.
    """
    away = np.sqrt(a * a + b * b)
    u, v = -a / away, -b / away
    least, most = 1e30, -1e30
    for k in range(outline.shape[0]):
        aside = outline[k, 1] * u - outline[k, 0] * v
        least, most = min(least, aside), max(most, aside)
    begin[0] = np.arctan2(v, u) + np.arctan2(frame[3], frame[2]) + np.arctan(least / away)
    begin[1], begin[2] = np.arctan(most / away) - np.arctan(least / away), 1.0
    blocked[0] = 0.0
    blocked[0, 0], blocked[0, 1] = np.arctan((heights[0] - y) / away), np.arctan((heights[1] - y) / away)
    blocked[0, 4] = (abs(u) * frame[5] * filled[0] + abs(v) * frame[4] * filled[1]) / (
        abs(u) * frame[5] + abs(v) * frame[4]
    )


@inlined
def scan(
    a: Any, b: Any, y: Any, frame: Any, outline: Any, cells: Any, heights: Any, begin: Any, blocked: Any, found: Any
) -> None:
    """Set the intervals of elevation that a body covers, seen from a place.

    a, b, y: the place along both sides of the plan from its middle, and its height over the body's origin [m]. frame,
    outline, cells: of `HeightField`; heights: (2,) its least and greatest. found: (2, 2) scratch.
    begin: (3,), set to the first azimuth [rad], the width of one, from +x to +z, and how many there are. blocked:
    (AZIMUTHS, 5), set to lowest and highest elevation [rad] of an interval, those of a second one, equal for none, and
    the fraction of the azimuth's width.
    """
    n = cells.shape[0] - 2
    hu, hv = frame[4], frame[5]
    cu, cv = 2.0 * hu / n, 2.0 * hv / n
    first, width, far, near, outside = _width_at(outline, a, b, _ON_EDGE * (hu * hu + hv * hv))
    count = _FROM_OUTSIDE if outside else AZIMUTHS
    step = width / count
    begin[0], begin[1], begin[2] = first + np.arctan2(frame[3], frame[2]), step, count
    da, db = np.cos(first + 0.5 * step), np.sin(first + 0.5 * step)
    turn_a, turn_b = np.cos(step), np.sin(step)
    bounds = heights[0] - y, heights[1] - y
    for q in range(count):
        if q > 0:
            da, db = da * turn_a - db * turn_b, da * turn_b + db * turn_a
        far, near = _edges_met(outline, far, near, a, b, da, db)
        start = _distance(outline, near, a, b, da, db) if outside else 0.0
        end = max(_distance(outline, far, a, b, da, db), start)
        stride = 1.0 / max(abs(da) / cu, abs(db) / cv)
        at = (a + start * da + hu) / cu + 0.5, (b + start * db + hv) / cv + 0.5
        steps = stride * da / cu, stride * db / cv
        parts, share = _slopes(cells, y, bounds, (start, end), stride, at, steps, found)
        blocked[q] = 0.0
        if share > 0.0:
            blocked[q, 4] = share
            for p in range(parts):
                blocked[q, 2 * p], blocked[q, 2 * p + 1] = np.arctan(found[p, 0]), np.arctan(found[p, 1])
