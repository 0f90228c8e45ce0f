# SPDX-License-Identifier: Apache-2.0
"""Columns of bodies along directed light: a square slot for each body, traced by light_visibility.py.

Each slot is drawn from a `ShadowFrame`: bodies, and axes in which the light's rays are parallel. For the sun these are
orthogonal axes along its direction. For a lamp they follow the projective map

    (x, y, z) -> (x m/z, y m/z, m^2/z)

with z the distance along its axis and m its middle distance: lines through the lamp become parallel, straight lines
stay straight, and lengths at the middle distance stay metres. A slot of the sun holds heights above the lowest point of
its bodies, about their middle: bodies that move without turning keep it.

A column is (filled fraction, top, bottom, opacity), the last three times the first, heights in metres above the lowest
point of its slot; of bodies that let light through, opacity is 1 less the product over their surfaces. Columns are
means of 2 x 2 texels that are drawn; levels are means of 2 x 2, 4 x 4, ... columns, down to `SMALLEST` across a slot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Scratch, room
from mr360uw.base.sphere import basis
from mr360uw.composite.ambient.form_factors import rounded
from mr360uw.composite.gl.triangles import BLENDED, MASKED, OPAQUE, mesh_looks
from mr360uw.composite.gl.visible_surfaces import alpha_of, cutouts
from mr360uw.composite.light_sources import sun_of
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.jit import exact, fast
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import Floats, Lamp

SLOTS = (64, 128, 256, 512)
"""Columns across a slot."""
SMALLEST = 4
"""Columns across the last level of a slot."""
_NARROW_RAD = 0.02
"""Angular radius of a light below which the largest slots are used: its penumbrae are as narrow as columns."""
_COLUMNS_A_PIXEL = 2.0
_MOST_COLUMNS_A_PIXEL = 8.0
"""Least and most columns for a pixel of the frame: penumbrae somewhat narrower than a pixel still matter."""
_COLUMNS_A_DISC = 7.0
"""Columns across the light's radius at the distance of a body's width."""
_MOST_COLUMNS = 1 << 21
"""Columns of all slots together: bounds the memory."""
_SUPERSAMPLING = 2
"""Texels drawn along each side of a column."""
_BESIDE = (1e-4, 3e-5)
"""Offset of what is drawn, in texels, so that no texel lies on the edge of two triangles of a symmetric body."""
_MARGIN = 1.02
"""Factor on the extent of the bodies in a slot, which keeps its border empty."""
_NARROWEST = 1.0 / 16.0
"""Least ratio of the shorter side of a slot's extent to the longer one."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadowFrame:
    """Projection of one slot. bodies: drawn over each other. axes: (3, 3) rows across, across and along, in the world.

    For the sun `along` points to it. For a lamp: origin (3,) [m] in the world, `along` pointing away from it, and
    middle_m, the distance [m] at which lengths are metres; bodies nearer than nearest_m cast no shadow. face: the slot
    is a face of a cube, 90 degrees wide, whatever its bodies' extents.
    """

    bodies: tuple[PlacedObject, ...]
    axes: Floats
    origin: Floats | None = None
    middle_m: float = 0.0
    nearest_m: float = 0.0
    face: bool = False

    @property
    def drawn(self) -> tuple[object, ...]:
        """All that decides what is drawn of it."""
        places = (self.matrix(body) if self.origin is None else body.world_from_object for body in self.bodies)
        bodies = zip((body.mesh for body in self.bodies), places, strict=True)
        return *bodies, self.axes, self.origin, self.middle_m, self.nearest_m

    @property
    def start(self) -> Floats:
        """Place (3,) [m] in the world from which the bodies are drawn: the lamp, or for the sun the first body."""
        return self.bodies[0].world_from_object[:3, 3] if self.origin is None else self.origin

    def matrix(self, placed: PlacedObject) -> Floats:
        """Return the (3, 4) transform from a body to the axes about `start`, before any projection."""
        shift = rounded(placed.world_from_object[:3, 3] - self.start, placed.mesh.radius_m * placed.scale)
        return self.axes @ np.column_stack([placed.world_from_object[:3, :3], shift])

    def placed(self, extents: Floats) -> Floats:
        """Return extents (6,) about `start` as rays are traced: for the sun about the world's origin."""
        if self.origin is not None:
            return extents
        x, y, z = self.axes @ self.start
        return extents + np.array([x, y, 0.0, 0.0, z, z])

    def extents(self) -> Floats:
        """Return the bodies' extents (6,) about `start`: centre across, half size across, ends along; two each."""
        hulls = [(body.mesh.hull.reshape(-1, 3), self.matrix(body)) for body in self.bodies]
        points = np.concatenate([hull @ m[:, :3].T + m[:, 3] for hull, m in hulls])
        if self.origin is not None:
            z = np.maximum(points[:, 2], self.nearest_m)
            flat = np.stack([points[:, 0], points[:, 1], np.full(len(z), self.middle_m)], axis=-1)
            points = flat * (self.middle_m / z)[:, None]
        low, high = points.min(axis=0), points.max(axis=0)
        center, half = 0.5 * (low + high)[:2], 0.5 * _MARGIN * (high - low)[:2]
        if self.face:
            center, half = np.zeros(2), np.full(2, self.middle_m)
        half = np.maximum(half, _NARROWEST * half.max())
        return np.concatenate([center, half, [low[2], high[2]]])


