# SPDX-License-Identifier: Apache-2.0
"""Elevations that a body blocks at places: rays in its plan, cut exactly by the plan's outline, along which its lower
and upper heights are followed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.composite.ambient.on_ground.body_bound import most_blocked
from mr360uw.jit import fast, inlined

AZIMUTHS, _FROM_OUTSIDE = 32, 24
"""Azimuths all around a place within the outline of a body, and over its width from outside. With 24 within, light
blocked by a box rises by .003 from its middle outwards; the time grows with both.
"""
_HALF, _LEAST = 0.5, 0.25
"""Covered fraction at which a body begins and ends along a ray; from the second on a narrow part blocks a share."""
_UNSEEN = 0.003
"""A body that cannot block more than this fraction is passed over: far less than what is shown of one."""
_HALVED, _QUARTERED = 4.0, 9.0
"""From so many half widths on, half and a quarter of the azimuths and of the steps along them do."""
STEP = 4
"""Cells that a ray passes at once where the heights on its way are straight."""
_ON_EDGE = 1e-9
"""A place nearer to an edge of the outline than this part of the body's size counts as within it."""


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
def _at(squares: Any, i: Any, j: Any, k: Any, u: Any, v: Any) -> Any:
    """Return a bilinear value of a square, whose coefficients begin at the k-th number."""
    return squares[i, j, k] + u * squares[i, j, k + 1] + v * (squares[i, j, k + 2] + u * squares[i, j, k + 3])


@inlined
def _hop(squares: Any, ga: Any, gb: Any, s: Any, hops: Any) -> Any:
    """Return how many steps a ray at distance s may take at once, up to `hops`, about a place in cells."""
    n = squares.shape[0] - 1
    from_there = squares[min(max(int(ga), 0), n), min(max(int(gb), 0), n), 12]
    return hops if from_there <= s else max(0.5 * hops, 1.0) if from_there <= 4.0 * s else 1.0


@inlined
def _slopes(
    squares: Any, y: Any, bounds: Any, way: Any, stride: Any, hops: Any, at: Any, steps: Any, found: Any
) -> Any:
    """Set `found` (2, 2) to the least and greatest slopes, in up to two intervals, at which a place at height y meets a
    body along a ray; return how many there are, and the share of the ray's width.

    bounds: least and greatest height. way: the ray's begin and end; at, steps: its begin and stride in cells. hops:
    strides over `STEP` cells.
    """
    n = squares.shape[0] - 1
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
        covered = _at(squares, ia, ib, 0, u, v)
        now = covered >= _HALF
        if covered > _LEAST or inside:
            lower, upper = _at(squares, ia, ib, 4, u, v) - y, _at(squares, ia, ib, 8, u, v) - y
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
        number += _hop(squares, ga + hops * 0.5 * steps[0], gb + hops * 0.5 * steps[1], s, hops)
    if high >= low:
        parts = _add_part(found, parts, low, high)
    return parts, min(max(2.0 * most - 0.5, 0.0), 1.0)


@inlined
def _bound(x: Any, y: Any, z: Any, frame: Any, highest: Any) -> Any:
    """Return where a place lies along both sides of a plan from its middle, and a bound on what is blocked there."""
    a, b = (x - frame[0]) * frame[2] + (z - frame[1]) * frame[3], (z - frame[1]) * frame[2] - (x - frame[0]) * frame[3]
    beside = max(abs(a) - frame[4], 0.0) ** 2 + max(abs(b) - frame[5], 0.0) ** 2
    return a, b, most_blocked(a * a + b * b, beside, frame[4] * frame[4] + frame[5] * frame[5], highest - y)


@fast
def may_block(point: Any, origin: Any, frame: Any, highest: Any, found: Any) -> None:
    """Set `found` (n,) to whether a body is not passed over at places (n, 3); highest: its greatest height."""
    for k in range(len(point)):
        x, y, z = point[k, 0] - origin[0], point[k, 1] - origin[1], point[k, 2] - origin[2]
        found[k] = _bound(x, y, z, frame, highest)[2] >= _UNSEEN


@fast
def sweep(point: Any, origin: Any, frame: Any, outline: Any, squares: Any, begins: Any, blocked: Any) -> None:
    """Find what a body blocks at places (n, 3), from `origin` (3,) as heights are.

    frame, outline, squares: of `HeightField`. begins: (n, 3), the first azimuth [rad], the width of one, from +x to +z,
    and how many there are. blocked: (n, AZIMUTHS, 5), lowest and highest elevation [rad] of an interval, those of a
    second one, equal for none, and the fraction of the azimuth's width.
    """
    n = squares.shape[0] - 1
    ux, uz, hu, hv = frame[2], frame[3], frame[4], frame[5]
    turn = np.arctan2(uz, ux)
    cu, cv = 2.0 * hu / n, 2.0 * hv / n
    highest, lowest = squares[..., 8].max(), squares[..., 4].min()
    wide_squared = hu * hu + hv * hv
    tiny = _ON_EDGE * wide_squared
    radius_squared = wide_squared + (highest - lowest) ** 2 / 4.0
    found = np.zeros((2, 2))
    for k in range(len(point)):
        y = point[k, 1] - origin[1]
        a, b, bound = _bound(point[k, 0] - origin[0], y, point[k, 2] - origin[2], frame, highest)
        begins[k, 2] = 0.0
        if bound < _UNSEEN:
            continue
        apart = (a * a + b * b) / radius_squared
        fewer = 4 if apart > _QUARTERED * _QUARTERED else 2 if apart > _HALVED * _HALVED else 1
        first, width, far, near, outside = _width_at(outline, a, b, tiny)
        count, coarse = (_FROM_OUTSIDE if outside else AZIMUTHS) // fewer, min(fewer, 2)
        step = width / count
        begins[k, 0], begins[k, 1], begins[k, 2] = first + turn, step, count
        da, db = np.cos(first + 0.5 * step), np.sin(first + 0.5 * step)
        turn_a, turn_b = np.cos(step), np.sin(step)
        for q in range(count):
            if q > 0:
                da, db = da * turn_a - db * turn_b, da * turn_b + db * turn_a
            far, near = _edges_met(outline, far, near, a, b, da, db)
            begin = _distance(outline, near, a, b, da, db) if outside else 0.0
            end = max(_distance(outline, far, a, b, da, db), begin)
            stride = coarse / max(abs(da) / cu, abs(db) / cv)
            at = (a + begin * da + hu) / cu + 0.5, (b + begin * db + hv) / cv + 0.5
            steps = stride * da / cu, stride * db / cv
            bounds = lowest - y, highest - y
            parts, share = _slopes(squares, y, bounds, (begin, end), stride, STEP / coarse, at, steps, found)
            blocked[k, q] = 0.0
            if share > 0.0:
                blocked[k, q, 4] = share
                for p in range(parts):
                    blocked[k, q, 2 * p], blocked[k, q, 2 * p + 1] = np.arctan(found[p, 0]), np.arctan(found[p, 1])
