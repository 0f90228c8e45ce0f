# SPDX-License-Identifier: Apache-2.0
"""Ambient light that bodies block on the ground, as weights on the sky: new light then costs one product.

    E_blocked = sum_a da sum_c n_c (P(a, hi) - P(a, lo))_c = sum_(c, node) n_c w_node P_(node, c)

    P(a, e) = int_{-pi/2}^e L(a, e') d(a, e') cos e' de'

with P the light of the environment integrated over elevation, at the nodes of a table, d the unit direction at azimuth
a and elevation e, L the radiance, lo and hi the intervals of elevation that a horizon scan finds, cut at the place's
own horizon, n its normal, and w interpolation between nodes. Where bodies stand behind each other, a later one adds
what the earlier ones leave of its interval.

The scan sees the lower and upper heights of a body over its plan, from a place, for every azimuth. Rays in the plan
enter and leave at the edges of its convex outline; along them the heights are followed, cell by cell. Bodies that block
little are a rectangle of the sky instead, as wide and high as they look.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Parts, room
from mr360uw.base.constants import BRIGHTEST, DARK
from mr360uw.base.rays import raise_to_triangles
from mr360uw.base.texels import smoothstep
from mr360uw.composite.ambient.mesh_transfer import Transfer
from mr360uw.ibl.lookup import lookup_matrix
from mr360uw.jit import exact, fast, inlined
from mr360uw.types import Environment, Floats

CELLS = 32
"""Cells along each side of the plan. At the foot of a ball the blocked share is then within .01."""
_FINE = 4
"""Rays along each side of a cell."""
_SUPPORTS = 64
"""Directions in which the outermost point of a plan is a corner of its outline: a circle's is then within a
thousandth of its radius."""
_LEAST_WIDTH = 0.01
"""Least half width of the plan as a part of its half length: thin cards that stand upright keep one."""
_STANDS_OUT, _OF_A_CELL = 1e-3, 0.25
"""Parts of a body's height, and of the side of a cell, by which edges stand out of what vertical rays found before they
count. A foot that is hollowed by less stays as round as its cells; were its rim spread over them, its shade would lie
beside it."""
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


@dataclass(frozen=True, slots=True, eq=False)
class HeightField:
    """A body over its plan. Heights [m] and places are from the origin of the body, in the axes of the world.

    frame: (6,) x and z of the middle, x and z of the unit vector along the first side, both half sides [m]. outline:
    (E, 2) corners [m] of the convex hull of the plan along the two sides from the middle, from +x to +z about it.
    cells: (CELLS + 2, CELLS + 2, 3), first index along the first side, with a border around: the fraction of the cell
    within the outline that the body covers, and the lower and the upper height of its surface; off the body those of
    the nearest cell. heights: (2,) least and greatest. filled: (2,) part of the rectangle around the body that it
    fills, seen along each side. opacity: fraction of light that it blocks where it is met, a mean.
    """

    frame: Floats
    outline: Floats
    cells: Floats
    heights: Floats
    filled: Floats
    opacity: float


def make_height_field(transfer: Transfer, linear: Floats) -> HeightField:
    """Return the field of a mesh turned and scaled by `linear` (3, 3)."""
    points, corners = transfer.geometry.positions @ linear.T, transfer.corners @ linear.T
    # Find the smallest rectangle around the plan, and the heights over it in several places of each cell
    frame, outline = _frame(_hull(corners[:, [0, 2]]))
    low, high = corners[:, 1].min(), corners[:, 1].max()
    fine = CELLS * _FINE
    along = (np.arange(fine) + 0.5) / fine * 2.0 - 1.0
    a, b = (g.ravel() for g in np.meshgrid(along * frame[4], along * frame[5], indexing="ij"))
    down, up = _heights(points, frame, fine, 1.0), -_heights(points, frame, fine, -1.0)
    # Average them over each cell
    shape = (CELLS, _FINE, CELLS, _FINE)
    hit = np.isfinite(down) & np.isfinite(up)
    count = hit.reshape(shape).sum(axis=(1, 3))
    lower, upper = (np.where(hit, h, 0.0).reshape(shape).sum(axis=(1, 3)) / np.maximum(count, 1) for h in (up, down))
    # Cells on the outline have the heights of the outline itself, where a round body is as thin as it ends
    rim = (count > 0) & (count < _FINE**2)
    lower = np.where(rim, np.where(hit, up, -np.inf).reshape(shape).max(axis=(1, 3)), lower)
    upper = np.where(rim, np.where(hit, down, np.inf).reshape(shape).min(axis=(1, 3)), upper)
    # Find the covered fraction of each cell within the outline
    within = (hit | _within(outline, a, b)).reshape(shape).sum(axis=(1, 3))
    cover, lower, upper = (np.pad(a, 1) for a in (count / np.maximum(within, 1), lower, upper))
    cover = np.where(np.pad(within, 1) == 0, np.nan, cover)
    # Add the parts that lie between these places
    least = max(_STANDS_OUT * (high - low), _OF_A_CELL * 2.0 * min(frame[4:]) / CELLS)
    cells = _with_thin_parts(_in_cells(corners, frame), transfer.edges, cover, lower, upper, least)
    heights = np.array([cells[..., 1].min(), cells[..., 2].max()])
    return HeightField(frame, outline, cells, heights, _filled(cells, heights), transfer.opacity)


def _hull(plan: Floats) -> Floats:
    """Return corners (E, 2) of the convex hull of points (n, 2): the outermost in `_SUPPORTS` directions, in turn."""
    angle = (np.arange(_SUPPORTS) + 0.5) / _SUPPORTS * 2.0 * np.pi
    most = np.argmax(np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ plan.T, axis=1)
    corners = plan[most]
    size = np.ptp(corners, axis=0).max()
    for _ in range(2):  # without corners that coincide, then without those amid an edge
        before, after = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
        if np.max(np.abs(after)) == 0.0:
            return corners[:1]
        apart = np.abs(after).max(axis=-1) > 1e-6 * size
        if not np.all(apart):
            corners = corners[apart]
            continue
        bent = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) > 1e-9 * size**2
        corners = corners[bent] if bent.sum() >= 3 else corners
    return corners


def _frame(hull: Floats) -> tuple[Floats, Floats]:
    """Return the smallest rectangle around a convex hull (E, 2), and the hull in it: never narrower than allowed."""
    sides = np.roll(hull, -1, axis=0) - hull
    length = np.linalg.norm(sides, axis=-1)
    axes = sides[length > 0.0] / length[length > 0.0, None] if np.any(length > 0.0) else np.array([[1.0, 0.0]])
    across = np.stack([-axes[:, 1], axes[:, 0]], axis=-1)
    area = np.ptp(hull @ axes.T, axis=0) * np.ptp(hull @ across.T, axis=0)
    axis = axes[np.argmin(area)]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    across = np.array([-axis[1], axis[0]])
    local = np.stack([hull @ axis, hull @ across], axis=-1)
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    local = local - middle
    found = local.max(axis=0)
    half = np.maximum(found, max(_LEAST_WIDTH * found.max(), 1e-9))
    if np.any(half > found):
        local = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    center = middle[0] * axis + middle[1] * across
    return np.concatenate([center, axis, half * (1.0 + 1.0 / CELLS)]), np.ascontiguousarray(local)


def _within(outline: Floats, a: Floats, b: Floats) -> NDArray[np.bool_]:
    """Return which places (n,) lie in an outline."""
    inside = np.ones(a.shape, np.bool_)
    for corner, after in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        inside &= (after[0] - corner[0]) * (b - corner[1]) >= (after[1] - corner[1]) * (a - corner[0])
    return inside


def _heights(points: Floats, frame: Floats, count: int, up: float) -> Floats:
    """Return the greatest heights (count^2,) of triangles (T, 3, 3) over a plan, minus infinity where there are none.

    up: 1, or -1 for heights measured downwards.
    """
    axes = np.array([[frame[2], 0.0, frame[3]], [-frame[3], 0.0, frame[2]], [0.0, up, 0.0]])
    step, top = 2.0 * frame[4:] / count, np.full((count, count), -np.inf)
    raise_to_triangles(points, np.array([frame[0], 0.0, frame[1]]), axes, 0.5 * step - frame[4:], step, top)
    return top.ravel()


def _in_cells(corners: Floats, frame: Floats) -> Floats:
    """Return places in cells, with the border's, and heights of corners, (n, 3)."""
    local = corners[:, [0, 2]] - frame[:2]
    place = np.stack([local @ frame[2:4], local @ [-frame[3], frame[2]]], axis=-1) / frame[4:]
    return np.append(np.clip((place + 1.0) * 0.5 * CELLS + 0.5, 0.5, CELLS + 0.499), corners[:, 1:2], axis=1)