# --- the frames of lights ---------------------------------------------------------------------------------------------

MAXIMUM_SLOTS = 30
"""Most slots of the sun; the last holds all further bodies."""
_STEPS = 64.0
"""Slots are drawn along the sun's direction rounded to 1/64 in each component, within 0.8 degrees of it, so that those
of bodies at rest stay valid while the sun's track moves a little. Twice as large: redrawn twice as often."""


def sun_frames(shot: Shot) -> list[ShadowFrame]:
    """Return the light frames of the sun, one for each body."""
    sun, casters = sun_of(shot), shot.casters
    if sun is None or not casters:
        return []
    axes = basis(np.round(_STEPS * np.asarray(sun.direction)))
    groups: list[tuple[PlacedObject, ...]] = [(placed,) for placed in casters[: MAXIMUM_SLOTS - 1]]
    if len(casters) >= MAXIMUM_SLOTS:
        groups.append(casters[MAXIMUM_SLOTS - 1 :])
    return [ShadowFrame(group, axes) for group in groups]


_FARTHER = 1.25
"""Least distance of a body, in its radii, to fit one slot: it is then within 53 degrees of the slot's axis."""
_MOST_BODIES = 16
"""Most bodies with a slot of their own for a lamp; more share the six faces of a cube."""
_FACES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
_CORNER_RAD = float(np.arccos(3.0**-0.5))
"""Angle between the axis of a cube's face and its corners."""


def lamp_frames(lamp: Lamp, casters: tuple[PlacedObject, ...]) -> list[ShadowFrame]:
    """Return the light frames of a lamp: one for each body in its cone, or faces of a cube for bodies around it."""
    alone: list[ShadowFrame] = []
    around: list[PlacedObject] = []
    for placed in casters if lamp.casts_shadow else ():
        center = placed.to_world(placed.mesh.center_m) - lamp.position
        distance, radius = float(np.linalg.norm(center)), placed.mesh.radius_m * placed.scale
        if distance <= _FARTHER * radius:
            around.append(placed)
        elif _in_cone(lamp, center / distance, float(np.arcsin(radius / distance))):
            axes = basis(center)
            alone.append(ShadowFrame((placed,), axes, lamp.position, distance, nearest_m(lamp)))
    if len(alone) > _MOST_BODIES - len(_FACES) * bool(around):
        alone, around = [], list(casters)
    return alone + _faces(lamp, tuple(around))


def _faces(lamp: Lamp, bodies: tuple[PlacedObject, ...]) -> list[ShadowFrame]:
    """Return the faces of a cube around a lamp that its cone reaches."""
    if not bodies:
        return []
    centers = np.stack([placed.to_world(placed.mesh.center_m) for placed in bodies]) - lamp.position
    reach = np.linalg.norm(centers, axis=-1) + [placed.mesh.radius_m * placed.scale for placed in bodies]
    middle = 0.5 * max(float(reach.max()), 2.0 * nearest_m(lamp))
    return [
        ShadowFrame(bodies, basis(axis), lamp.position, middle, nearest_m(lamp), face=True)
        for axis in _FACES
        if _in_cone(lamp, axis, _CORNER_RAD)
    ]


