# SPDX-License-Identifier: Apache-2.0
"""Receiver geometry along camera rays, and the parts of the frame in which objects change the receiver.

Changed parts are found on a coarse grid. A cell is marked if a body's shadow, widened by the sun's disc and by the
cell, can fall on it, or if the body blocks about `UNNOTICED` of its ambient light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.blocked_light import UNNOTICED
from mr360uw.composite.lighting.light_sources import lamps_of, light_sources, sun_of, widest_half_angle
from mr360uw.composite.receiver.ratio import added_light
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.composite.tiles import rectangles_of_mask
from mr360uw.jit import fast
from mr360uw.medium.lookup import transmittance_lookup
from mr360uw.rays import RayScene, barycentric
from mr360uw.sphere import basis
from mr360uw.types import Floats, Rectangle, View


def kept_shape(receiver: Receiver, camera_position: Floats, cache: Cache) -> ReceiverShape:
    """Return a receiver's shape as seen from a position (3,) [m] in the world. cache: holds it for other frames."""
    return cache.of(ReceiverShape, receiver, camera_position)


def plate_distance(shot: Shot, x: Floats, y: Floats, direction: Floats, cache: Cache) -> Floats:
    """Return the distance (n,) [m] of the plate's surfaces along rays, infinity where the scene does not tell it.

    x, y: (n,) frame coordinates. direction: (n, 3) of the view there, world axes. cache: holds the receiver's shape.
    """
    view, matte = shot.view, shot.holdout_distance_m
    nearest = np.full(len(direction), np.inf)
    if shot.receiver is not None:
        nearest, _ = kept_shape(shot.receiver, view.position, cache).meet_along(view, x, y, direction)
    if matte is not None:
        found = matte[np.minimum(y.astype(np.int64), view.height - 1), x.astype(np.int64) % view.width]
        nearest = np.minimum(nearest, found)
    return np.asarray(nearest, np.float64)


RECTANGLE_COST_PX = 16384
"""Fixed cost of one rectangle, in pixels that take as long. Twice as large: fewer rectangles, more untouched pixels."""
NEGLIGIBLE = 0.004
"""Change of linear light that is ignored: half a code value of an 8-bit video at white."""
EDGE_ON = 0.003
"""Cosine between ray and normal below which a distance map's surface is taken to stand edge-on."""
_COLUMNS = 128
"""Cells across the frame."""