def _with_thin_parts(
    corners: Floats, edges: NDArray[np.int64], cover: Floats, lower: Floats, upper: Floats, least_m: float
) -> Floats:
    """Return cells with what vertical rays miss, upright sheets and parts narrower than their distance: edges that
    stand out of the heights around by `least_m`. cover: as in `HeightField`, not a number beyond the outline.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    # Find the edges that stand out of the heights of the nine cells around
    known = np.nan_to_num(cover) > 0.0
    top = maximum_filter(np.where(known, upper, -np.inf), 3, mode="constant", cval=-np.inf)
    bottom = minimum_filter(np.where(known, lower, np.inf), 3, mode="constant", cval=np.inf)
    low, high = np.full(cover.shape, np.inf), np.full(cover.shape, -np.inf)
    _raise_to_edges(corners, edges, top + least_m, bottom - least_m, cover, low, high)
    lower, upper = _spread_out(known, lower, upper)
    # Widen the heights to them; where nothing else is, they are all there is
    thin = np.isfinite(low)
    if np.any(thin):
        alone = ~np.isfinite(bottom)
        lower = np.where(alone, low, np.minimum(lower, low))
        upper = np.where(alone, high, np.maximum(upper, high))
        lower, upper = _spread_out(known | thin, lower, upper)
    (cover,) = _spread_out(np.isfinite(cover), cover)
    return np.stack([cover, lower, upper], axis=-1)


@exact
def _raise_to_edges(corners: Any, edges: Any, top: Any, bottom: Any, cover: Any, low: Any, high: Any) -> None:
    """Set the cover of cells in which edges are above `top` or below `bottom` to 1, and widen the heights to them of
    all cells between which heights there are interpolated. Edges are followed in steps of half a cell.
    """
    for e in range(len(edges)):
        a, b = corners[edges[e, 0]], corners[edges[e, 1]]
        steps = max(math.ceil(2.0 * max(abs(b[0] - a[0]), abs(b[1] - a[1]))), 1)
        for k in range(steps + 1):
            t = k / steps
            x, y, height = a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])
            i, j = int(x + 0.5), int(y + 0.5)
            if bottom[i, j] <= height <= top[i, j]:
                continue
            cover[i, j] = 1.0
            for corner in range(4):
                m, n = int(x) + corner // 2, int(y) + corner % 2
                low[m, n], high[m, n] = min(low[m, n], height), max(high[m, n], height)


def _filled(cells: Floats, heights: Floats) -> Floats:
    """Return the part (2,) of the rectangle around a body that its silhouette fills, seen along each side."""
    there = cells[1:-1, 1:-1, 0] >= 0.5
    high = [np.where(there, cells[1:-1, 1:-1, 2], -np.inf).max(axis=axis) for axis in (0, 1)]
    low = [np.where(there, cells[1:-1, 1:-1, 1], np.inf).min(axis=axis) for axis in (0, 1)]
    tall = [np.maximum(upper - lower, 0.0).mean() for upper, lower in zip(high, low, strict=True)]
    return np.minimum(np.array(tall) / max(heights[1] - heights[0], 1e-9), 1.0)


def _spread_out(there: NDArray[np.bool_], *values: Floats) -> tuple[Floats, ...]:
    """Return arrays in which every cell has the value of the nearest one that is there; zeros where none is."""
    from scipy.ndimage import distance_transform_edt

    if not np.any(there):
        return tuple(np.zeros_like(a) for a in values)
    nearest: Any = distance_transform_edt(~there, return_distances=False, return_indices=True)
    return tuple(a[tuple(nearest)] for a in values)


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


@fast
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


@fast
def place_beside(x: Any, y: Any, z: Any, frame: Any, highest: Any) -> Any:
    """Return where a place lies along both sides of a plan from its middle, whether its body is seen from there, and
    whether it must be scanned.
    """
    a, b = (x - frame[0]) * frame[2] + (z - frame[1]) * frame[3], (z - frame[1]) * frame[2] - (x - frame[0]) * frame[3]
    beside = max(abs(a) - frame[4], 0.0) ** 2 + max(abs(b) - frame[5], 0.0) ** 2
    away, wide = a * a + b * b, frame[4] * frame[4] + frame[5] * frame[5]
    bound = most_blocked(away, beside, wide, highest - y)
    return a, b, bound >= UNSEEN, bound >= SCANNED or away < _APART * _APART * wide


@fast
def as_rectangle(a: Any, b: Any, y: Any, field: Any, begin: Any, blocked: Any) -> None:
    """Set one interval for a body at a distance: its width across the view, and its height, of which a part is filled.

    The arguments are those of `scan`.
    """
    frame, outline, _, heights, filled = field
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


@fast
def scan(a: Any, b: Any, y: Any, field: Any, begin: Any, blocked: Any, found: Any) -> None:
    """Set the intervals of elevation that a body covers, seen from a place.

    a, b, y: the place along both sides of the plan from its middle, and its height over the body's origin [m]. field:
    frame, outline, cells, heights and filled of `HeightField`. found: (2, 2) scratch.
    begin: (3,), set to the first azimuth [rad], the width of one, from +x to +z, and how many there are. blocked:
    (AZIMUTHS, 5), set to lowest and highest elevation [rad] of an interval, those of a second one, equal for none, and
    the fraction of the azimuth's width.
    """
    # Find the azimuths that the outline spans: a part from outside, all from above it
    frame, outline, cells, heights, _ = field
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
    # Walk the cells along each azimuth, between the edges that it crosses
    for q in range(count):
        if q > 0:
            da, db = da * turn_a - db * turn_b, da * turn_b + db * turn_a
        far, near = _edges_met(outline, far, near, a, b, da, db)
        start = _distance(outline, near, a, b, da, db) if outside else 0.0
        end = max(_distance(outline, far, a, b, da, db), start)
        stride = 1.0 / max(abs(da) / cu, abs(db) / cv)
        at = (a + start * da + hu) / cu + 0.5, (b + start * db + hv) / cv + 0.5
        steps = stride * da / cu, stride * db / cv
        # Take the intervals of slope that the cells cover as elevations
        parts, share = _slopes(cells, y, bounds, (start, end), stride, at, steps, found)
        blocked[q] = 0.0
        if share > 0.0:
            blocked[q, 4] = share
            for p in range(parts):
                blocked[q, 2 * p], blocked[q, 2 * p + 1] = np.arctan(found[p, 0]), np.arctan(found[p, 1])


UNNOTICED, NOTICED = 0.012, 0.036
"""A body that blocks less than the first fraction of the ambient light leaves it: a code value of 8 bits over metres;
from the second on it shows whole."""
_PIECES = 8
_MOST_CORNERS = 64
ROWS, COLUMNS = 32, 24
"""Azimuths and steps of elevation of the table."""
NODES = ROWS * (COLUMNS + 1)
_FINER = 2
"""Cells along each side of one of the table over which light is summed: pixels of the map."""
_GLOW, _GLOW_POWER, _GLOW_SIDE = 2.0, 8, np.sqrt(0.5)
"""Glow of `glow_table` over the rest of its sky, power of the cosine to its middle (half as bright at 23 degrees), and
its middle at half height: about the glow around a sun in clear air."""


def shown(blocked: Floats) -> Floats:
    """Return the part (...,) of a change on the ground that is shown where bodies block a fraction `blocked`.

    It fades to nothing at `UNNOTICED`, so that a body changes a bounded part of the receiver.
    """
    return smoothstep(blocked, UNNOTICED, NOTICED)


def fraction_left(blocked: Floats, lost: Floats, whole: Floats) -> Floats:
    """Return the fraction (n, 3) of the ambient irradiance `whole` that is left on the ground without `lost`.

    blocked: (n,) fraction of uniform light that bodies block. `lost` and `whole` are sums over different pixels, so
    that under bodies that block all of a spotted sky more may be lost than there was: nothing is left then. Bodies that
    shine add `BRIGHTEST` times the plate's light at most.
    """
    left = 1.0 - shown(blocked)[:, None] * lost / np.maximum(whole, DARK)
    return np.asarray(np.clip(left, 0.0, BRIGHTEST))


@dataclass(frozen=True, slots=True, eq=False)
class Occlusion:
    """What bodies block at n places. normal: (n, 3). weights: (n, NODES) float32 on the nodes of a sky table, all
    bodies together. share: (bodies, n) float32, fraction of uniform light that each blocks.
    """

    normal: Floats
    weights: NDArray[np.float32]
    share: NDArray[np.float32]

    def irradiance(self, table: Floats) -> Floats:
        """Return the irradiance (n, k) that is blocked of a sky with a table P (NODES, 3, k)."""
        if len(self.normal) and np.all(self.normal == self.normal[0]):
            return np.asarray(self.weights @ np.einsum("nck,c->nk", table, self.normal[0]).astype(np.float32), float)
        found = self.weights @ table.reshape(NODES, -1).astype(np.float32)
        return np.einsum("nck,nc->nk", found.reshape(len(found), *table.shape[1:]), self.normal)


def joined(parts: Sequence[Occlusion]) -> Occlusion:
    """Return what is blocked at the places of several parts, one after the other."""
    normal, weights = (np.concatenate([getattr(part, name) for part in parts]) for name in ("normal", "weights"))
    return Occlusion(normal, weights, np.concatenate([part.share for part in parts], axis=1))


@dataclass(frozen=True, eq=False)
class Occluders(Parts):
    """Bodies that the ground sees. fields: m height fields. origin: (m, 3) places of their bodies' origins [m]."""

    fields: tuple[HeightField, ...]
    origin: Floats

    def blocked(self, points: Floats, normal: Floats) -> Occlusion:
        """Return what the bodies block at places (n, 3) with normals (n, 3)."""
        points, normal = (np.ascontiguousarray(a, np.float64) for a in (points, normal))
        weights = np.zeros((len(points), NODES), np.float32)
        share = np.zeros((len(self.fields), len(points)), np.float32)
        if self.fields:
            # Room for what bodies block at a place, the bodies chosen, and pieces of their outlines
            n = len(self.origin) + 1
            of_place = room((n, 3), (n, AZIMUTHS, 5), dtype=np.float64)
            chosen, pieces = np.zeros((2, n - 1), np.int64), room((_PIECES, 2), (2, 2), dtype=np.float64)
            work = of_place, chosen, *pieces
            _block(points, normal, self.origin, self._packed, work, weights, share)
        return Occlusion(normal, weights, share)

    def plans(self) -> Floats:
        """Return what `ground_light.survey` takes of the bodies, (m, 8)."""
        plans = np.zeros((len(self.fields), 8))
        for plan, field, origin in zip(plans, self.fields, self.origin, strict=True):
            plan[:6] = field.frame
            plan[:2] += origin[[0, 2]]
            plan[6:] = np.maximum(field.heights + origin[1], 0.0)
        return plans

    @cached_property
    def _packed(self) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
        """Arrays of the fields for `_block`; each field once, with the number (m,) of that of each body."""
        number = {id(field): k for k, field in enumerate({id(field): field for field in self.fields}.values())}
        fields = list({id(field): field for field in self.fields}.values())
        outlines, corners = np.zeros((len(fields), _MOST_CORNERS, 2)), np.zeros(len(fields), np.int64)
        for k, field in enumerate(fields):
            corners[k] = len(field.outline)
            outlines[k, : corners[k]] = field.outline
        of = np.array([number[id(field)] for field in self.fields])
        frame, heights, filled, cells = (
            np.array([getattr(field, name) for field in fields]) for name in ("frame", "heights", "filled", "cells")
        )
        return of, frame, heights, filled, np.array([field.opacity for field in fields]), outlines, corners, cells


