# SPDX-License-Identifier: Apache-2.0
"""Ambient occlusion: the fraction of ambient irradiance that bodies block, by form factors of surfels (Bunnell 2005),

    F = sum A |n.w| max(0, N.w) / (pi r^2 + A)

with w the direction towards the surfel, r its distance, A n its area vector, N the normal of the point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np

from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

# Sums may be reordered and divisions raise nothing, so that eight surfels are added at once.
_compiled = numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
_inlined = numba.njit(fastmath=True, error_model="numpy", inline="always")


def surfel_table(objects: Sequence[PlacedObject], camera_position: Floats) -> Floats:
    """Return the surfels of bodies as (7, s): position from the camera, area vector, area."""
    columns = [np.zeros((7, 0))]
    for placed in objects:
        place = placed.to_world(placed.mesh.surfel_position) - camera_position
        vector = placed.mesh.surfel_area @ placed.world_from_object[:3, :3].T * placed.scale
        columns.append(np.concatenate([place, vector, np.linalg.norm(vector, axis=-1, keepdims=True)], axis=1).T)
    return np.concatenate(columns, axis=1)


def ambient_blocked(point: Floats, normal: Floats, surfels: Floats) -> Floats:
    """Return the fraction (...,) of the ambient irradiance on (point, normal), each (..., 3), that surfels block.

    Not clipped: several bodies may add up to more than 1. surfels: of `surfel_table`. In the precision of the points.
    """
    number = point.dtype.type
    points, normals = (np.ascontiguousarray(a, point.dtype).reshape(-1, 3) for a in (point, normal))
    out = np.empty(len(points), point.dtype)
    _sums(points, normals, np.ascontiguousarray(surfels, point.dtype), number(np.pi), number(1e-12), out)
    return out.reshape(point.shape[:-1])


@_inlined  # type: ignore[untyped-decorator, unused-ignore]
def _sum(px: Any, py: Any, pz: Any, nx: Any, ny: Any, nz: Any, surfels: Any, pi: Any, nearest: Any) -> Any:
    """Return twice the sum at one point. pi and nearest are arguments so that they have the arrays' precision."""
    sx, sy, sz, ax, ay, az, area = surfels[0], surfels[1], surfels[2], surfels[3], surfels[4], surfels[5], surfels[6]
    total = px - px
    for k in range(len(area)):
        x, y, z = sx[k] - px, sy[k] - py, sz[k] - pz
        squared = max(x * x + y * y + z * z, nearest)
        rising = x * nx + y * ny + z * nz
        facing = abs(x * ax[k] + y * ay[k] + z * az[k])
        total += facing * (rising + abs(rising)) / (squared * (pi * squared + area[k]))
    return total


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def _sums(point: Any, normal: Any, surfels: Any, pi: Any, nearest: Any, out: Any) -> None:
    for i in range(len(out)):
        p, n = point[i], normal[i]
        out[i] = _sum(p[0], p[1], p[2], n[0], n[1], n[2], surfels, pi, nearest) / 2


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def mark_occluded(
    point: Any, normal: Any, reach_m: Any, center: Any, radius: Any, surfels: Any, least: Any, marks: Any
) -> None:
    """Set the marks (n,) of points that a body may touch, or where it blocks more than the fraction `least`.

    center, radius: of the body's bounding ball. reach_m: (n,) radius of the receiver around each point, which the point
    represents. Marked points are skipped.
    """
    area = 0.0
    for k in range(surfels.shape[1]):
        area += surfels[6, k]
    for i in range(len(marks)):
        if marks[i]:
            continue
        p, n = point[i], normal[i]
        x, y, z = center[0] - p[0], center[1] - p[1], center[2] - p[2]
        near = radius + reach_m[i]
        squared = x * x + y * y + z * z
        if squared < near * near:
            marks[i] = True
            continue
        gap = max(np.sqrt(squared) - near, 0.1 * radius)
        # upper bound: all surfels at the nearest distance
        if area * max(x * n[0] + y * n[1] + z * n[2] + near, 0.0) > least * np.pi * gap * gap * gap:
            marks[i] = _sum(p[0], p[1], p[2], n[0], n[1], n[2], surfels, np.pi, 1e-12) > 2.0 * least


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def mark_shaded(point: Any, reach_m: Any, axes: Any, low: Any, high: Any, spread: Any, marks: Any) -> None:
    """Set the marks (n,) of points that may be in the shadow of a body's bounding box.

    axes: (3, 3), one a row, the last towards the sun. low, high: (3,) of the box along them. spread: tangent of the
    sun's angular radius. reach_m: as in `mark_occluded`.
    """
    for i in range(len(marks)):
        p, reach = point[i], reach_m[i]
        above = high[2] - (p[0] * axes[2, 0] + p[1] * axes[2, 1] + p[2] * axes[2, 2]) + reach
        wide = reach + spread * max(above, 0.0)
        u = p[0] * axes[0, 0] + p[1] * axes[0, 1] + p[2] * axes[0, 2]
        v = p[0] * axes[1, 0] + p[1] * axes[1, 1] + p[2] * axes[1, 2]
        beside = max(low[0] - u, u - high[0], low[1] - v, v - high[1])
        if above > 0.0 and beside <= wide:
            marks[i] = True
