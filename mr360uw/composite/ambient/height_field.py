# SPDX-License-Identifier: Apache-2.0
"""Lower and upper heights of a placed body over its plan: what the ground sees of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.mesh_transfer import Transfer
from mr360uw.types import Floats

CELLS = 32
"""Cells along each side of the plan. At the foot of a ball the blocked share is then within .01."""
_FINE = 4
_LEAST_WIDTH = 0.01
"""Least half width of the plan as a part of its half length: thin cards that stand upright keep one."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightField:
    """A body over its plan. Heights [m] and places are from the origin of the body, in the axes of the world.

    frame: (6,) x and z of the middle, x and z of the unit vector along the first side, both half sides [m]. cells:
    (CELLS + 2, CELLS + 2, 3), first index along the first side, with a border around: the fraction that the body
    covers, lower and upper height of its surface, those of the nearest covered cell where there is none.
    """

    frame: Floats
    cells: Floats


def make_height_field(transfer: Transfer, linear: Floats) -> HeightField:
    """Return the field of a mesh turned and scaled by `linear` (3, 3)."""
    points = transfer.scene.triangles @ linear.T
    frame = _frame(points.reshape(-1, 3)[:, [0, 2]])
    low, high = points[..., 1].min(), points[..., 1].max()
    fine = CELLS * _FINE
    along = (np.arange(fine) + 0.5) / fine * 2.0 - 1.0
    a, b = (g.ravel() for g in np.meshgrid(along * frame[4], along * frame[5], indexing="ij"))
    x, z = frame[0] + a * frame[2] - b * frame[3], frame[1] + a * frame[3] + b * frame[2]
    margin = 0.1 * (high - low) + 1e-3 * frame[4]
    down = _first_height(transfer, linear, x, z, high + margin, -1.0)
    up = _first_height(transfer, linear, x, z, low - margin, 1.0)
    shape = (CELLS, _FINE, CELLS, _FINE)
    hit = np.isfinite(down) & np.isfinite(up)
    count = hit.reshape(shape).sum(axis=(1, 3))
    lower, upper = (np.where(hit, h, 0.0).reshape(shape).sum(axis=(1, 3)) / np.maximum(count, 1) for h in (up, down))
    # cells on the outline have the heights of the outline itself, where a round body is as thin as it ends
    outline = (count > 0) & (count < _FINE**2)
    lower = np.where(outline, np.where(hit, up, -np.inf).reshape(shape).max(axis=(1, 3)), lower)
    upper = np.where(outline, np.where(hit, down, np.inf).reshape(shape).min(axis=(1, 3)), upper)
    cover = count / _FINE**2
    cover, lower, upper = _with_thin_parts(points, frame, cover, lower, upper)
    cover, lower, upper = (np.pad(a, 1) for a in (cover, lower, upper))
    return HeightField(frame, np.stack([cover, *_spread_out(cover > 0.0, lower, upper)], axis=-1))


def _frame(plan: Floats) -> Floats:
    """Return the narrow rectangle around points (n, 2) of a plan."""
    spread = plan - plan.mean(axis=0)
    axis = np.linalg.eigh(spread.T @ spread)[1][:, 1]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    across = np.array([-axis[1], axis[0]])
    a, b = plan @ axis, plan @ across
    middle = 0.5 * (a.min() + a.max()) * axis + 0.5 * (b.min() + b.max()) * across
    half = 0.5 * np.array([np.ptp(a), np.ptp(b)])
    half = np.maximum(half, _LEAST_WIDTH * half.max())
    return np.concatenate([middle, axis, half * (1.0 + 1.0 / CELLS)])


def _first_height(transfer: Transfer, linear: Floats, x: Floats, z: Floats, start: float, way: float) -> Floats:
    """Return the height (n,) at which vertical rays first meet the body, infinite where they do not."""
    back = np.linalg.inv(linear)
    origin = np.stack([x, np.full_like(x, start), z], axis=-1) @ back.T
    direction = np.broadcast_to(back[:, 1] * way, origin.shape)
    triangle = transfer.scene.first_hit(origin, direction)
    height = np.full(len(x), np.inf)
    hit = np.flatnonzero(triangle >= 0)
    corners = transfer.scene.triangles[triangle[hit]] - origin[hit, None]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rate = np.sum(normal * direction[hit], axis=-1)
    distance = np.sum(normal * corners[:, 0], axis=-1) / np.where(np.abs(rate) < 1e-300, 1e-300, rate)
    height[hit] = start + way * distance
    return height


def _with_thin_parts(
    points: Floats, frame: Floats, cover: Floats, lower: Floats, upper: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the field with what vertical rays miss: upright sheets and parts narrower than a cell."""
    steps = np.linspace(0.0, 1.0, 2 * CELLS)
    near = cover.copy()
    for axis in (0, 1):
        near = np.maximum(near, np.maximum(np.roll(near, 1, axis), np.roll(near, -1, axis)))
    edges = np.concatenate([points[:, [0, 1]], points[:, [1, 2]], points[:, [2, 0]]])
    local = edges[..., [0, 2]] - frame[:2]
    place = np.stack([local @ frame[2:4], local @ [-frame[3], frame[2]]], axis=-1) / frame[4:]
    ends = np.clip(((place + 1.0) * 0.5 * CELLS).astype(np.int64), 0, CELLS - 1)
    missed = (near[ends[:, 0, 0], ends[:, 0, 1]] == 0.0) | (near[ends[:, 1, 0], ends[:, 1, 1]] == 0.0)
    if not np.any(missed):
        return cover, lower, upper
    at = place[missed, :1] + steps[:, None] * (place[missed, 1:] - place[missed, :1])
    height = edges[missed, :1, 1] + steps * (edges[missed, 1:, 1] - edges[missed, :1, 1])
    cell = np.clip(((at + 1.0) * 0.5 * CELLS).astype(np.int64), 0, CELLS - 1).reshape(-1, 2)
    thin = near[cell[:, 0], cell[:, 1]] == 0.0
    cell, height = cell[thin], height.ravel()[thin]
    low, high = np.full(cover.shape, np.inf), np.full(cover.shape, -np.inf)
    np.minimum.at(low, (cell[:, 0], cell[:, 1]), height)
    np.maximum.at(high, (cell[:, 0], cell[:, 1]), height)
    new = np.isfinite(low)
    return np.where(new, 1.0, cover), np.where(new, low, lower), np.where(new, high, upper)


def _spread_out(there: NDArray[np.bool_], lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    from scipy.ndimage import distance_transform_edt

    if not np.any(there):
        return np.zeros_like(lower), np.zeros_like(upper)
    nearest: Any = distance_transform_edt(~there, return_distances=False, return_indices=True)
    return lower[tuple(nearest)], upper[tuple(nearest)]