@inlined
def _at_azimuth(begin: Any, azimuth: Any) -> Any:
    """Return the number of a body's azimuth within which another lies, -1 for none."""
    turn = azimuth - begin[0]
    turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi))
    place = turn / begin[1] if begin[1] > 0.0 else 1e9
    return int(place) if place < begin[2] else -1


@inlined
def _cut(piece: Any, low: Any, high: Any, begins: Any, blocked: Any, before: Any, azimuth: Any) -> Any:
    """Set the pieces of an interval that the bodies `before` leave at an azimuth; return how many there are."""
    piece[0, 0], piece[0, 1] = low, high
    pieces = 1
    for j in range(before):
        q = _at_azimuth(begins[j], azimuth)
        for i in range(2 if q >= 0 else 0):
            taken, until, share = blocked[j, q, 2 * i], blocked[j, q, 2 * i + 1], blocked[j, q, 4]
            middle = 0.5 * (taken + until)
            taken, until = middle + share * (taken - middle), middle + share * (until - middle)
            if until <= taken:
                continue
            for p in range(pieces):
                a, b = piece[p, 0], piece[p, 1]
                if taken < b and until > a:
                    if taken > a:
                        piece[p, 1] = taken
                        if until < b and pieces < _PIECES:
                            piece[pieces, 0], piece[pieces, 1] = until, b
                            pieces += 1
                    else:
                        piece[p, 0] = min(until, b)
    return pieces