class ReceiverShape:
    """Intersection of camera rays with a receiver."""

    def __init__(self, receiver: Receiver, camera_position: Floats) -> None:
        self._receiver = receiver
        self._camera = camera_position
        self._scene = RayScene(receiver.mesh - camera_position) if receiver.mesh is not None else None
        self._planes = None
        if receiver.distance_m is not None:
            from mr360uw.composite.receiver.distance_map import touching_planes

            self._planes = touching_planes(receiver.distance_m)

    def meet(self, shot: Shot, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return (distance (...), infinite where there is no receiver; normal (..., 3) towards the camera)."""
        return self.meet_along(shot.view, x, y, shot.view.directions(x, y))

    def meet_along(self, view: View, x: Floats, y: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return what `meet` does; direction: (..., 3) those of the view at frame coordinates x, y (...)."""
        receiver = self._receiver
        start = view.starts(direction)
        if receiver.plane_y is not None:
            height = receiver.plane_y - self._camera[1]
            with np.errstate(divide="ignore", over="ignore"):
                distance = (height - start[..., 1]) / direction[..., 1]
            distance = np.where((distance > 0.0) & np.isfinite(distance), distance, np.inf)
            normal = np.zeros_like(direction)
            normal[..., 1] = -np.sign(height) if height else 1.0
        elif self._scene is not None:
            distance, normal = self._meet_mesh(start, direction)
        else:
            distance, normal = self._meet_map(view, x, y, direction)
        return np.where(distance <= receiver.extent_m, distance, np.inf), normal

    def _meet_mesh(self, start: Floats, direction: Floats) -> tuple[Floats, Floats]:
        assert self._scene is not None
        rays, origin = direction.reshape(-1, 3), start.reshape(-1, 3)
        triangle = self._scene.first_hit(origin, rays)
        hit = triangle >= 0
        distance, normal = np.full(len(rays), np.inf), np.zeros_like(rays)
        corners = self._scene.triangles[triangle[hit]] - origin[hit, None]
        _, distance[hit] = barycentric(corners, rays[hit])
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat /= np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), 1e-30)
        normal[hit] = -flat * np.sign(np.sum(flat * rays[hit], -1, keepdims=True))
        return distance.reshape(direction.shape[:-1]), normal.reshape(direction.shape)

    def _meet_map(self, view: View, x: Floats, y: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return distances and normals of a distance map, from the tangent plane of the nearest texel."""
        assert self._planes is not None
        rows, columns = self._planes.shape[:2]
        i = np.floor(x * columns / view.width).astype(np.int64) % columns
        j = np.clip(np.floor(y * rows / view.height).astype(np.int64), 0, rows - 1)
        plane = np.asarray(self._planes[j, i], np.float64) @ view.world_from_camera.T
        size = np.linalg.norm(plane, axis=-1)
        # a plane nearly along the ray ends within the texel
        inverse = np.maximum(np.sum(plane * direction, -1), EDGE_ON * size)
        seen = size > 0.0
        normal = np.where(seen[..., None], -plane / np.maximum(size, 1e-30)[..., None], -direction)
        return np.where(seen, 1.0 / np.where(seen, inverse, 1.0), np.inf), normal


@dataclass(frozen=True, slots=True, eq=False)
class CoarseGrid:
    """The receiver at the middles of n cells of the frame where it is.

    cell: (columns, rows) of pixels; shape: (rows, columns) of cells; index: (n,) of the cells, flat. point, normal:
    (n, 3). reach_m: (n,) half the extent of a cell on the receiver.
    """

    cell: tuple[int, int]
    shape: tuple[int, int]
    index: NDArray[np.int64]
    point: Floats
    normal: Floats
    reach_m: Floats


def coarse_grid(shot: Shot, shape: ReceiverShape) -> CoarseGrid:
    """Return the receiver on cells of 1/128 of the frame's width and a quarter of that in height, because towards the
    horizon a cell reaches far along the ground.
    """
    width, height = shot.view.width, shot.view.height
    cell = max(width // _COLUMNS, 1), max(width // (4 * _COLUMNS), 1)
    columns, rows = -(-width // cell[0]), -(-height // cell[1])
    x, y = (np.arange(columns) + 0.5) * cell[0], np.minimum((np.arange(rows) + 0.5) * cell[1], height)[:, None]
    direction = shot.view.directions(x, y)
    distance, normal = shape.meet_along(shot.view, x, y, direction)
    seen = np.isfinite(distance)
    distance, normal, direction = distance[seen], normal[seen], direction[seen]
    cosine = np.maximum(np.abs(np.sum(direction * normal, -1)), 0.02)
    along, across = cell[1] * np.pi / (2 * height), cell[0] * np.pi / width
    reach = distance * np.hypot(along / cosine, across)
    index = np.flatnonzero(seen)
    return CoarseGrid(cell, seen.shape, index, shot.view.points(direction, distance), normal, reach)


def touched_cells(shot: Shot, grid: CoarseGrid) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks (n,) of the cells of the receiver whose change may be seen through the water: by anything, by the
    sun's shadow, and by the light of lamps.
    """
    receiver, sun = shot.receiver, sun_of(shot)
    assert receiver is not None
    casters = shot.casters
    marks = np.zeros(len(grid.index), np.bool_)
    boxes = [_box(placed, basis(sun.direction if sun else (0.0, 1.0, 0.0)), shot.view.position) for placed in casters]
    if receiver.shadow and sun is not None:
        spread = float(np.tan(widest_half_angle(shot)))
        for axes, low, high, _ in boxes:
            mark_shaded(grid.point, grid.reach_m, axes, low, high, spread, marks)
    by_shadow = marks.copy()
    if receiver.occlusion:
        for axes, low, high, radius in boxes:
            center, half = 0.5 * (low + high) @ axes, 0.5 * (high - low)
            box = center, radius, np.ascontiguousarray(axes), half
            mark_occluded(grid.point, grid.normal, grid.reach_m, box, UNNOTICED, marks)
    if receiver.caustics and shot.caustics is not None and sun is not None:
        marks[:] = True
    by_lamps = _lit_cells(shot, grid)
    marks |= by_lamps
    if shot.medium is not None:
        # Look up the water before the far ones alone: the others are seen where it is densest
        clearest = float(shot.medium.attenuation.min(axis=-1).max())
        distance = np.linalg.norm(grid.point, axis=-1)
        far = np.flatnonzero(marks & (distance * clearest >= -np.log(NEGLIGIBLE)))
        up = grid.point[far, 1] / distance[far]
        marks[far] = transmittance_lookup(shot.medium, distance[far], up).max(axis=-1) > NEGLIGIBLE
    return marks, by_shadow & marks, by_lamps & marks


def _lit_cells(shot: Shot, grid: CoarseGrid) -> NDArray[np.bool_]:
    """Return the mask (n,) of cells that lamps light at their middle, and of the cells around those."""
    if not lamps_of(shot):
        return np.zeros(len(grid.index), np.bool_)
    lit = added_light(shot, light_sources(shot), grid.point, grid.normal, shadows=False).max(axis=-1) > NEGLIGIBLE
    if not np.any(lit):
        return lit
    mask = np.zeros(grid.shape, np.bool_)
    mask.flat[grid.index[lit]] = True
    mask |= np.roll(mask, 1, axis=1) | np.roll(mask, -1, axis=1)
    mask[1:] |= mask[:-1].copy()
    mask[:-1] |= mask[1:].copy()
    return np.asarray(mask.flat[grid.index])


def _box(placed: PlacedObject, axes: Floats, camera_position: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Return the axes (3, 3) of a box about a body, one a row, its bounds (3,) along them, and the radius of a ball
    about its middle that contains the body. Its third axis is that of `axes`, its first is along the greatest extent
    across it.
    """
    linear, offset = placed.world_from_object[:3, :3], placed.world_from_object[:3, 3] - camera_position
    corners = linear @ placed.mesh.hull.reshape(-1, 3).T + offset[:, None]
    across = axes[:2] @ (corners - corners.mean(axis=1, keepdims=True))
    turned = np.concatenate([np.linalg.eigh(across @ across.T)[1].T[::-1] @ axes[:2], axes[2:]])
    along = turned @ corners
    low, high = along.min(axis=1), along.max(axis=1)
    center = 0.5 * (low + high)
    radius = float(np.sqrt(np.max(np.sum((along - center[:, None]) ** 2, axis=0))))
    return turned, low, high, radius


def receiver_rectangles(shot: Shot, grid: CoarseGrid) -> list[Rectangle]:
    """Return rectangles of the frame that cover the cells that may change."""
    mask = np.zeros(grid.shape, np.bool_)
    mask.flat[grid.index[touched_cells(shot, grid)[0]]] = True
    return rectangles_of_cells(mask, grid.cell, shot.view)


def rectangles_of_cells(mask: NDArray[np.bool_], cell: tuple[int, int], view: View) -> list[Rectangle]:
    """Return rectangles of the frame that cover the set cells (rows, columns) of `cell` pixels, (columns, rows)."""
    width, height = cell
    return [
        Rectangle(c * width, r * height, min(columns * width, view.width), min(rows * height, view.height - r * height))
        for c, r, columns, rows in rectangles_of_mask(mask, RECTANGLE_COST_PX // (width * height))
    ]


@fast
def mark_shaded(point: Any, reach_m: Any, axes: Any, low: Any, high: Any, spread: Any, marks: Any) -> None:
    """Set the marks (n,) of places between which and the sun a body's box may be.

    axes: (3, 3), one a row, the last towards the sun. low, high: (3,) of the box along them. spread: tangent of the
    sun's radius. reach_m: (n,) of the receiver around each place, which stands for it.
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


@fast
def mark_occluded(point: Any, normal: Any, reach_m: Any, box: Any, least: Any, marks: Any) -> None:
    """Set the marks (n,) of places that a body touches, or of whose ambient light it may block at least this part.

    box: centre and radius of a ball around the body, axes (3, 3) and half size (3,) of a box around it. reach_m: (n,)
    of the receiver around each place, which stands for it. Of the box, what faces a place bounds what the body blocks
    there.
    """
    center, radius, axes, half = box
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
        away = np.sqrt(squared)
        face = 0.0
        for c in range(3):
            d = abs(x * axes[c, 0] + y * axes[c, 1] + z * axes[c, 2]) / away
            face += d * 4.0 * half[(c + 1) % 3] * half[(c + 2) % 3]
        rising = max(x * n[0] + y * n[1] + z * n[2] + near, 0.0) / (away - reach_m[i])
        distance = away - reach_m[i]
        marks[i] = face * min(rising, 1.0) > least * np.pi * distance * distance
