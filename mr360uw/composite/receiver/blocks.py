# SPDX-License-Identifier: Apache-2.0
"""The receiver on blocks of BLOCK x BLOCK pixels: where it is, what may change it, and ambient light at the corners.

Light on the receiver mostly varies slowly, so pixels of a block are interpolated from its corners. A block is *rough*
if its corners do not represent the pixels inside: at an edge or end of the receiver, in the belt in which it fades out,
and in small frames, where a block spans a large angle. Rough blocks are evaluated pixel by pixel.

A block may change if a body's shadow, widened by the sun's disc and by the block, can fall on it, if bodies block about
`UNNOTICED` of its ambient light, or if lamps light it.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import Cache, Neutral, PartOf, Same
from mr360uw.base.progress import one_blas_thread
from mr360uw.base.sphere import basis
from mr360uw.base.tile_blend import BLOCK, CORNER_CHANNELS, PixelImages
from mr360uw.composite.ambient.blocked_light import UNNOTICED
from mr360uw.composite.ambient.ground_light import GroundField, ground_field
from mr360uw.composite.ambient.solver import AmbientLight, ambient_light
from mr360uw.composite.light_sources import lamps_of, light_sources, steepest_slope, sun_of, widest_half_angle
from mr360uw.composite.receiver.ratio import (
    FADE_FROM,
    FREE,
    SEEN,
    SHARE,
    VEIL,
    Gathered,
    added_light,
    ambient_share,
    four_corners,
    gather_images,
)
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.sampling import Gaps
from mr360uw.composite.shading import veil_ahead
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.tiles import places_in_mask, rectangles_of_mask
from mr360uw.jit import exact, exact_making, fast
from mr360uw.medium.lookup import transmittance_lookup
from mr360uw.types import Floats, Rectangle, View

RECTANGLE_COST_PX = 16384
"""Fixed cost of one rectangle, in pixels that take as long. Twice as large: fewer rectangles, more untouched pixels."""
NEGLIGIBLE = 0.004
"""Change of linear light that is ignored: half a code value of an 8-bit video at white."""
SMOOTH = 0.004
"""Largest interpolation error at the middle of a block, in linear light: less than a code value. Twice as large, blocks
show in smooth shadows."""
_EVEN_DISTANCE = 0.01
_EVEN_NORMAL = 0.005
"""Interpolation errors of distance (relative) and normal above which a block is rough: below a code value each."""
_UNBROKEN = 0.05
"""That error of distance above which a block has an edge. On rubble it is 1 to 4 %."""
_REACH, _REACH_OF_SHAPE = 1.1, 1.5
"""Factors on the distance to the farthest corner, and on the largest step in distance, to bound all of a block."""
_WIDEST_TURN = 1.0 / 48.0
"""Fraction of a turn that a block may span. In frames narrower than 384 pixels it spans more, and may contain the whole
shadow of a small body, which corners and middle then miss: all blocks are rough."""
_LEAST_COSINE = 0.02
"""Least cosine between ray and normal at which the extent of a block on the receiver is reckoned."""
_TOUCHING = 1e20
"""Bound on the blocked light, times pi, of blocks that a body may touch."""
_LAMP_STEP = 2
"""Blocks between those at whose middles the light of lamps is looked at; it counts for those around them."""
_PAST_THE_LAST = 5.0 / 32.0
"""Error of a straight line a quarter step past its samples, in second differences: (1/4)(5/4)/2; between them 1/8."""
_PART_OF_GAP = 0.25
"""GroundReach of a block over the height of a body above the ground, below which corners and middle miss nothing."""

Indices = NDArray[np.int64]
Blocks = NDArray[np.bool_]
"""A mask (R, C) of the frame's blocks."""