@inlined
def _above_horizon(normal: Any, level: Any, low: Any, high: Any) -> Any:
    """Return the part of an interval of elevations above the horizon of a place with a normal (3,); level: what that
    has along the azimuth.
    """
    if normal[1] > 1e-9:
        low = max(low, np.arctan(-level / normal[1]))
    elif normal[1] < -1e-9:
        high = min(high, np.arctan(-level / normal[1]))
    elif level <= 0.0:
        high = low
    return low, high


@inlined
def _add_node(weights: Any, azimuth: Any, elevation: Any, factor: Any) -> None:
    """Add a factor to the weights (NODES,) of the four nodes about an azimuth and an elevation, linear in the azimuth
    and in the squared sine of the elevation, as even light on level ground is.
    """
    across = azimuth / (2.0 * np.pi) * ROWS - 0.5
    i = int(np.floor(across))
    u = across - i
    i = i % ROWS
    j = i + 1 if i + 1 < ROWS else 0
    along = min(max((elevation / np.pi + 0.5) * COLUMNS, 0.0), COLUMNS - 1e-6)
    e = int(along)
    low, high = np.sin((e / COLUMNS - 0.5) * np.pi) ** 2, np.sin(((e + 1) / COLUMNS - 0.5) * np.pi) ** 2
    v = (np.sin(elevation) ** 2 - low) / (high - low)
    i, j = i * (COLUMNS + 1) + e, j * (COLUMNS + 1) + e
    weights[i] += factor * (1.0 - u) * (1.0 - v)
    weights[i + 1] += factor * (1.0 - u) * v
    weights[j] += factor * u * (1.0 - v)
    weights[j + 1] += factor * u * v


