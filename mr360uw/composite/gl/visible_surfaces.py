# SPDX-License-Identifier: Apache-2.0
"""Visible surfaces of a shot's pixels, as fragments that are shaded once each.

Every triangle has three vectors in the camera's axes: a ray d meets it where its products with them are not negative;
their sum is one over the distance. Triangles are listed, nearest first, by the blocks of 4 x 4 pixels that they may
cover. Rays through the corners and centres of a block's pixels find those that one smooth piece fills: one fragment
each. In the others all samples are traced, and those of a smooth piece near one plane form a fragment, as in
raycast/pixel_samples.py. The loops are compiled, on the processor: a driver in software takes three times as long for
the same, and the lists have to come from the processor in any case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.mesh.texture import WRAPS, Texture, alpha_at
from mr360uw.composite.sampling import (
    BLEND_LAYERS,
    GROUPS,
    NO_GAPS,
    PIXEL_FILTER,
    PLANE_TOLERANCE,
    WHOLE_PIXEL,
    Gaps,
    find_gaps,
    pattern,
)
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.tiles import NEAREST
from mr360uw.jit import exact, fast, inlined
from mr360uw.types import Floats, View

BLOCK = 4
"""Pixels along a block."""
_OPAQUE, _MASKED, _BLENDED = 0, 1, 2
_MODES = ("OPAQUE", "MASK", "BLEND")
_KEPT = 64
"""Objects and meshes of which the triangles are kept between frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Fragments:
    """n pieces of surface in p pixels, the pieces of a pixel in sequence.

    row, column: (p,) of the pixels, each once. first: (p,) index of the first piece of each. triangle: (n,) numbers.
    place: (n, 2) frame coordinates at which each piece is shaded. area: (n, 5) of the frame that it represents
    (`sampling.frame_areas`). weight: (n,) fraction of the pixel's samples. gaps: of the pixels covered partly.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    first: NDArray[np.int64]
    triangle: NDArray[np.int64]
    place: Floats
    area: Floats
    weight: Floats
    gaps: Gaps = NO_GAPS

    def __len__(self) -> int:
        return len(self.triangle)

    def pixel(self) -> NDArray[np.int64]:
        """Return the pixel (n,) of each piece."""
        return np.repeat(np.arange(len(self.row)), np.diff(np.append(self.first, len(self))))

    def sums(self, values: Floats) -> Floats:
        """Return the sums (p, c) of values (n, c) over the pieces of each pixel."""
        return np.add.reduceat(values, self.first, axis=0) if len(self) else values[:0]


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The visible surfaces of objects.

    layers: of fragments, nearest first, opaque ones last. first: number of each object's first triangle. facets: (T,
    10) of the triangles by number, three vectors as the module says, and the side that is shown.
    """

    layers: list[Fragments]
    first: NDArray[np.int64]
    facets: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class _Triangles:
    """Triangles (T,) of one object, as a camera sees them.

    facets: (T, 10). nearest: (T,) at least one over their distance. rectangle: (T, 4) of the pixels that they may
    cover, first and last column and row; the last row is before the first where they face away. Columns may run beyond
    the frame, around the seam.
    """

    facets: NDArray[np.float32]
    nearest: NDArray[np.float32]
    rectangle: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class _Looks:
    """What is the same in all poses of a mesh. kind: (T,) index of the alpha mode. two_sided: (T,). pieces: how many.

    cut: (T,) row of `cuts`, -1 for triangles without a mask. cuts: (m, 11) texture coordinates and alphas of the
    corners, cutoff, and index of the map, -1 for none. maps: those.
    """

    kind: NDArray[np.int8]
    two_sided: NDArray[np.bool_]
    pieces: int
    cut: NDArray[np.int32]
    cuts: NDArray[np.float64]
    maps: tuple[Texture, ...]


def find_surfaces(sampled: PartOf[Shot], objects: list[PlacedObject], cache: Cache) -> Surfaces:
    """Return the visible surfaces of objects. cache: what is kept of meshes and objects."""
    shot, keep = sampled.whole, max(_KEPT, len(objects))
    view = shot.view
    # Gather the triangles of all objects, numbered one after the other
    looks = [cache.of(_looks, placed.mesh.still, keep=keep) for placed in objects]
    of_view = PartOf(view, view)
    seen = [cache.of(_seen, placed, of_view, look, keep=keep) for placed, look in zip(objects, looks, strict=True)]
    first = np.cumsum([0, *(len(one.nearest) for one in seen)])
    facets = np.concatenate([np.zeros((0, 10), np.float32), *(one.facets for one in seen)])
    if len(facets) == 0:
        return Surfaces([], first[:-1], facets)
    pieces = np.cumsum([0, *(look.pieces for look in looks)])
    nearest, rectangle = (np.concatenate([getattr(one, name) for one in seen]) for name in ("nearest", "rectangle"))
    kind = np.concatenate([look.kind for look in looks])
    piece = np.concatenate(
        [placed.mesh.patch + start for placed, start in zip(objects, pieces.tolist(), strict=False)], dtype=np.int32
    )
    scene = facets, nearest, kind, piece, *_cutouts(looks, first)
    # List them by block, nearest first, and see which pixels they fill
    corner, bounds, members, masks = _blocks(rectangle, nearest, view)
    tables, eye = _ray_tables(view), np.float32(view.eye_m)
    slack = np.float32(PLANE_TOLERANCE * PIXEL_FILTER * np.pi / view.height)
    shown, reach = np.empty((len(corner), BLOCK * BLOCK), np.int32), np.zeros(len(members), np.uint16)
    step = np.float32(shot.draw.samples**-0.5)
    by_sample = shot.draw.shading == "sample"
    _classify(corner, bounds, members, masks, scene, tables, eye, slack, step, by_sample, shown, reach)
    # Trace the samples of the others; blended surfaces layer by layer, wherever they reach
    lists, optics = (corner, bounds, members, reach), (eye, slack, step, by_sample)
    layers, blended = [], np.zeros(0, np.int64)
    if np.any(kind == _BLENDED):
        clear = np.zeros((len(corner), BLOCK * BLOCK), np.bool_)
        _mark(bounds, members, reach, kind, clear)
        blended = np.flatnonzero(clear)
    while len(layers) < BLEND_LAYERS and len(blended):
        found = _traced(view, shot.draw.samples, blended, lists, scene, optics, len(layers))
        if len(found) == 0:
            break
        layers.append(found)
    whole, rest = np.flatnonzero(shown.reshape(-1) > 0), np.flatnonzero(shown.reshape(-1) < 0)
    traced = _traced(view, shot.draw.samples, rest, lists, scene, optics, -1)
    layers.append(_joined(_whole(corner, shown, whole), traced))
    return Surfaces(layers, first[:-1], facets)