class Ground:
    """Points and normals of the receiver in one view, on any thread: at the middles of all blocks, else on those given
    to `load_blocks`.

    corner_point, corner_normal: (R + 1, C + 1, 3) float32, middle_point, middle_normal: (R, C, 3), from the camera [m],
    zero where there is none; corner (j, i) is at frame coordinates (8 i, 8 j). level: all normals are the same.
    reach_m: (R, C) radius of a ball about the middle that contains the block. rough: (R, C). broken: (R, C) rough, and
    with an edge: light that varies slowly on a surface jumps there.
    """

    def __init__(self, view: View, shape: ReceiverShape) -> None:
        self._view, self._shape, self._lock = view, shape, threading.RLock()
        self.level = shape.level_m is not None
        self.rows, self.columns = -(-view.height // BLOCK), -(-view.width // BLOCK)
        corners, blocks = (self.rows + 1, self.columns + 1), (self.rows, self.columns)
        x, y = BLOCK * np.arange(corners[1]), np.minimum(BLOCK * np.arange(corners[0]), view.height)
        self._corner_xy = x.astype(np.float64), y.astype(np.float64)
        self._middle_xy = BLOCK * (np.arange(self.columns) + 0.5), 0.5 * (y[:-1] + y[1:])
        self.middle_point, self.middle_normal = self._on_grid(self._middle_xy, np.ones(blocks, np.bool_))
        self.corner_point, self.corner_normal = self._on_grid(self._corner_xy, np.zeros(corners, np.bool_))
        self.reach_m = np.zeros(blocks, np.float32)
        self.broken = np.full(blocks, _WIDEST_TURN * view.width < BLOCK)
        self.rough = self.broken.copy()
        self._loaded_corner, self._loaded_block = np.zeros(corners, np.bool_), np.zeros(blocks, np.bool_)
        self._image_at = np.full(blocks, -1, np.int64)
        self._images = np.zeros((0, BLOCK, BLOCK, 4), np.float32)

    def _on_grid(self, xy: tuple[Floats, Floats], wanted: NDArray[np.bool_]) -> tuple[Any, Any]:
        """Return points and normals (h, w, 3) float32 at frame coordinates x (w,), y (h,) where wanted (h, w)."""
        view, point = self._view, np.zeros((*wanted.shape, 3), np.float32)
        if self._shape.level_m is not None:
            height_m, extent_m = self._shape.level_m, self._shape.extent_m
            size = float(view.width), float(view.height)
            axes = np.ascontiguousarray(view.world_from_camera, np.float64)
            _meet_level(xy, wanted, size, axes, (float(view.eye_m), height_m, extent_m), point)
            up = np.array([0.0, -np.sign(height_m) if height_m else 1.0, 0.0], np.float32)
            return point, np.broadcast_to(up, point.shape)
        normal, (j, i) = np.zeros_like(point), places_in_mask(wanted)
        point[j, i], normal[j, i] = self.meet(xy[0][i], xy[1][j])
        return point, normal

    def corners_of(self, blocks: Blocks) -> NDArray[np.bool_]:
        """Return the corners (R + 1, C + 1) of a set of blocks (R, C)."""
        corners = np.zeros((self.rows + 1, self.columns + 1), np.bool_)
        for down in (0, 1):
            for right in (0, 1):
                corners[down : self.rows + down, right : self.columns + right] |= blocks
        return corners

    def load_blocks(self, blocks: Blocks) -> None:
        """Compute corners, reach and kind of a set of blocks (R, C), unless they are loaded already."""
        with self._lock:
            new = blocks & ~self._loaded_block
            if not np.any(new):
                return
            corners = self.corners_of(new) & ~self._loaded_corner
            point, normal = self._on_grid(self._corner_xy, corners)
            self.corner_point[corners] = point[corners]
            if not self.level:
                self.corner_normal[corners] = normal[corners]
            # Find which of them have their corners and middle on the receiver, and how far they reach
            j, i = places_in_mask(new)
            limit = FADE_FROM * self._shape.extent_m
            _measure_blocks(j, i, self.corner_point, self.middle_point, limit, _REACH, self.broken, self.reach_m)
            self.rough[j, i] |= self.broken[j, i]
            if not self.level:
                self._classify(j, i)
            self._loaded_corner |= corners
            self._loaded_block |= new

    def meet(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Return points and normals (..., 3) of the receiver at frame coordinates, zero where there is no receiver."""
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        direction = self._view.directions(x, y)
        distance, normal = self._shape.meet(self._view, x, y, direction)
        there = np.isfinite(distance)
        point = np.where(there[..., None], self._view.points(direction, np.where(there, distance, 0.0)), 0.0)
        return point, np.where(there[..., None], normal, 0.0)

    def _classify(self, j: Indices, i: Indices) -> None:
        """Set `rough`, `broken` and `reach_m` of blocks from all their pixels."""
        pixels = self.pixels(j, i)
        distance, normal = pixels[..., 3], pixels[..., :3]
        interpolated = self._between(self.corner_point, j, i), self._between(self.corner_normal, j, i)
        expected = np.linalg.norm(interpolated[0], axis=-1)
        missed = np.abs(distance - expected)
        uneven = missed > _EVEN_DISTANCE * expected
        uneven |= np.abs(normal - interpolated[1]).max(axis=-1) > _EVEN_NORMAL
        self.rough[j, i] |= np.any(uneven, axis=(1, 2))
        self.broken[j, i] |= np.any(missed > _UNBROKEN * expected, axis=(1, 2))
        beyond = np.abs(distance - np.linalg.norm(self.middle_point[j, i], axis=-1)[:, None, None]).max(axis=(1, 2))
        self.reach_m[j, i] = np.maximum(self.reach_m[j, i], _REACH_OF_SHAPE * beyond)

    def pixels(self, j: Indices, i: Indices) -> NDArray[np.float32]:
        """Return (normal, distance) of the pixels of blocks, (n, BLOCK, BLOCK, 4); distance 0 where there is none."""
        with self._lock:
            new = self._image_at[j, i] < 0
            if np.any(new):
                nj, ni = j[new], i[new]
                inside = np.arange(BLOCK) + 0.5
                x = BLOCK * ni[:, None, None] + inside
                y = np.minimum(BLOCK * nj[:, None, None] + inside[:, None], self._view.height - 0.5)
                distance, normal = self._shape.meet(self._view, x, y)
                there = np.isfinite(distance)[..., None]
                found = np.where(there, np.concatenate([normal, distance[..., None]], axis=-1), 0.0)
                self._image_at[nj, ni] = len(self._images) + np.arange(len(nj))
                self._images = np.concatenate([self._images, found.astype(np.float32)])
            return self._images[self._image_at[j, i]]

    def pixel_places(self, j: Indices, i: Indices) -> tuple[Floats, Floats]:
        """Return points and normals (n, B, B, 3) of the receiver at the pixels of blocks, float32."""
        pixels = self.pixels(j, i)
        inside = np.arange(BLOCK) + 0.5
        x, y = BLOCK * i[:, None, None] + inside, BLOCK * j[:, None, None] + inside[:, None]
        point = self._view.points(self._view.directions(x, y), pixels[..., 3])
        return point.astype(np.float32), pixels[..., :3]

    def gaps_in(self, gaps: Gaps, j: Indices, i: Indices) -> tuple[Gaps, Indices]:
        """Return the gaps within blocks (n,), and for each the number of its block among these."""
        number = np.full((self.rows, self.columns), -1)
        number[j, i] = np.arange(len(j))
        block = number[gaps.row // BLOCK, gaps.column // BLOCK]
        inside = block >= 0
        row, column, place, area = gaps
        return Gaps(row[inside], column[inside], place[inside], area[inside]), block[inside]

    def _between(self, corner: Floats, j: Indices, i: Indices) -> Floats:
        """Return corner values (R + 1, C + 1, k) interpolated to the pixels of blocks, (n, BLOCK, BLOCK, k)."""
        t = ((np.arange(BLOCK) + 0.5) / BLOCK).astype(np.float32)
        down = np.minimum((np.arange(BLOCK) + 0.5) / np.minimum(self._view.height - BLOCK * j, BLOCK)[:, None], 1.0)
        down = down.astype(np.float32)[:, :, None, None]
        four = four_corners(corner, j, i)
        left = four[:, None, 0] * (1.0 - down[..., 0]) + four[:, None, 2] * down[..., 0]
        right = four[:, None, 1] * (1.0 - down[..., 0]) + four[:, None, 3] * down[..., 0]
        return left[:, :, None] * (1.0 - t[:, None]) + right[:, :, None] * t[:, None]


@exact_making
def _meet_level(xy: Any, wanted: Any, size: Any, axes: Any, ground: Any, point: Any) -> None:
    """Set the points (h, w, 3) [m] of level ground, from the camera, at frame coordinates x (w,), y (h,), where wanted
    (h, w); those that do not meet it stay. As `ReceiverShape.meet`.

    size: of the frame. axes: (3, 3) world from camera. ground: radius of the viewing circle, height of the ground above
    the camera and its extent [m].
    """
    (x, y), (eye_m, height_m, extent_m) = xy, ground
    longitude = 2.0 * np.pi * (x / size[0] - 0.5)
    right, ahead = np.sin(longitude), np.cos(longitude)
    for j in range(len(y)):
        latitude = np.pi * (0.5 - y[j] / size[1])
        up, level = np.sin(latitude), np.cos(latitude)
        for i in range(len(x)):
            if not wanted[j, i]:
                continue
            # The ray's direction in the world, and where an eye's ray starts on the viewing circle
            a, b, c = level * right[i], up, -level * ahead[i]
            u = axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c
            v = axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c
            w = axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c
            from_x = eye_m * (v * axes[2, 1] - w * axes[1, 1])
            from_y = eye_m * (w * axes[0, 1] - u * axes[2, 1])
            from_z = eye_m * (u * axes[1, 1] - v * axes[0, 1])
            # Where it meets the ground, in front and within the extent
            distance = (height_m - from_y) / v
            if distance > 0.0 and distance <= extent_m:
                point[j, i, 0] = from_x + distance * u
                point[j, i, 1] = from_y + distance * v
                point[j, i, 2] = from_z + distance * w


@exact
def _measure_blocks(
    j: Any, i: Any, corner: Any, middle: Any, limit: Any, factor: Any, rough: Any, reach_m: Any
) -> None:  # fmt: skip
    """Mark blocks (n,) as rough whose corners or middle do not lie on the receiver, or farther away than `limit` [m].

    corner: (R + 1, C + 1, 3), middle: (R, C, 3), from the camera. reach_m: (R, C) set to `factor` times the distance of
    the farthest corner from the middle.
    """
    for n in range(len(j)):
        r, c = j[n], i[n]
        u, v, w = np.float64(middle[r, c, 0]), np.float64(middle[r, c, 1]), np.float64(middle[r, c, 2])
        far = u * u + v * v + w * w
        off, longest = far == 0.0, 0.0
        for k in range(4):
            p = corner[r + k // 2, c + k % 2]
            x, y, z = np.float64(p[0]), np.float64(p[1]), np.float64(p[2])
            squared = x * x + y * y + z * z
            off |= squared == 0.0
            far = max(far, squared)
            longest = max(longest, (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2)
        rough[r, c] |= off or far > limit * limit
        reach_m[r, c] = factor * np.sqrt(longest)


# --- what may change -------------------------------------------------------------------------------------------------


Touched = tuple[Ground, Blocks, Blocks, Blocks]
"""The receiver, and by the bodies' boxes upper bounds of its blocks that change: at all, by the sun's shadow, by lamps.
"""


def touched_ground(shot: Shot, cache: Cache) -> Touched | None:
    """Return the receiver that a shot may change; None where it does not. cache: keeps it while nothing moves."""
    if shot.receiver is None:
        return None
    shape = cache.of(ReceiverShape, shot.receiver, shot.view.position)
    ground = cache.of(Ground, shot.view, shape)
    sun = sun_of(shot)
    of_light = None if sun is None else sun.direction, widest_half_angle(shot), steepest_slope(shot)
    # of the water its attenuation alone counts, which does not change when the veil is scaled to the plate
    through = None if shot.medium is None else Same(shot.medium.attenuation)
    alike = PartOf(shot, shot.receiver, shot.casters, *of_light, shot.caustics is None, through)
    touched = _touched(alike, ground) if lamps_of(shot) else cache.of(_touched, alike, ground)
    return touched if np.any(touched[1]) else None


def _touched(alike: PartOf[Shot], ground: Ground) -> Touched:
    """Return the blocks whose change may be seen through the water."""
    shot = alike.whole
    receiver, sun = shot.receiver, sun_of(shot)
    assert receiver is not None
    point, shape = ground.middle_point, ground.middle_point.shape[:2]
    shaded, marks = np.zeros((2, *shape), np.bool_)
    # Mark what shadows may fall on, or bodies block light of
    if shot.casters:
        boxes = _boxes(shot.casters, basis(sun.direction if sun else (0.0, 1.0, 0.0)), shot.view.position)
        spread = -1.0
        if receiver.shadow and sun is not None:
            bent = math.tan(sun.half_angle_rad) + steepest_slope(shot)
            spread = max(math.tan(widest_half_angle(shot)), bent)
        normal = ground.middle_normal[:1, :1] if ground.level else ground.middle_normal
        extent = BLOCK * np.pi / (2 * shot.view.height), BLOCK * np.pi / shot.view.width
        least = np.pi * UNNOTICED if receiver.occlusion else 2.0 * _TOUCHING
        _mark(point, np.ascontiguousarray(normal), extent, boxes, spread, least, shaded, marks)
    if receiver.caustics and shot.caustics is not None and sun is not None:
        marks |= np.any(point != 0.0, axis=-1)
    lamplit = _lamplit(shot, ground) if lamps_of(shot) else np.zeros(shape, np.bool_)
    marks |= lamplit
    if shot.medium is not None:
        # Look up the water before the far ones alone: the others are seen where it is densest
        clearest = float(shot.medium.attenuation.min(axis=-1).max())
        j, i = places_in_mask(marks)
        distance = np.linalg.norm(point[j, i], axis=-1)
        far = np.flatnonzero(distance * clearest >= -np.log(NEGLIGIBLE))
        j, i, distance = j[far], i[far], distance[far]
        marks[j, i] = transmittance_lookup(shot.medium, distance, point[j, i, 1] / distance).max(axis=-1) > NEGLIGIBLE
    return ground, marks, shaded & marks, lamplit & marks


def _lamplit(shot: Shot, ground: Ground) -> Blocks:
    """Return the mask (R, C) of blocks around those that lamps light at their middle."""
    lit = np.zeros((ground.rows, ground.columns), np.bool_)
    point, normal = (a[::_LAMP_STEP, ::_LAMP_STEP] for a in (ground.middle_point, ground.middle_normal))
    j, i = places_in_mask(np.any(point != 0.0, axis=-1))
    places = point[j, i].astype(np.float64), normal[j, i].astype(np.float64)
    some = added_light(shot, light_sources(shot), *places, shadows=False).max(axis=-1) > NEGLIGIBLE
    j, i = _LAMP_STEP * j[some], _LAMP_STEP * i[some]
    for down in range(-_LAMP_STEP, _LAMP_STEP + 1):
        for right in range(-_LAMP_STEP, _LAMP_STEP + 1):
            lit[np.clip(j + down, 0, ground.rows - 1), (i + right) % ground.columns] = True
    return lit


def _boxes(casters: tuple[PlacedObject, ...], axes: Floats, camera_position: Floats) -> tuple[Floats, ...]:
    """Return of boxes around bodies axes (n, 3, 3), one a row, bounds (n, 3) along them, low and high, silhouettes
    (n, 3) of the bodies' hulls along them [m^2], and middle and radius (n, 4) of balls about the bodies.

    The third axis of each is that of `axes`, its first is along the greatest extent across it.
    """
    found = []
    for placed in casters:
        linear, offset = placed.world_from_object[:3, :3], placed.world_from_object[:3, 3] - camera_position
        corners = linear @ placed.mesh.hull.reshape(-1, 3).T + offset[:, None]
        across = axes[:2] @ (corners - corners.mean(axis=1, keepdims=True))
        turned = np.concatenate([np.linalg.eigh(across @ across.T)[1].T[::-1] @ axes[:2], axes[2:]])
        along = turned @ corners
        low, high = along.min(axis=1), along.max(axis=1)
        center = 0.5 * (low + high)
        radius = np.sqrt(np.max(np.sum((along - center[:, None]) ** 2, axis=0)))
        # A closed hull is seen twice along an axis, a flat one once
        a, b, c = np.moveaxis(along.T.reshape(-1, 3, 3), 1, 0)
        area = 0.5 * np.cross(b - a, c - a)
        silhouette = 0.5 * (np.abs(area).sum(axis=0) + np.abs(area.sum(axis=0)))
        found.append((turned, low, high, silhouette, np.append(center @ turned, radius)))
    return tuple(np.array(column, np.float64) for column in zip(*found, strict=True))


@fast
def _mark(point: Any, normal: Any, extent: Any, boxes: Any, spread: Any, least: Any, shaded: Any, marks: Any) -> None:
    """Set the masks (R, C) of blocks between which and the sun a body may be, and of those beside whose ambient light
    bodies may block enough.

    point: (R, C, 3) of their middles; normal: the same, or (1, 1, 3). extent: half size of a block [rad], down and
    across. boxes: of `_boxes`. spread: tangent of the sun's radius, negative for no sun. least: pi times the blocked
    fraction that counts. Silhouettes along three axes bound that in any direction: the bound is a norm.
    """
    axes, low, high, silhouette, balls = boxes
    same = normal.shape[0] == 1
    for r in range(point.shape[0]):
        for c in range(point.shape[1]):
            # Find how far the block reaches on the receiver
            p, n = point[r, c], normal[0 if same else r, 0 if same else c]
            px, py, pz = np.float64(p[0]), np.float64(p[1]), np.float64(p[2])
            squared = px * px + py * py + pz * pz
            if squared == 0.0:
                continue
            distance = np.sqrt(squared)
            cosine = max(abs(px * n[0] + py * n[1] + pz * n[2]) / distance, _LEAST_COSINE)
            steep = extent[0] / cosine
            reach = distance * np.sqrt(steep * steep + extent[1] * extent[1])
            total = 0.0
            for b in range(len(balls)):
                # Whether a body's box may be between it and part of the sun's disc
                axis = axes[b]
                if spread >= 0.0:
                    above = high[b, 2] - (px * axis[2, 0] + py * axis[2, 1] + pz * axis[2, 2]) + reach
                    wide = reach + spread * max(above, 0.0)
                    u = px * axis[0, 0] + py * axis[0, 1] + pz * axis[0, 2]
                    v = px * axis[1, 0] + py * axis[1, 1] + pz * axis[1, 2]
                    beside = max(low[b, 0] - u, u - high[b, 0], low[b, 1] - v, v - high[b, 1])
                    if above > 0.0 and beside <= wide:
                        shaded[r, c] = True
                # Bound the ambient light that it blocks by its silhouettes, and by how far it rises above the horizon
                x, y, z = balls[b, 0] - px, balls[b, 1] - py, balls[b, 2] - pz
                near = balls[b, 3] + reach
                apart = x * x + y * y + z * z
                if apart < near * near:
                    total = _TOUCHING
                    continue
                away = np.sqrt(apart)
                seen = 0.0
                for k in range(3):
                    seen += abs(x * axis[k, 0] + y * axis[k, 1] + z * axis[k, 2]) * silhouette[b, k]
                rising = max(x * n[0] + y * n[1] + z * n[2] + near, 0.0)
                nearest = away - reach
                total += seen * min(rising / nearest, 1.0) / (away * nearest * nearest)
            marks[r, c] = shaded[r, c] or total > least


def rectangles_of_blocks(blocks: Blocks, view: View) -> list[Rectangle]:
    """Return rectangles of the frame that cover a set of blocks (R, C)."""
    return [
        Rectangle(c * BLOCK, r * BLOCK, min(columns * BLOCK, view.width), min(rows * BLOCK, view.height - r * BLOCK))
        for c, r, columns, rows in rectangles_of_mask(blocks, RECTANGLE_COST_PX // BLOCK**2)
    ]


# --- light on blocks -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class GroundReach:
    """The receiver that a shot may change, with all of its light that does not need the device.

    ground, blocks, shaded, lamplit: of `Touched`. ambient: what bodies leave of its light. corner: (R + 1, C + 1, 10)
    of `GroundLines`, as if the sun were visible everywhere; `set_plate_light` fills in its first channels.
    """

    ground: Ground
    blocks: Blocks
    shaded: Blocks
    lamplit: Blocks
    ambient: GroundField
    corner: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Prepared(Neutral):
    """What of a shot does not need the device, and follows from the shot.

    ambient: light of its bodies. reach: the receiver that it may change. None where there is none.
    """

    ambient: AmbientLight | None
    reach: GroundReach | None


def prepare(shot: Shot, cache: Cache) -> Prepared:
    """Return what of a shot does not need the device, on any thread. cache: keeps what does not change."""
    with one_blas_thread():
        touched, ambient = touched_ground(shot, cache), ambient_light(shot, cache)
        if touched is None:
            return Prepared(ambient, None)
        # Find the ambient light that bodies leave at the corners of the receiver's blocks
        (ground, blocks, _, _), field = touched, ground_field(shot, ambient, cache)
        ground.load_blocks(blocks)
        corner = np.zeros((ground.rows + 1, ground.columns + 1, CORNER_CHANNELS), np.float32)
        j, i = places_in_mask(ground.corners_of(blocks))
        corner[j, i, FREE] = field.at(*_places(ground, j, i))
        corner[j, i, SEEN] = 1.0
        return Prepared(ambient, GroundReach(*touched, field, corner))


def _places(ground: Ground, j: Indices, i: Indices) -> tuple[Floats, Floats]:
    """Return points and normals (n, 3) of corners, float64."""
    point = np.take(ground.corner_point.reshape(-1, 3), j * (ground.columns + 1) + i, axis=0).astype(np.float64)
    one = ground.corner_normal[0, 0] if ground.level else ground.corner_normal[j, i]
    return point, np.broadcast_to(one.astype(np.float64), point.shape)


def changed_blocks(shot: Shot, reach: GroundReach, blocks: Blocks) -> Blocks:
    """Return those of some blocks (R, C) in which bodies may change the receiver by more than `Shot.unseen`.

    Ambient and direct light have weights that add up to 1 (see ratio.py and pattern.py), and each factor on them is
    linear between the corners; only near a body and where the ambient light jumps it may be farther from 1 inside.
    """
    ground, (j, i) = reach.ground, places_in_mask(blocks)
    most, near = np.zeros((2, len(j)), np.float32), np.zeros(len(j), np.bool_)
    _survey(j, i, reach.corner[..., FREE.start :], ground.middle_point, ground.reach_m, _balls(shot), most, near)
    unseen = np.broadcast_to(np.float32(shot.unseen), blocks.shape)[j, i]
    marks = ground.broken[j, i] | _crossed(ground, reach.ambient)[j, i] | near | (most[1] > unseen)
    changed = np.zeros_like(blocks)
    changed[j[marks], i[marks]] = True
    return changed


def set_plate_light(shot: Shot, reach: GroundReach, blocks: Blocks) -> None:
    """Set the ambient share and the veil of the plate at the corners of blocks (R, C)."""
    ground, corner = reach.ground, reach.corner
    j, i = places_in_mask(ground.corners_of(blocks))
    point, normal = _places(ground, j, i)
    of = slice(None)
    if shot.receiver is not None and shot.receiver.plane_y is not None and len(point):
        there = int(np.argmax(point[:, 1] != 0.0))
        of = slice(there, there + 1)  # a horizontal plane has the same share everywhere
    corner[j, i, SHARE] = ambient_share(shot, light_sources(shot), point[of], normal[of])
    if shot.medium is not None:
        distance = np.linalg.norm(point, axis=-1)
        corner[j, i, VEIL] = veil_ahead(shot.medium, distance, point / np.maximum(distance, 1e-9)[:, None])


def free_images(shot: Shot, reach: GroundReach, j: Indices, i: Indices, gaps: Gaps) -> PixelImages:
    """Return the unblocked ambient fraction per pixel, of those of blocks (n,) that their corners do not represent.

    Partly covered pixels take it in their gaps.
    """
    ground, field, free = reach.ground, reach.ambient, reach.corner[..., FREE]
    # Find the blocks whose light at the middle is not that between their corners, or may jump
    broken, rough = ground.broken[j, i], ground.rough[j, i]
    most, near = np.zeros((2, len(j)), np.float32), np.zeros(len(j), np.bool_)
    _survey(j, i, free, ground.middle_point, ground.reach_m, _balls(shot), most, near)
    change = most[0]
    near &= ground.reach_m[j, i] > _PART_OF_GAP * field.gap_m
    uneven = ~broken & (near | rough | (change > SMOOTH))
    asked = j[uneven], i[uneven]
    at_middle = field.at(ground.middle_point[asked], ground.middle_normal[asked])
    missed = np.zeros(len(j))
    missed[uneven] = np.abs(at_middle - four_corners(free, *asked).mean(axis=1)).max(axis=-1)
    crossed = _crossed(ground, field)
    uneven = ((missed > SMOOTH) | (near & (change > SMOOTH)) | crossed[j, i]) & ~broken
    # Take it between every four pixels of these; where that misses it, and at edges of the ground, at each
    parts: Gathered = []
    if np.any(uneven):
        of = j[uneven], i[uneven]
        inside = np.arange(1.0, BLOCK, 2.0)
        x, y = BLOCK * of[1][:, None, None] + inside, BLOCK * of[0][:, None, None] + inside[:, None]
        quarters = field.at(*ground.meet(*np.broadcast_arrays(x, np.minimum(y, shot.view.height))))
        values = np.maximum(enlarged(quarters), 0.0)  # past the outer samples lines go on
        sharp = crossed[of] | (missed_between(quarters) > SMOOTH)
        if np.any(sharp):
            values[sharp] = field.at(*ground.pixel_places(of[0][sharp], of[1][sharp]))
        parts.append((uneven, values))
    if np.any(broken):
        parts.append((broken, field.at(*ground.pixel_places(j[broken], i[broken]))))
    # Partly covered pixels take it in their gaps
    images = gather_images(len(j), 3, parts)
    own = np.flatnonzero(images.at >= 0)
    some, block = ground.gaps_in(gaps, j[own], i[own])
    if len(block):
        at = images.at[own][block], some.row % BLOCK, some.column % BLOCK
        images.image[at] = field.at(*ground.meet(*some.place.T))
    return images


def _balls(shot: Shot) -> Floats:
    """Return middles from the camera and radii (n, 4) [m] of balls around the bodies that shade."""
    balls = [
        (*(placed.to_world(placed.mesh.center_m) - shot.view.position), placed.mesh.radius_m * placed.scale)
        for placed in shot.casters
    ]
    return np.array(balls, np.float64).reshape(-1, 4)


def _crossed(ground: Ground, field: GroundField) -> NDArray[np.bool_]:
    """Return the mask (R, C) of blocks within which the ambient light that bodies leave jumps, or a pixel beside."""
    crossed = np.zeros((ground.rows, ground.columns), np.bool_)
    view, place = field.shot.view, field.jumps()
    if len(place):
        width, height = view.width, view.height
        x, y = view.places(place)
        wide = np.minimum(1.0 / np.maximum(np.sin(np.pi * y / height), 1.0 / BLOCK), BLOCK)  # near a pole [pixels]
        for down in (-1.0, 1.0):
            for right in (-1.0, 0.0, 1.0):
                i, j = np.floor(x + right * wide).astype(np.int64) % width, np.floor(y + down).astype(np.int64)
                crossed[np.clip(j, 0, height - 1) // BLOCK, i // BLOCK] = True
    return crossed


def missed_between(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest error (n,) of straight lines between samples (n, s, s, k), and a quarter step past the outer
    ones, as second differences tell it.
    """
    bends = [np.abs(np.diff(images, 2, axis=axis)).reshape(len(images), -1).max(axis=1) for axis in (1, 2)]
    return np.asarray(_PAST_THE_LAST * np.maximum(*bends), np.float32)


def enlarged(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return images (n, s, s, k) at the pixels of blocks, (n, B, B, k): straight lines, also past the outer samples."""
    side = images.shape[1]
    place = (np.arange(BLOCK) + 0.5) * side / BLOCK - 0.5
    lower = np.clip(np.floor(place).astype(np.int64), 0, side - 2)
    weights = np.zeros((BLOCK, side), np.float32)
    weights[np.arange(BLOCK), lower] = 1.0 - (place - lower)
    weights[np.arange(BLOCK), lower + 1] = place - lower
    along = weights @ images.transpose(0, 3, 1, 2) @ weights.T
    return np.ascontiguousarray(along.transpose(0, 2, 3, 1), np.float32)


@exact
def _survey(j: Any, i: Any, corner: Any, middle: Any, reach_m: Any, balls: Any, most: Any, near: Any) -> None:
    """Find how factors change over blocks (n,), and which blocks reach into a ball.

    corner: (R + 1, C + 1, k). middle: (R, C, 3) and reach_m: (R, C) of the blocks, balls: (b, 4) middle and radius, all
    [m]. most: (2, n) set to the largest difference of two corners in any channel, and of a corner from 1; near: (n,)
    set.
    """
    one = corner.dtype.type(1)
    for n in range(len(j)):
        r, c = j[n], i[n]
        most[0, n], most[1, n], near[n] = 0.0, 0.0, False
        for k in range(corner.shape[2]):
            v00, v01, v10, v11 = corner[r, c, k], corner[r, c + 1, k], corner[r + 1, c, k], corner[r + 1, c + 1, k]
            low, high = min(v00, v01, v10, v11), max(v00, v01, v10, v11)
            most[0, n], most[1, n] = max(most[0, n], high - low), max(most[1, n], high - one, one - low)
        for b in range(len(balls)):
            x, y, z = middle[r, c, 0] - balls[b, 0], middle[r, c, 1] - balls[b, 1], middle[r, c, 2] - balls[b, 2]
            far = balls[b, 3] + reach_m[r, c]
            near[n] |= x * x + y * y + z * z < far * far