@fast
def _add(normal: Any, begins: Any, blocked: Any, m: Any, before: Any, piece: Any, weights: Any) -> Any:
    """Add what the m-th body blocks behind those `before` to weights (NODES,); return its share of uniform light."""
    share, first, step = 0.0, begins[m, 0], begins[m, 1]
    for number in range(2 * int(begins[m, 2])):
        q, part = number // 2, 2 * (number & 1)
        low, high, filled = blocked[m, q, part], blocked[m, q, part + 1], blocked[m, q, 4]
        if filled <= 0.0 or high <= low:
            continue
        azimuth = first + (q + 0.5) * step
        level = normal[0] * np.cos(azimuth) + normal[2] * np.sin(azimuth)
        low, high = _above_horizon(normal, level, low, high)
        for p in range(_cut(piece, low, high, begins, blocked, before, azimuth)):
            a, b = piece[p, 0], piece[p, 1]
            if b > a:
                _add_node(weights, azimuth, b, filled * step)
                _add_node(weights, azimuth, a, -filled * step)
                sine, other = np.sin(b), np.sin(a)
                upward = sine * sine - other * other
                beside = b - a + sine * np.cos(b) - other * np.cos(a)
                share += filled * step * (normal[1] * upward + level * beside) / (2.0 * np.pi)
    return share