def _looks(mesh: Mesh) -> _Looks:
    """Return what all poses of a mesh share."""
    modes = np.array([_MODES.index(m.alpha_mode) for m in mesh.materials], np.int8)
    two_sided = np.array([m.double_sided for m in mesh.materials])
    kind, masked = modes[mesh.material], np.flatnonzero(modes[mesh.material] == _MASKED)
    cut = np.full(len(kind), -1, np.int32)
    cut[masked] = np.arange(len(masked))
    maps = tuple(
        dict.fromkeys(m.base_map for m in mesh.materials if m.alpha_mode == "MASK" and m.base_map is not None)
    )
    number = np.array([-1 if m.base_map not in maps else maps.index(m.base_map) for m in mesh.materials])
    factor = np.array([m.base_color[3] for m in mesh.materials])
    cutoff, material = np.array([m.alpha_cutoff for m in mesh.materials]), mesh.material[masked]
    cuts = np.column_stack(
        [
            mesh.uv[masked].reshape(-1, 6), factor[material, None] * mesh.colors[masked, :, 3],
            cutoff[material], number[material],
        ]
    )  # fmt: skip
    return _Looks(kind, two_sided[mesh.material], int(mesh.patch.max(initial=-1)) + 1, cut, cuts, maps)


def _seen(placed: PlacedObject, of_view: PartOf[View], looks: _Looks) -> _Triangles:
    """Return the triangles of an object as the camera of a view sees them."""
    view, positions = of_view.whole, placed.mesh.positions
    count = len(positions)
    matrix = np.empty((3, 4))
    matrix[:, :3] = view.world_from_camera.T @ placed.world_from_object[:3, :3]
    matrix[:, 3] = view.world_from_camera.T @ (placed.world_from_object[:3, 3] - view.position)
    facets, nearest = np.zeros((count, 10), np.float32), np.zeros(count, np.float32)
    rectangle = np.empty((count, 4), np.int32)
    size = float(view.width), float(view.height)
    _project(np.asarray(positions, np.float64), matrix, looks.two_sided, size, float(view.eye_m), facets, nearest,
             rectangle)  # fmt: skip
    return _Triangles(facets, nearest, rectangle)


def _cutouts(looks: Sequence[_Looks], first: NDArray[np.int64]) -> tuple[Any, ...]:
    """Return the tables of masks that kernels read: rows of `cuts` by triangle, those, alphas of all levels of all maps,
    and the place of each map among them: address, width, height, wrap along both.
    """
    start = np.cumsum([0, *(len(look.cuts) for look in looks)])
    maps = list(dict.fromkeys(texture for look in looks for texture in look.maps))
    cut, cuts = np.full(int(first[-1]), -1, np.int32), np.zeros((max(int(start[-1]), 1), 11))
    alphas, places, address = [np.zeros(1, np.float32)], np.zeros((max(len(maps), 1), 5), np.int64), 1
    for look, begin, row in zip(looks, first, start, strict=False):
        if len(look.cuts) == 0:
            continue
        cut[begin : begin + len(look.cut)] = np.where(look.cut >= 0, look.cut + row, -1)
        cuts[row : row + len(look.cuts)] = look.cuts
        number = np.array([*(maps.index(texture) for texture in look.maps), -1])
        cuts[row : row + len(look.cuts), 10] = number[look.cuts[:, 10].astype(np.int64)]
    for place, texture in zip(places, maps, strict=False):
        place[:] = address, *texture.size, *(WRAPS.index(wrap) for wrap in texture.wrap)
        alphas += [level[..., 3].astype(np.float32).ravel() for level in texture.levels]
        address += sum(level.shape[0] * level.shape[1] for level in texture.levels)
    return cut, cuts, np.concatenate(alphas), places