def _in_cone(lamp: Lamp, direction: Floats, radius_rad: float) -> bool:
    """Return whether a disc about a unit direction, 1.5 times as wide as `radius_rad`, overlaps the lamp's cone."""
    if lamp.cos_edge <= -1.0:
        return True
    apart = float(np.arccos(np.clip(direction @ lamp.axis, -1.0, 1.0)))
    return apart <= float(np.arccos(lamp.cos_edge)) + 1.5 * radius_rad


# --- drawing ----------------------------------------------------------------------------------------------------------


def columns_of(
    frames: Sequence[ShadowFrame], pixels_across: float, half_angle_rad: float, cache: Cache, scratch: Scratch
) -> tuple[NDArray[np.float32], Floats, int, bool]:
    """Return the columns of bodies in slots, (slots, 4 n), row by row, then their levels, fine enough for lights of a
    radius and bodies at most `pixels_across` pixels wide.

    And the extents (slots, 6) as rays are traced, for the sun about the world's origin, the columns across a slot, and
    whether bodies let light through by their alpha. cache: keeps the last ones, and what is the same in all poses of
    meshes.
    """
    # As many columns as pixels and the light's disc ask for, and there is room for
    wanted = max(_COLUMNS_A_PIXEL * pixels_across, _COLUMNS_A_DISC / max(float(np.tan(half_angle_rad)), 1e-6))
    finest = SLOTS[-1] if half_angle_rad < _NARROW_RAD else SLOTS[-2]
    wanted = min(wanted, _MOST_COLUMNS_A_PIXEL * pixels_across, finest)
    most = np.sqrt(_MOST_COLUMNS / max(len(frames), 1))
    size = next(size for size in SLOTS if size >= wanted or 2 * size > most)
    # Draw them, and take their extents to where rays are traced
    clear = any(m.alpha_mode == "BLEND" for frame in frames for body in frame.bodies for m in body.mesh.materials)
    drawn_of = PartOf((frames, cache, scratch), *(frame.drawn for frame in frames))
    values, extents = cache.of(_draw_slots, drawn_of, size, clear)
    placed = np.array([frame.placed(of_frame) for frame, of_frame in zip(frames, extents, strict=True)])
    return values, placed.reshape(-1, 6), size, clear