@fast
def _block(point: Any, normal: Any, origin: Any, fields: Any, work: Any, weights: Any, share: Any) -> None:
    """Add the weights (n, NODES) and set the shares (m, n) of bodies at places (n, 3). fields: of `Occluders`.

    work: room, as `Occluders.blocked` makes it.
    """
    of, frame, heights, filled, opacity, outline, corners, cells = fields
    (begins, blocked), (near, far), piece, found = work
    for k in range(len(point)):
        scanned, others = 0, 0
        for m in range(len(origin)):
            f = of[m]
            x, y, z = point[k, 0] - origin[m, 0], point[k, 1] - origin[m, 1], point[k, 2] - origin[m, 2]
            a, b, seen, close = place_beside(x, y, z, frame[f], heights[f, 1])
            if seen and close:
                field = frame[f], outline[f, : corners[f]], cells[f], heights[f], filled[f]
                scan(a, b, y, field, begins[scanned], blocked[scanned], found)
                near[scanned] = m
                scanned += 1
            elif seen:
                far[others] = m
                others += 1
        for n in range(scanned + others):
            m, slot = near[n] if n < scanned else far[n - scanned], min(n, scanned)
            f = of[m]
            if n >= scanned:
                x, y, z = point[k, 0] - origin[m, 0], point[k, 1] - origin[m, 1], point[k, 2] - origin[m, 2]
                a, b, _, _ = place_beside(x, y, z, frame[f], heights[f, 1])
                field = frame[f], outline[f, : corners[f]], cells[f], heights[f], filled[f]
                as_rectangle(a, b, y, field, begins[slot], blocked[slot])
            for q in range(AZIMUTHS if opacity[f] < 1.0 else 0):  # one by one, see `jit`
                blocked[slot, q, 4] *= opacity[f]
            share[m, k] = _add(normal[k], begins, blocked, slot, slot, piece, weights[k])