def _ray_tables(view: View) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (cosine, sine) of the longitudes of the left sides of columns, then of their middles, (2, 2, W + 8), and
    of the latitudes of rows (2, 2, H + 8).
    """
    column, row = (np.arange(n + 2 * BLOCK) + np.array([[0.0], [0.5]]) for n in (view.width, view.height))
    angles = 2.0 * np.pi * (column / view.width - 0.5), np.pi * (0.5 - row / view.height)
    longitude, latitude = (np.stack([np.cos(a), np.sin(a)]).astype(np.float32) for a in angles)
    return longitude, latitude


def _blocks(rectangle: NDArray[np.int32], nearest: NDArray[np.float32], view: View) -> tuple[Any, ...]:
    """Return the n blocks that triangles may cover: column and row (n, 2) of their first pixel, bounds (n + 1,) of
    their lists, and the lists (m,): triangles, nearest first, and a bit for each pixel that they may cover.
    """
    numbers = np.flatnonzero(rectangle[:, 3] >= rectangle[:, 1])
    numbers = numbers[np.argsort(-nearest[numbers], kind="stable")]
    across, down = -(-view.width // BLOCK), -(-view.height // BLOCK)
    place = np.zeros(across * down + 1, np.int32)
    _count_blocks(rectangle, numbers, view.width, across, place)
    there = np.flatnonzero(place[1:])
    np.cumsum(place, out=place)
    bounds = np.append(place[there], place[-1]).astype(np.int64)
    members, masks = np.empty(place[-1], np.int32), np.empty(place[-1], np.uint16)
    _fill_blocks(rectangle, numbers, view.width, across, place, members, masks)
    return BLOCK * np.stack([there % across, there // across], axis=-1), bounds, members, masks


def _whole(corner: NDArray[np.int64], shown: NDArray[np.int32], at: NDArray[np.int64]) -> Fragments:
    """Return the fragments of pixels that one smooth piece fills. at: (p,) 16 times their block, and place in it."""
    block, within = at // (BLOCK * BLOCK), at % (BLOCK * BLOCK)
    column, row = corner[block, 0] + within % BLOCK, corner[block, 1] + within // BLOCK
    place, number = np.stack([column, row], axis=-1) + 0.5, shown.reshape(-1)[at].astype(np.int64) - 1
    area, weight = np.tile(WHOLE_PIXEL, (len(at), 1)), np.ones(len(at))
    return Fragments(row, column, np.arange(len(at)), number, place, area, weight)


def _traced(
    view: View, count: int, at: NDArray[np.int64], lists: tuple[Any, ...], scene: Any, optics: Any, layer: int
) -> Fragments:
    """Return the fragments of pixels of which all samples are traced. at: as of `_whole`. layer: of blended surfaces,
    -1 for the others.
    """
    samples, by_sample = pattern(count), optics[-1]
    most = count if by_sample else GROUPS
    # Pad the samples with copies of the last one, to whole vectors of eight
    padded = np.minimum(np.arange(-(-count // 8) * 8), count - 1)
    angles = samples.positions[padded] * (2.0 * np.pi / view.width, -np.pi / view.height)
    turns = np.stack([np.cos(angles), np.sin(angles)], axis=0).astype(np.float32).transpose(2, 0, 1)
    positions, (x, y) = samples.positions[padded].T.astype(np.float32), samples.cells[padded].T
    cells, real = np.stack([x, y, x * x, x * y, y * y]).astype(np.float32), (np.arange(len(x)) < count).astype(np.float32)
    # Room for as many fragments as there may be: memory that is not written is not taken
    capacity = len(at) * most
    pixels, first = np.empty((2, len(at)), np.int64), np.empty(len(at), np.int64)
    triangle, place = np.empty(capacity, np.int64), np.empty((capacity, 2))
    area, weight = np.empty((capacity, 5)), np.empty(capacity)
    filled, covered = np.empty(len(at), np.int64), np.empty((len(at), count), np.bool_)
    there, total = _trace(
        at, lists, scene, _ray_tables(view), (turns, cells, positions, real, samples.step), optics, count, layer,
        (pixels, first, triangle, place, area, weight, filled, covered),
    )  # fmt: skip
    row, column = pixels[:, :there]
    partly = np.flatnonzero(filled[:there] < count)
    gaps = find_gaps(samples, row[partly], column[partly], covered[partly])
    kept = (values[:total].copy() for values in (triangle, place, area, weight))
    return Fragments(row.copy(), column.copy(), first[:there].copy(), *kept, gaps)


def _joined(one: Fragments, other: Fragments) -> Fragments:
    """Return the fragments of two disjoint sets of pixels, of which the first has no gaps."""
    pairs = {
        name: np.concatenate([getattr(one, name), getattr(other, name)])
        for name in ("row", "column", "triangle", "place", "area", "weight")
    }
    return Fragments(first=np.concatenate([one.first, other.first + len(one)]), gaps=other.gaps, **pairs)


# --- triangles in the frame ------------------------------------------------------------------------------------------

_MARGIN = 0.02
"""Pixels added around the rectangle of a triangle, for rounding in single precision."""
_LEAST_M = 1e-5
"""Least distance [m] between an eye's viewpoints and the plane of a triangle, in which rays cannot be intersected."""


_LARGEST = 1e30
"""Largest square [1/m^2] of one over the distance to a triangle's plane: slivers seen edge-on are left out."""