def _draw_slots(
    drawn_of: PartOf[tuple[Sequence[ShadowFrame], Cache, Scratch]], size: int, clear: bool
) -> tuple[NDArray[np.float32], Floats]:
    """Return the columns of all slots, and the extents (slots, 6) of each about the start of its frame."""
    frames, cache, scratch = drawn_of.whole
    side = _SUPERSAMPLING * size
    heights = scratch.floats("heights", 2, side, side)
    passed = scratch.floats("passed", *((side, side) if clear else (0, 0)))
    # Memory that is not written is not taken: most columns are empty
    values = np.zeros((len(frames), 4 * (size * size - (SMALLEST // 2) ** 2) // 3, 4), np.float32)
    extents = np.array([frame.extents() for frame in frames]).reshape(-1, 6)
    work = room((3, 3), 3, 3, (3, 3), 3, 3, (2, 2), dtype=np.float64)
    for frame, of_frame, slot in zip(frames, extents, values, strict=True):
        spans = np.stack([np.full(size, side), np.full(size, -1)])
        for placed in frame.bodies:
            look = cache.of(mesh_looks, placed.mesh.still, keep=_KEPT)
            positions = np.asarray(placed.mesh.positions, np.float64)
            projection = frame.matrix(placed), of_frame, frame.middle_m, frame.nearest_m
            kinds = look.kind, cutouts([look], np.array([0, len(look.kind)]))
            _draw(positions, projection, kinds, spans, heights, passed, work)
        _sum_levels(heights, passed, spans, of_frame[4], slot)
    return values.reshape(len(frames), values.shape[1] * 4), extents


_KEPT = 64
"""Meshes of which the looks are kept between frames."""
_LOWEST = np.float32(-1e9)
"""Height of texels that nothing covers."""


@fast
def _draw(positions: Any, projection: Any, kinds: Any, spans: Any, heights: Any, passed: Any, work: Any) -> None:
    """Draw a mesh (T, 3, 3) into the texels of a slot: the largest of (top, -bottom) along the light, heights (2, n,
    n), and the product of what its surfaces let through, passed (n, n), empty where all bodies are opaque.

    projection: matrix (3, 4) from the mesh to the axes of the frame, extents, middle and nearest distance of
    `ShadowFrame`, the middle one 0 for the sun. kinds: of triangles, and tables of `cutouts`. spans: (2, n / 2) first
    and last texel that is drawn of each two rows; what lies beyond has any value. work: room for a triangle.
    """
    (matrix, extents, middle, nearest), (kind, (cut, cuts, alphas, places)) = projection, kinds
    side, (p, x, y, edge, plane, weights, change) = heights.shape[1], work
    # Texels of a metre across the light, and of its axis
    per_x, per_y = 0.5 * side / extents[2], 0.5 * side / extents[3]
    at_x = 0.5 * (side - 1.0) - per_x * extents[0] + _BESIDE[0]
    at_y = 0.5 * (side - 1.0) - per_y * extents[1] + _BESIDE[1]
    highest = middle * middle / nearest if middle > 0.0 else 1e30
    for t in range(len(positions)):
        for k in range(3):
            for j in range(3):
                p[k, j] = matrix[j, 3]
                for i in range(3):
                    p[k, j] += matrix[j, i] * positions[t, k, i]
        # Find the weights of the corners as functions of the texel, edge (3, 3): a column + b row + c; and the height
        ahead = True
        for k in range(3):
            away = p[k, 2] / middle if middle > 0.0 else 1.0
            ahead &= away > 1e-6
            x[k], y[k] = (at_x + per_x * p[k, 0] / away, at_y + per_y * p[k, 1] / away) if away > 1e-6 else (0.0, 0.0)
        if middle > 0.0:
            # Three products with the ray through a texel, as triangles.py has them: their sum is one over its length
            volume = 0.0
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                edge[k, 0] = p[i, 1] * p[j, 2] - p[i, 2] * p[j, 1]
                edge[k, 1] = p[i, 2] * p[j, 0] - p[i, 0] * p[j, 2]
                edge[k, 2] = p[i, 0] * p[j, 1] - p[i, 1] * p[j, 0]
                volume += edge[k, 0] * p[k, 0] + edge[k, 1] * p[k, 1] + edge[k, 2] * p[k, 2]
            volume /= 3.0
            if volume == 0.0:
                continue
            for k in range(3):
                edge[k, 0] /= volume * middle * per_x
                edge[k, 1] /= volume * middle * per_y
                edge[k, 2] = edge[k, 2] / volume - edge[k, 0] * at_x - edge[k, 1] * at_y
        else:
            volume = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
            if volume == 0.0:
                continue
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                edge[k, 0], edge[k, 1] = (y[i] - y[j]) / volume, (x[j] - x[i]) / volume
                edge[k, 2] = (x[i] * y[j] - x[j] * y[i]) / volume
        for j in range(3):
            plane[j] = 0.0
            for k in range(3):
                plane[j] += edge[k, j] * (middle * middle if middle > 0.0 else p[k, 2])
        # Walk along the rows of texels that the triangle covers
        left, right, top, bottom = 0, side - 1, 0, side - 1
        if ahead:
            left, right = max(int(np.ceil(min(x[0], x[1], x[2]))), 0), int(np.floor(max(x[0], x[1], x[2])))
            top, bottom = max(int(np.ceil(min(y[0], y[1], y[2]))), 0), int(np.floor(max(y[0], y[1], y[2])))
            right, bottom = min(right, side - 1), min(bottom, side - 1)
        for row in range(top, bottom + 1):
            low, high = 1.0 * left, 1.0 * right
            for k in range(3):
                value = edge[k, 1] * row + edge[k, 2]
                if edge[k, 0] > 0.0:
                    low = max(low, -value / edge[k, 0])
                elif edge[k, 0] < 0.0:
                    high = min(high, -value / edge[k, 0])
                elif value < 0.0:
                    high = -1.0
            if not low <= high:
                continue
            first, last = int(np.ceil(low)), int(np.floor(high))
            if first > last:
                continue
            _widen(spans, row // 2, first, last, heights, passed)
            value = plane[1] * row + plane[2]
            if kind[t] == OPAQUE and middle == 0.0:
                for column in range(first, last + 1):
                    height = np.float32(plane[0] * column + value)
                    heights[0, row, column] = max(heights[0, row, column], height)
                    heights[1, row, column] = max(heights[1, row, column], -height)
                if len(passed):
                    for column in range(first, last + 1):
                        passed[row, column] = np.float32(0.0)
                continue
            for column in range(first, last + 1):
                height, alpha = plane[0] * column + value, 1.0
                if height > highest:
                    continue
                if kind[t] != OPAQUE:
                    for k in range(3):
                        weights[k] = edge[k, 0] * column + edge[k, 1] * row + edge[k, 2]
                    alpha = alpha_of(cuts[cut[t]], alphas, places, weights, change)
                    if (kind[t] == MASKED and alpha < cuts[cut[t], 9]) or (kind[t] == BLENDED and alpha <= 0.0):
                        continue
                heights[0, row, column] = max(heights[0, row, column], np.float32(height))
                heights[1, row, column] = max(heights[1, row, column], np.float32(-height))
                if len(passed):
                    passed[row, column] *= np.float32(1.0 - min(alpha, 1.0) if kind[t] == BLENDED else 0.0)


@exact
def _widen(spans: Any, pair: Any, first: Any, last: Any, heights: Any, passed: Any) -> None:
    """Widen the span of two rows to texels from `first` to `last`, which are empty until they are drawn."""
    begin, end = spans[0, pair], spans[1, pair]
    if first >= begin and last <= end:
        return
    # The first span is new; later ones are joined to it
    if end < 0:
        begin, end = first, first - 1
    for row in range(2 * pair, 2 * pair + 2):
        for side in range(2):
            one, other = (min(first, begin), begin) if side == 0 else (end + 1, max(last, end) + 1)
            for column in range(one, other):
                heights[0, row, column] = heights[1, row, column] = _LOWEST
                if len(passed):
                    passed[row, column] = np.float32(1.0)
    spans[0, pair], spans[1, pair] = min(first, begin), max(last, end)


@fast
def _sum_levels(heights: Any, passed: Any, spans: Any, lowest: Any, columns: Any) -> None:
    """Set the columns of a slot (n, 4), which are zero, and their levels. heights ... spans: of `_draw`, whose spans
    are overwritten. lowest: height [m] above which the slot has them.
    """
    size, quarter, base = heights.shape[1] // 2, np.float32(0.25), np.float32(lowest)
    zero, one = np.float32(0.0), np.float32(1.0)
    # Mean of 2 x 2 texels
    for r in range(size):
        first, last = spans[0, r] // 2, spans[1, r] // 2
        for c in range(first, last + 1):
            filled = top = bottom = opacity = zero
            for k in range(4):
                i, j = 2 * r + k // 2, 2 * c + k % 2
                if spans[0, r] <= j <= spans[1, r] and heights[0, i, j] > np.float32(-1e8):
                    filled += one
                    top += heights[0, i, j] - base
                    bottom -= heights[1, i, j] + base
                    opacity += one - passed[i, j] if len(passed) else one
            at = r * size + c
            columns[at, 0], columns[at, 1] = quarter * filled, quarter * top
            columns[at, 2], columns[at, 3] = quarter * bottom, quarter * opacity
        spans[0, r], spans[1, r] = first, last
    # Means of those, level by level
    begin = 0
    while size > SMALLEST:
        above, half = begin + size * size, size // 2
        for r in range(half):
            first = min(spans[0, 2 * r], spans[0, 2 * r + 1]) // 2
            last = max(spans[1, 2 * r], spans[1, 2 * r + 1]) // 2
            for c in range(first, last + 1):
                one_row = begin + 2 * r * size + 2 * c
                next_row = one_row + size
                for k in range(4):
                    columns[above + r * half + c, k] = quarter * (
                        columns[one_row, k] + columns[one_row + 1, k] + columns[next_row, k] + columns[next_row + 1, k]
                    )
            spans[0, r], spans[1, r] = first, last
        begin, size = above, half