def sky_table(environment: Environment) -> Floats:
    """Return P (NODES, 3, 3), component and channel, of the environment without its sun."""
    map_ = environment.residual
    light = _lookup(map_.shape) @ map_.reshape(-1, 3)
    return _table_of(np.asarray(light).reshape(_FINER * ROWS, _FINER * COLUMNS, 3))


@functools.cache
def glow_table() -> Floats:
    """Return the upward component of P (NODES, 5) of uniform light and of four skies that glow on one side.

    Each has an irradiance of pi on level ground. What bodies block of them bends where it does in other smooth light.
    """
    d, _ = _directions()
    light = np.ones((*d.shape[:2], 5))
    for k, (x, z) in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))):
        towards = np.maximum(d @ [x * _GLOW_SIDE, _GLOW_SIDE, z * _GLOW_SIDE], 0.0)
        light[..., k + 1] += _GLOW * towards**_GLOW_POWER
    table = _table_of(light)[:, 1].reshape(ROWS, COLUMNS + 1, 5)
    whole = (table[:, -1] - table[:, COLUMNS // 2]).sum(axis=0) * (2.0 * np.pi / ROWS)
    return np.asarray(table * (np.pi / whole)).reshape(NODES, 5)


def _table_of(light: Floats) -> Floats:
    """Return P (NODES, 3, k) of radiances (_FINER ROWS, _FINER COLUMNS, k)."""
    cells = _directions()[1][..., None] * light[:, :, None, :]
    rows = cells.reshape(ROWS, _FINER, *cells.shape[1:]).mean(axis=1)
    table = np.zeros((ROWS, COLUMNS + 1, 3, light.shape[-1]))
    table[:, 1:] = np.cumsum(rows, axis=1)[:, _FINER - 1 :: _FINER]
    return table.reshape(NODES, 3, -1)


@functools.cache
def _lookup(shape: tuple[int, ...]) -> Any:
    """Return the lookup of the cells in maps of a shape (H, W, 3)."""
    return lookup_matrix(shape, _directions()[0].reshape(-1, 3))


@functools.cache
def _directions() -> tuple[Floats, Floats]:
    """Return the middles of the cells, and the same times their solid angle over a row."""
    rows, columns = _FINER * ROWS, _FINER * COLUMNS
    azimuth = (np.arange(rows) + 0.5) * 2.0 * np.pi / rows
    elevation = ((np.arange(columns) + 0.5) / columns - 0.5) * np.pi
    e, a = np.meshgrid(elevation, azimuth)
    d = np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1)
    return d, d * (np.cos(e) * np.pi / columns)[..., None]