@exact
def _project(
    positions: Any, matrix: Any, two_sided: Any, size: Any, eye: Any, facets: Any, nearest: Any, rectangle: Any
) -> None:
    """Set the arrays of `_Triangles`. positions: (T, 3, 3) of a mesh, matrix: (3, 4) from its axes to the camera's.
    eye: [m] to the right of the middle of a stereo camera, 0 for one camera.
    """
    width, height = size
    p = np.empty((3, 3))
    for t in range(len(positions)):
        rectangle[t, 0], rectangle[t, 1], rectangle[t, 2], rectangle[t, 3] = 0, 0, -1, -1
        for k in range(3):
            for j in range(3):
                p[k, j] = matrix[j, 3]
                for i in range(3):
                    p[k, j] += matrix[j, i] * positions[t, k, i]
        # Leave out what faces away; an eye sees around a triangle that the middle sees edge-on
        nx, ny, nz = _cross(p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2],
                            p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2])  # fmt: skip
        long = np.sqrt(nx * nx + ny * ny + nz * nz)
        volume = nx * p[0, 0] + ny * p[0, 1] + nz * p[0, 2]
        if eye != 0.0 and long > 0.0 and abs(volume) < _LEAST_M * long:
            shift = (-_LEAST_M if volume < 0.0 else _LEAST_M) / long
            for k in range(3):
                p[k, 0] += shift * nx
                p[k, 1] += shift * ny
                p[k, 2] += shift * nz
            volume = nx * p[0, 0] + ny * p[0, 1] + nz * p[0, 2]
        if volume == 0.0 or not (volume < abs(eye) * long or two_sided[t]):
            continue
        # Three vectors for the intersection with rays, and the least distance
        plane_x = plane_y = plane_z = 0.0
        edge, corner = 0.0, 1e300
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            x, y, z = _cross(p[i, 0], p[i, 1], p[i, 2], p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2])
            x, y, z = x / volume, y / volume, z / volume
            facets[t, 3 * k], facets[t, 3 * k + 1], facets[t, 3 * k + 2] = x, y, z
            plane_x, plane_y, plane_z = plane_x + x, plane_y + y, plane_z + z
            edge = max(edge, (p[i, 0] - p[j, 0]) ** 2 + (p[i, 1] - p[j, 1]) ** 2 + (p[i, 2] - p[j, 2]) ** 2)
            corner = min(corner, p[k, 0] ** 2 + p[k, 1] ** 2 + p[k, 2] ** 2)
        facets[t, 9] = 0.0 if two_sided[t] else (1.0 if volume > 0.0 else -1.0)
        if not plane_x * plane_x + plane_y * plane_y + plane_z * plane_z < _LARGEST:
            continue
        # No point is farther from its nearest corner than the circumradius of the longest edge
        away = 1.0 / np.sqrt(plane_x * plane_x + plane_y * plane_y + plane_z * plane_z)
        near = 1.0 / (max(away, np.sqrt(corner) - 0.578 * np.sqrt(edge)) * (1.0 - 1e-5))
        left, top, right, bottom = _rectangle(p, volume, width, height)
        if eye != 0.0:
            ratio = abs(eye) * near
            if ratio > 1.0 / NEAREST:
                left, top, right, bottom = 0.0, 0.0, width, height
            else:
                beside, over = width * np.arcsin(ratio) / (2.0 * np.pi), height * ratio * ratio / np.pi
                left, right = left - (beside if eye > 0.0 else 0.0), right + (0.0 if eye > 0.0 else beside)
                top, bottom = top - over, bottom + over
            near /= np.sqrt(max(1.0 - ratio * ratio, 1e-6))
        nearest[t] = near
        left, right = np.floor(left - _MARGIN), np.floor(right + _MARGIN)
        if right - left >= width:
            left, right = 0.0, width - 1.0
        turn = width * np.floor(left / width)
        rectangle[t, 0], rectangle[t, 2] = left - turn, right - turn
        rectangle[t, 1] = min(max(np.floor(top - _MARGIN), 0.0), height - 1.0)
        rectangle[t, 3] = min(max(np.floor(bottom + _MARGIN), 0.0), height - 1.0)


@inlined
def _cross(ax: Any, ay: Any, az: Any, bx: Any, by: Any, bz: Any) -> Any:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@exact
def _rectangle(p: Any, volume: Any, width: Any, height: Any) -> Any:
    """Return (left, top, right, bottom) of a triangle (3, 3) in frame coordinates, exact, as tiles.py has it of bodies.

    volume: of the triangle's corners, a.(b x c).
    """
    south, north, over, under, turn, low, high, before = 1.0, -1.0, True, True, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        n = (k + 1) % 3
        sine = p[k, 1] / max(np.sqrt(p[k, 0] ** 2 + p[k, 1] ** 2 + p[k, 2] ** 2), 1e-300)
        south, north = min(south, sine), max(north, sine)
        # The great circle of an edge is highest at `highest`, which counts where it lies between the corners
        x, y, z = _cross(p[k, 0], p[k, 1], p[k, 2], p[n, 0], p[n, 1], p[n, 2])
        after, ahead = p[k, 0] * z - p[k, 2] * x, p[n, 2] * x - p[n, 0] * z
        highest = np.sqrt(max(1.0 - y * y / max(x * x + y * y + z * z, 1e-300), 0.0))
        if after > 0.0 and ahead > 0.0:
            north = max(north, highest)
        if after < 0.0 and ahead < 0.0:
            south = min(south, -highest)
        over, under = over and y >= 0.0, under and y <= 0.0
        # Longitudes, each as near to the one before as possible
        longitude = np.arctan2(p[k, 0], -p[k, 2])
        if k > 0:
            turn += 2.0 * np.pi * np.floor((before - longitude - turn) / (2.0 * np.pi) + 0.5)
        before = longitude + turn
        low, high = (before, before) if k == 0 else (min(low, before), max(high, before))
    pole = 0.0
    if over or under:  # the pole's ray is on one side of all edges
        pole = volume * (
            (p[1, 2] - p[0, 2]) * (p[2, 0] - p[0, 0]) - (p[1, 0] - p[0, 0]) * (p[2, 2] - p[0, 2])
        )
    top = 0.0 if pole > 0.0 else height * (0.5 - np.arcsin(min(max(north, -1.0), 1.0)) / np.pi)
    bottom = height if pole < 0.0 else height * (0.5 - np.arcsin(min(max(south, -1.0), 1.0)) / np.pi)
    if pole != 0.0:
        return 0.0, top, width, bottom
    return width * (low / (2.0 * np.pi) + 0.5), top, width * (high / (2.0 * np.pi) + 0.5), bottom


