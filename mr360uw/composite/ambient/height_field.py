# SPDX-License-Identifier: Apache-2.0
"""Lower and upper heights of a placed body over its plan: what the ground sees of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.mesh_transfer import Transfer
from mr360uw.jit import exact
from mr360uw.rays import raise_to_triangles
from mr360uw.types import Floats

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
    points, corners = transfer.blocking.scene.triangles @ linear.T, transfer.corners @ linear.T
    frame, outline = _frame(_hull(corners[:, [0, 2]]))
    low, high = corners[:, 1].min(), corners[:, 1].max()
    fine = CELLS * _FINE
    along = (np.arange(fine) + 0.5) / fine * 2.0 - 1.0
    a, b = (g.ravel() for g in np.meshgrid(along * frame[4], along * frame[5], indexing="ij"))
    down, up = _heights(points, frame, fine, 1.0), -_heights(points, frame, fine, -1.0)
    shape = (CELLS, _FINE, CELLS, _FINE)
    hit = np.isfinite(down) & np.isfinite(up)
    count = hit.reshape(shape).sum(axis=(1, 3))
    lower, upper = (np.where(hit, h, 0.0).reshape(shape).sum(axis=(1, 3)) / np.maximum(count, 1) for h in (up, down))
    # cells on the outline have the heights of the outline itself, where a round body is as thin as it ends
    rim = (count > 0) & (count < _FINE**2)
    lower = np.where(rim, np.where(hit, up, -np.inf).reshape(shape).max(axis=(1, 3)), lower)
    upper = np.where(rim, np.where(hit, down, np.inf).reshape(shape).min(axis=(1, 3)), upper)
    within = (hit | _within(outline, a, b)).reshape(shape).sum(axis=(1, 3))
    cover, lower, upper = (np.pad(a, 1) for a in (count / np.maximum(within, 1), lower, upper))
    cover = np.where(np.pad(within, 1) == 0, np.nan, cover)
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
        bent = np.abs(_cross(before, after)) > 1e-9 * size**2
        corners = corners[bent] if bent.sum() >= 3 else corners
    return corners


def _cross(one: Floats, other: Floats) -> Floats:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


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
