# SPDX-License-Identifier: Apache-2.0
"""Triangles of objects as a camera sees them, and lists of those that may cover each block of 4 x 4 pixels.

Every triangle has three vectors in the camera's axes, its facet: a ray d meets it where its products with them are not
negative; their sum is one over the distance. A rectangle of pixels that holds what is seen of it is exact: longitudes
are those of corners, latitudes those of the arcs of great circles between them (composite/tiles.py has it of bodies).
It may cross the seam or run around the whole frame, so neither the seam nor the poles are special.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import PartOf
from mr360uw.composite.mesh.material import Texture
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject
from mr360uw.composite.tiles import NEAREST
from mr360uw.jit import exact, exact_making, inlined
from mr360uw.types import View

BLOCK = 4
"""Pixels along a block."""
OPAQUE, MASKED, BLENDED = 0, 1, 2
"""Kinds of triangles, by the alpha mode of their material."""
_MODES = ("OPAQUE", "MASK", "BLEND")


@dataclass(frozen=True, slots=True, eq=False)
class MeshLooks:
    """What is the same in all poses of a mesh. kind: (T,) index of the alpha mode. two_sided: (T,). pieces: how many.

    cut: (T,) row of `cuts`, -1 for opaque triangles. cuts: (m, 11) texture coordinates and alphas of the corners,
    cutoff of a mask, and index of the map, -1 for none. maps: those.
    """

    kind: NDArray[np.int8]
    two_sided: NDArray[np.bool_]
    pieces: int
    cut: NDArray[np.int32]
    cuts: NDArray[np.float64]
    maps: tuple[Texture, ...]


def mesh_looks(mesh: Mesh) -> MeshLooks:
    """Return what all poses of a mesh share."""
    modes = np.array([_MODES.index(m.alpha_mode) for m in mesh.materials], np.int8)
    two_sided = np.array([m.double_sided for m in mesh.materials])
    kind, clear = modes[mesh.material], np.flatnonzero(modes[mesh.material] != OPAQUE)
    cut = np.full(len(kind), -1, np.int32)
    cut[clear] = np.arange(len(clear))
    maps = tuple(
        dict.fromkeys(m.base_map for m in mesh.materials if m.alpha_mode != "OPAQUE" and m.base_map is not None)
    )
    number = np.array([-1 if m.base_map not in maps else maps.index(m.base_map) for m in mesh.materials])
    factor = np.array([m.base_color[3] for m in mesh.materials])
    cutoff, material = np.array([m.alpha_cutoff for m in mesh.materials]), mesh.material[clear]
    cuts = np.column_stack(
        [
            mesh.uv[clear].reshape(-1, 6), factor[material, None] * mesh.colors[clear, :, 3],
            cutoff[material], number[material],
        ]
    )  # fmt: skip
    return MeshLooks(kind, two_sided[mesh.material], int(mesh.patch.max(initial=-1)) + 1, cut, cuts, maps)


def seen_triangles(placed: PlacedObject, of_view: PartOf[View], looks: MeshLooks) -> tuple[NDArray[Any], ...]:
    """Return the triangles (T,) of an object as the camera of a view sees them: facets (T, 10); at least one over their
    distance (T,); and rectangles (T, 4) of the pixels that they may cover, first and last column and row. The last row
    is before the first where they face away. Columns may run beyond the frame, around the seam.
    """
    view, positions = of_view.whole, placed.mesh.positions
    count = len(positions)
    matrix = np.empty((3, 4))
    matrix[:, :3] = view.world_from_camera.T @ placed.world_from_object[:3, :3]
    matrix[:, 3] = view.world_from_camera.T @ (placed.world_from_object[:3, 3] - view.position)
    facets, nearest = np.zeros((count, 10), np.float32), np.zeros(count, np.float32)
    rectangle = np.empty((count, 4), np.int32)
    frame = float(view.width), float(view.height), float(view.eye_m)
    _project(np.asarray(positions, np.float64), matrix, looks.two_sided, frame, (facets, nearest, rectangle))
    return facets, nearest, rectangle


def make_blocks(rectangle: NDArray[np.int32], nearest: NDArray[np.float32], view: View) -> tuple[Any, ...]:
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


_MARGIN = 0.02
"""Pixels added around the rectangle of a triangle, for rounding in single precision."""
_LEAST_M = 1e-5
"""Least distance [m] between an eye's viewpoints and the plane of a triangle, in which rays cannot be intersected."""


_LARGEST = 1e30
"""Largest square [1/m^2] of one over the distance to a triangle's plane: slivers seen edge-on are left out."""


@exact_making
def _project(positions: Any, matrix: Any, two_sided: Any, frame: Any, seen: Any) -> None:
    """Set the arrays of `seen_triangles`, seen. positions: (T, 3, 3) of a mesh, matrix: (3, 4) from its axes to the
    camera's. frame: its width and height, and the eye [m] to the right of the middle of a stereo camera, 0 for one.
    """
    (width, height, eye), (facets, nearest, rectangle) = frame, seen
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
    """Return (left, top, right, bottom) of a triangle (3, 3) in frame coordinates.

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
        pole = volume * ((p[1, 2] - p[0, 2]) * (p[2, 0] - p[0, 0]) - (p[1, 0] - p[0, 0]) * (p[2, 2] - p[0, 2]))
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