@exact
def _count_blocks(rectangle: Any, numbers: Any, width: Any, across: Any, count: Any) -> None:
    """Add to count (blocks + 1,) the triangles of the block before, of those of some numbers (t,)."""
    for t in numbers:
        for part in range(2 if rectangle[t, 2] >= width else 1):
            first, last = _span(rectangle[t, 0], rectangle[t, 2], width, part)
            for r in range(rectangle[t, 1] // BLOCK, rectangle[t, 3] // BLOCK + 1):
                for c in range(first // BLOCK, last // BLOCK + 1):
                    count[r * across + c + 1] += 1


@inlined
def _span(first: Any, last: Any, width: Any, part: Any) -> Any:
    """Return the first and the last column of a part of a rectangle: before the seam, or behind it."""
    return (0 if part else first), (last - width if part else min(last, width - 1))


@exact
def _fill_blocks(rectangle: Any, numbers: Any, width: Any, across: Any, place: Any, members: Any, masks: Any) -> None:
    """Write triangles, and the bits of the pixels that they may cover, into the lists of the blocks, from place
    (blocks,) on, which moves along.
    """
    for t in numbers:
        for part in range(2 if rectangle[t, 2] >= width else 1):
            first, last = _span(rectangle[t, 0], rectangle[t, 2], width, part)
            for r in range(rectangle[t, 1] // BLOCK, rectangle[t, 3] // BLOCK + 1):
                top, bottom = max(rectangle[t, 1] - BLOCK * r, 0), min(rectangle[t, 3] - BLOCK * r, BLOCK - 1)
                for c in range(first // BLOCK, last // BLOCK + 1):
                    left, right = max(first - BLOCK * c, 0), min(last - BLOCK * c, BLOCK - 1)
                    bits = 0
                    for row in range(top, bottom + 1):
                        bits |= ((2 << right) - (1 << left)) << (BLOCK * row)
                    n = place[r * across + c]
                    members[n], masks[n] = t, bits
                    place[r * across + c] = n + 1


# --- pixels that one smooth piece fills ------------------------------------------------------------------------------

_WIDE = 8
"""Numbers in a row of a block's grid of rays: corners and centres of pixels, of which the others are not used."""
_CORNERS = (BLOCK + 1) * _WIDE
_PROBES = _CORNERS + BLOCK * _WIDE
_APART = np.float32(4.0)
"""Tolerances in front of a piece from which on a surface of the same piece is another part of it."""


@inlined
def _meet(rays: Any, facet: Any, eye: Any, met: Any) -> None:
    """Set `met` (3, n): products of a facet's vectors with rays (3, n). Rays of an eye start on the viewing circle
    (types/frames.py): their start, over their distance, is added to their direction.
    """
    ax, ay, az, bx, by, bz = facet[0], facet[1], facet[2], facet[3], facet[4], facet[5]
    cx, cy, cz, side = facet[6], facet[7], facet[8], facet[9]
    if eye == np.float32(0.0):
        for i in range(rays.shape[1]):
            x, y, z = rays[0, i], rays[1, i], rays[2, i]
            met[0, i] = ax * x + ay * y + az * z
            met[1, i] = bx * x + by * y + bz * z
            met[2, i] = cx * x + cy * y + cz * z
    else:
        px, py, pz = ax + bx + cx, ay + by + cy, az + bz + cz
        for i in range(rays.shape[1]):
            x, y, z = rays[0, i], rays[1, i], rays[2, i]
            room = np.float32(1.0) - eye * (pz * x - px * z)
            if abs(room) < np.float32(1e-9):
                room = np.float32(1e-9) if room >= np.float32(0.0) else np.float32(-1e-9)
            along = eye * (px * x + py * y + pz * z) / room
            # turned away from where it would meet the back, if only one side is shown
            shown = np.float32(1.0) if side * room <= np.float32(0.0) else np.float32(-1.0)
            x, y, z = shown * (x - along * z), shown * y, shown * (z + along * x)
            met[0, i] = ax * x + ay * y + az * z
            met[1, i] = bx * x + by * y + bz * z
            met[2, i] = cx * x + cy * y + cz * z


@inlined
def _keep_nearest(met: Any, number: Any, best: Any, who: Any) -> None:
    """Note a triangle's number in a list as the hit of the rays (n,) for which it is the nearest."""
    zero = np.float32(0.0)
    for i in range(met.shape[1]):
        value = met[0, i] + met[1, i] + met[2, i] if min(met[0, i], min(met[1, i], met[2, i])) >= zero else zero
        before = best[i]
        who[i] = number if value > before else who[i]
        best[i] = max(value, before)


@inlined
def _off(facet: Any, x: Any, y: Any, z: Any, eye: Any, near: Any) -> Any:
    """Return how far the end of a ray of one over its length `near` is from a facet's plane, over that."""
    px, py, pz = facet[0] + facet[3] + facet[6], facet[1] + facet[4] + facet[7], facet[2] + facet[5] + facet[8]
    along = eye * near
    return abs(px * (x - along * z) + py * y + pz * (z + along * x) - near)


@inlined
def _tolerance(facet: Any, slack: Any, near: Any) -> Any:
    """Return the distance from a facet's plane within which hits are shaded together, over the length of rays."""
    px, py, pz = facet[0] + facet[3] + facet[6], facet[1] + facet[4] + facet[7], facet[2] + facet[5] + facet[8]
    return slack / near * np.sqrt(px * px + py * py + pz * pz)


@exact
def _alpha(cuts: Any, alphas: Any, places: Any, weights: Any, change: Any) -> Any:
    """Return the alpha of a masked triangle at weights (3,) of its corners. change: (2, 2) of (u, v) over a pixel."""
    total = max(weights[0] + weights[1] + weights[2], 1e-30)
    alpha = u = v = 0.0
    for k in range(3):
        w = min(max(weights[k] / total, 0.0), 1.0)
        u, v, alpha = u + w * cuts[2 * k], v + w * cuts[2 * k + 1], alpha + w * cuts[6 + k]
    if cuts[10] >= 0.0:
        alpha *= alpha_at(alphas, places[int(cuts[10])], u, v, change)
    return alpha


@exact
def _uv_change(cuts: Any, facet: Any, eye: Any, ray: Any, near: Any, change: Any) -> None:
    """Set the change (2, 2) of (u, v) of a masked triangle to rays beside one, by columns and rows.

    ray: (3, 3) room for the ray and those beside it, near: (2, 3, 3) room for products.
    """
    _meet(ray, facet, eye, near)
    here = np.zeros(2)
    for n in range(3):
        total = near[0, n] + near[1, n] + near[2, n]
        total = total if abs(total) > 1e-30 else np.float32(1e-30)
        for j in range(2):
            value = 0.0
            for k in range(3):
                value += near[k, n] / total * cuts[2 * k + j]
            if n == 0:
                here[j] = value
            else:
                change[n - 1, j] = min(max(value - here[j], -1e3), 1e3)


@fast
def _classify(
    corner: Any, bounds: Any, members: Any, masks: Any, scene: Any, tables: Any, eye: Any, slack: Any, step: Any,
    by_sample: Any, shown: Any, reach: Any,
) -> None:  # fmt: skip
    """Set what the pixels of blocks show, (n, 16): the number of a triangle + 1 where its smooth piece fills the pixel,
    0 where nothing reaches into it, -1 otherwise; and the bits of the pixels that each member of a list reaches into.

    step: distance [pixels] of samples. by_sample: none is filled.
    """
    facets, _, kind, piece, cut, cuts, alphas, places = scene
    longitude, latitude = tables
    most = 0
    for b in range(len(corner)):
        most = max(most, bounds[b + 1] - bounds[b])
    rays, met = np.zeros((3, _PROBES), np.float32), np.zeros((3, _PROBES), np.float32)
    near = np.zeros((most, _PROBES), np.float32)
    best, who = np.zeros(_PROBES, np.float32), np.zeros(_PROBES, np.float32)
    zero, bit = np.float32(0.0), np.zeros(BLOCK * _WIDE, np.float32)
    for p in range(BLOCK * BLOCK):
        bit[_WIDE * (p // BLOCK) + p % BLOCK] = np.float32(1 << p)
    for b in range(len(corner)):
        # Aim rays at the corners of pixels and at their centres
        for r in range(BLOCK + 1):
            for c in range(_WIDE):
                i, column, row = _WIDE * r + c, corner[b, 0] + c, corner[b, 1] + r
                rays[0, i] = latitude[0, 0, row] * longitude[1, 0, column]
                rays[1, i] = latitude[1, 0, row]
                rays[2, i] = -latitude[0, 0, row] * longitude[0, 0, column]
                if r < BLOCK:
                    i += _CORNERS
                    rays[0, i] = latitude[0, 1, row] * longitude[1, 1, column]
                    rays[1, i] = latitude[1, 1, row]
                    rays[2, i] = -latitude[0, 1, row] * longitude[0, 1, column]
        for i in range(_PROBES):
            best[i] = zero
        # Intersect them with the members; note which pixels each reaches into
        touched = 0
        for m in range(bounds[b], bounds[b + 1]):
            t, k = members[m], m - bounds[b]
            number = np.float32(k)
            _meet(rays, facets[t], eye, met)
            if kind[t] == _OPAQUE:
                _keep_nearest(met, number, best, who)
            elif kind[t] == _MASKED:
                _mask_probes(corner[b], facets[t], cuts[cut[t]], alphas, places, tables, eye, step, met, number, best,
                             who)  # fmt: skip
            for i in range(_CORNERS):
                near[k, i] = max(met[0, i] + met[1, i] + met[2, i], zero)
            bits = zero
            for i in range(BLOCK * _WIDE):
                u = max(max(met[0, i], met[0, i + 1]), max(met[0, i + _WIDE], met[0, i + _WIDE + 1]))
                v = max(max(met[1, i], met[1, i + 1]), max(met[1, i + _WIDE], met[1, i + _WIDE + 1]))
                w = max(max(met[2, i], met[2, i + 1]), max(met[2, i + _WIDE], met[2, i + _WIDE + 1]))
                bits += bit[i] if min(u, min(v, w)) >= zero else zero
            reach[m] = int(bits) & masks[m]
            touched |= int(reach[m]) if kind[t] != _BLENDED else 0
        # A pixel is filled if its corners show the plane of its centre, and nothing else reaches in before it
        for p in range(BLOCK * BLOCK):
            shown[b, p] = -((touched >> p) & 1)
            i = _WIDE * (p // BLOCK) + p % BLOCK
            depth = best[_CORNERS + i]
            if by_sample or shown[b, p] == 0 or depth == zero:
                continue
            k = int(who[_CORNERS + i])
            t, whole = members[bounds[b] + k], True
            room = _tolerance(facets[t], slack, depth)
            for j in range(4):
                at = i + j % 2 + _WIDE * (j // 2)
                if best[at] == zero or piece[members[bounds[b] + int(who[at])]] != piece[t]:
                    whole = False
                elif _off(facets[t], rays[0, at], rays[1, at], rays[2, at], eye, best[at]) > room * best[at]:
                    whole = False
            if not whole:
                continue
            thinner = np.float32(1.0) - _APART * room
            a0, a1, a2, a3 = near[k, i], near[k, i + 1], near[k, i + _WIDE], near[k, i + _WIDE + 1]
            for m in range(bounds[b], bounds[b + 1]):
                j = m - bounds[b]
                if (reach[m] >> p) & 1 == 0 or j == k or kind[members[m]] == _BLENDED:
                    continue
                factor = thinner if piece[members[m]] == piece[t] else np.float32(1.0)
                if (near[j, i] * factor > a0 or near[j, i + 1] * factor > a1 or near[j, i + _WIDE] * factor > a2
                        or near[j, i + _WIDE + 1] * factor > a3):  # fmt: skip
                    whole = False
                    break
            if whole:
                shown[b, p] = t + 1


@exact
def _mask_probes(
    corner: Any, facet: Any, cuts: Any, alphas: Any, places: Any, tables: Any, eye: Any, step: Any, met: Any,
    number: Any, best: Any, who: Any,
) -> None:  # fmt: skip
    """Note a masked triangle as the hit of the rays of a block for which it is solid: well above its cutoff."""
    longitude, latitude = tables
    ray, near, change, weights = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32), np.zeros((2, 2)), np.empty(3)
    for n in range(3):
        column, row = corner[0] + BLOCK // 2 + (step if n == 1 else 0.0), corner[1] + BLOCK // 2 + (step if n == 2 else 0.0)
        width, height = longitude.shape[2] - 2 * BLOCK, latitude.shape[2] - 2 * BLOCK
        lon, lat = 2.0 * np.pi * (column / width - 0.5), np.pi * (0.5 - row / height)
        ray[0, n], ray[1, n], ray[2, n] = np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)
    _uv_change(cuts, facet, eye, ray, near, change)
    for i in range(len(best)):
        value = met[0, i] + met[1, i] + met[2, i]
        if min(met[0, i], met[1, i], met[2, i]) >= 0.0 and value > best[i] and i % _WIDE <= BLOCK:
            for k in range(3):
                weights[k] = met[k, i]
            if _alpha(cuts, alphas, places, weights, change) >= 0.5 * (1.0 + cuts[9]):
                best[i], who[i] = value, number


@exact
def _mark(bounds: Any, members: Any, reach: Any, kind: Any, clear: Any) -> None:
    """Mark the pixels (n, 16) of blocks that blended surfaces reach into."""
    for b in range(len(bounds) - 1):
        for m in range(bounds[b], bounds[b + 1]):
            if kind[members[m]] == _BLENDED:
                for p in range(BLOCK * BLOCK):
                    clear[b, p] |= (reach[m] >> p) & 1 == 1


# --- pixels with edges -----------------------------------------------------------------------------------------------


@fast
def _trace(
    at: Any, lists: Any, scene: Any, tables: Any, pattern_: Any, optics: Any, count: Any, layer: Any, out: Any
) -> Any:
    """Write the fragments of pixels at (p,), as of `_whole`, and return the number of pixels that have any and of
    fragments.

    pattern_: (cosine, sine) of the angles of longitude and latitude of samples from a pixel's corner, (2, 2, s), their
    cells with products (5, s), positions (2, s), and 1 for the `count` of them that are no copies; axes of `_set_area`. layer: number of the blended
    surface from the front, -1 for the nearest of the others. out: arrays of `Fragments`, then covered samples of each
    pixel (p,), (p, count).
    """
    corner, bounds, members, reach = lists
    facets, nearest, kind, piece, cut, cuts, alphas, places = scene
    (longitude, latitude), (turns, cells, positions, real, axes), (eye, slack, step, by_sample) = tables, pattern_, optics
    pixels, first, triangle, place, area, weight, filled, covered = out
    n, zero, big = turns.shape[2], np.float32(0.0), np.float32(1e30)
    rays, met = np.empty((3, n), np.float32), np.empty((3, n), np.float32)
    # Arrays of their own: rows of one would have to be taken for overlapping
    best, wall, limit, who = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    part, free, mine = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    most, block = 1, -1
    for b in range(len(bounds) - 1):
        most = max(most, bounds[b + 1] - bounds[b])
    pieces, numbers = np.empty(most, np.float32), np.arange(n).astype(np.float32)
    change, weights, room3, near3 = np.zeros((2, 2)), np.empty(3), np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
    cos_step, sin_step = np.empty(2, np.float32), np.empty(2, np.float32)
    width, height = longitude.shape[2] - 2 * BLOCK, latitude.shape[2] - 2 * BLOCK
    for j in range(2):
        angle = step * (2.0 * np.pi / width if j == 0 else -np.pi / height)
        cos_step[j], sin_step[j] = np.cos(angle), np.sin(angle)
    there = found = 0
    for e in range(len(at)):
        b, p = at[e] // (BLOCK * BLOCK), at[e] % (BLOCK * BLOCK)
        column, row = corner[b, 0] + p % BLOCK, corner[b, 1] + p // BLOCK
        # Aim a ray at every sample
        lon_c, lon_s, lat_c, lat_s = longitude[0, 0, column], longitude[1, 0, column], latitude[0, 0, row], latitude[1, 0, row]
        for i in range(n):
            x, y = lon_c * turns[0, 0, i] - lon_s * turns[0, 1, i], lon_s * turns[0, 0, i] + lon_c * turns[0, 1, i]
            c, s = lat_c * turns[1, 0, i] - lat_s * turns[1, 1, i], lat_s * turns[1, 0, i] + lat_c * turns[1, 1, i]
            rays[0, i], rays[1, i], rays[2, i] = c * y, s, -c * x
        # Find the nearest solid surface, then as many blended ones in front of it as the layer asks for
        for turn in range(layer + 2):
            for i in range(n):
                who[i] = zero
                behind = best[i] / (np.float32(1.0 + 4e-6) + np.float32(1e-7) * best[i])
                limit[i] = big if turn < 2 else (behind if best[i] > wall[i] else zero)
                wall[i] = best[i] if turn == 1 else wall[i]
                best[i] = wall[i] if turn > 0 else zero
            for m in range(bounds[b], bounds[b + 1]):
                t = members[m]
                if (reach[m] >> p) & 1 == 0 or (kind[t] == _BLENDED) != (turn > 0):
                    continue
                _meet(rays, facets[t], eye, met)
                if kind[t] == _MASKED:
                    # Close the triangle to the rays that its mask lets through
                    for k in range(3):
                        i = 1 if k == 1 else 0
                        j = 1 if k == 2 else 0
                        c, s = turns[0, 0, 0] * lon_c - turns[0, 1, 0] * lon_s, turns[0, 0, 0] * lon_s + turns[0, 1, 0] * lon_c
                        u, v = turns[1, 0, 0] * lat_c - turns[1, 1, 0] * lat_s, turns[1, 0, 0] * lat_s + turns[1, 1, 0] * lat_c
                        if i:
                            c, s = c * cos_step[0] - s * sin_step[0], s * cos_step[0] + c * sin_step[0]
                        if j:
                            u, v = u * cos_step[1] - v * sin_step[1], v * cos_step[1] + u * sin_step[1]
                        room3[0, k], room3[1, k], room3[2, k] = u * s, v, -u * c
                    _uv_change(cuts[cut[t]], facets[t], eye, room3, near3, change)
                    for i in range(n):
                        value = met[0, i] + met[1, i] + met[2, i]
                        if min(met[0, i], met[1, i], met[2, i]) >= zero and value > best[i]:
                            for k in range(3):
                                weights[k] = met[k, i]
                            if _alpha(cuts[cut[t]], alphas, places, weights, change) < cuts[cut[t], 9]:
                                met[0, i] = np.float32(-1.0)
                if turn > 0:
                    for i in range(n):
                        met[0, i] = met[0, i] if met[0, i] + met[1, i] + met[2, i] <= limit[i] else np.float32(-1.0)
                _keep_nearest(met, np.float32(m - bounds[b]), best, who)
                if turn == 0:
                    least = big
                    for i in range(n):
                        least = min(least, best[i])
                    if least >= nearest[t]:
                        break  # those that follow are farther away
        # Group the samples that show a smooth piece near a plane
        if b != block:
            block = b
            for m in range(bounds[b], bounds[b + 1]):
                pieces[m - bounds[b]] = np.float32(piece[members[m]])
        seen = zero
        for i in range(n):
            least = wall[i] if layer >= 0 else zero
            free[i] = real[i] if best[i] > least else zero
            seen += free[i]
        left = int(seen)
        if left == 0:
            continue
        for i in range(n):
            part[i] = pieces[int(who[i])]
        pixels[0, there], pixels[1, there], first[there], filled[there] = row, column, found, left
        if left < count:
            for i in range(count):
                covered[there, i] = free[i] > zero
        there += 1
        seed, number = 0, 0
        while left > 0:
            while free[seed] == zero:
                seed += 1
            t, own = members[bounds[b] + int(who[seed])], part[seed]
            room, last = _tolerance(facets[t], slack, best[seed]), number == GROUPS - 1
            px = facets[t, 0] + facets[t, 3] + facets[t, 6]
            py = facets[t, 1] + facets[t, 4] + facets[t, 7]
            pz = facets[t, 2] + facets[t, 5] + facets[t, 8]
            rank = seed
            if by_sample:
                free[seed] = zero
                left -= 1
                weight[found] = 1.0 / count
                area[found, 0] = area[found, 1] = area[found, 3] = 0.0
                area[found, 2] = area[found, 4] = 1.0 / np.sqrt(np.float64(count))
            else:
                for i in range(n):
                    along = eye * best[i]
                    x, y, z = rays[0, i] - along * rays[2, i], rays[1, i], rays[2, i] + along * rays[0, i]
                    near = abs(px * x + py * y + pz * z - best[i]) <= room * best[i]
                    mine[i] = free[i] if near & (part[i] == own) else zero
                if last:
                    for i in range(n):
                        mine[i] = free[i]
                mine[seed] = np.float32(1.0)  # whatever the rounding
                total = sum_x = sum_y = xx = xy = yy = zero
                for i in range(n):
                    w = mine[i]
                    free[i] -= w
                    total += w
                    sum_x += w * cells[0, i]
                    sum_y += w * cells[1, i]
                    xx += w * cells[2, i]
                    xy += w * cells[3, i]
                    yy += w * cells[4, i]
                left -= int(total)
                # The sample nearest to the mean stands for the group; in whole numbers, of which the last seven bits
                # are the sample's: single floats hold them exactly
                least = big
                for i in range(n):
                    value = total * (cells[2, i] + cells[4, i]) - np.float32(2.0) * (sum_x * cells[0, i] + sum_y * cells[1, i])
                    least = min(least, np.float32(128.0) * value + numbers[i] if mine[i] > zero else big)
                rank = int(least) & 127
                t = members[bounds[b] + int(who[rank])]
                weight[found] = total / count
                _set_area(np.float64(total), sum_x, sum_y, xx, xy, yy, axes, cells[0, rank], cells[1, rank], area[found])
            triangle[found] = t
            place[found, 0], place[found, 1] = column + positions[0, rank], row + positions[1, rank]
            found += 1
            number += 1
    return there, found


@exact
def _set_area(
    total: Any, x: Any, y: Any, xx: Any, xy: Any, yy: Any, axes: Any, at_x: Any, at_y: Any, area: Any
) -> None:
    """Set the area (5,) of `sampling.frame_areas` of samples with these sums of powers of their cells.

    axes: `Pattern.step`. at_x, at_y: cell of the sample that stands for all.
    """
    a, b = axes
    x, y = x / total, y / total
    xx, xy, yy = xx / total - x * x, xy / total - x * y, yy / total - y * y
    own = 1.0 / 12.0 * (a * a + b * b)
    # Turn the moments from the grid's axes to the frame's: x = a X - b Y, y = b X + a Y
    frame_xx = a * a * xx - 2.0 * a * b * xy + b * b * yy + own
    frame_yy = b * b * xx + 2.0 * a * b * xy + a * a * yy + own
    frame_xy = a * b * (xx - yy) + (a * a - b * b) * xy
    root = np.sqrt(max(frame_xx * frame_yy - frame_xy * frame_xy, own * own))
    scale = np.sqrt(12.0 / (frame_xx + frame_yy + 2.0 * root))
    x, y = x - at_x, y - at_y
    area[0], area[1] = a * x - b * y, b * x + a * y
    area[2], area[3], area[4] = (frame_xx + root) * scale, frame_xy * scale, (frame_yy + root) * scale
