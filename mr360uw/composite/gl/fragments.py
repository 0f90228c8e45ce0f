# SPDX-License-Identifier: Apache-2.0
"""Fragments: shaded pieces of surface in pixels, their compositing into the tiles of a layer, and groups of them.

Where several small triangles meet in a pixel, each is a fragment of a few samples. Groups are neighbours on a body's
surface in one pixel, which share what they see of the sun. Shadow rays are cast once for all of them: from the fragment
with most samples, over the area of the group. Fragments that face away from the sun get none.

Most of a body sees all of the sun, or nothing of it. So rays are cast from every second pixel along rows and columns
first; a pixel between others of the same surface that all see the whole sun, or none, sees the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import PartOf
from mr360uw.composite.gl.visible_surfaces import Fragments
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.jit import exact
from mr360uw.types import Floats, Tile


@exact
def sum_behind(pieces: Any, values: Any, corner: Any, tile: Any) -> None:
    """Composite the fragments (n,) of pixels (p,) behind a tile.

    pieces: row, column, first and weight of `Fragments`. values: (n, 5) radiance, alpha and distance [m]. corner: row
    and column of the tile; tile: its radiance, alpha and distance. A pixel takes the sum of weight alpha times the
    radiance, and the least distance.
    """
    row, column, first, weight = pieces
    radiance, alpha, distance = tile
    for p in range(len(row)):
        r, c = row[p] - corner[0], column[p] - corner[1]
        if r < 0 or c < 0 or r >= alpha.shape[0] or c >= alpha.shape[1]:
            continue
        red, green, blue, cover, nearest = 0.0, 0.0, 0.0, 0.0, distance[r, c]
        for n in range(first[p], first[p + 1] if p + 1 < len(first) else len(weight)):
            share = weight[n] * values[n, 3]
            red += share * values[n, 0]
            green += share * values[n, 1]
            blue += share * values[n, 2]
            cover += share
            nearest = min(nearest, values[n, 4])
        free = 1.0 - alpha[r, c]
        radiance[r, c, 0] += free * red
        radiance[r, c, 1] += free * green
        radiance[r, c, 2] += free * blue
        alpha[r, c] += free * cover
        distance[r, c] = nearest


def through(tiles: Sequence[Tile], fragments: Fragments) -> Floats:
    """Return the transparency (p,) = 1 - alpha of tiles at the pixels of fragments."""
    free = np.ones(len(fragments.row), np.float32)
    for tile in tiles:
        rows, columns = tile.alpha.shape
        r, c = fragments.row - tile.row, fragments.column - tile.column
        inside = np.flatnonzero((r >= 0) & (r < rows) & (c >= 0) & (c < columns))
        free[inside] = 1.0 - tile.alpha[r[inside], c[inside]]
    return free


def add_behind(tiles: Sequence[Tile], fragments: Fragments, values: Floats) -> None:
    """Composite fragments behind the contents of tiles. values: (n, 5) radiance, alpha and distance [m]."""
    pieces = fragments.row, fragments.column, fragments.first, fragments.weight
    for tile in tiles:
        sum_behind(pieces, values, (tile.row, tile.column), (tile.radiance, tile.alpha, tile.distance_m))


_AT_ONCE = 1 << 19
_LayerOf = tuple[Sequence[PlacedObject], NDArray[np.int64], Fragments, Callable[[Mesh], NDArray[np.int64]]]
"""Objects, the number of each one's first triangle, a layer, and a function that returns the places (T,) of a mesh's triangles on the device."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshFragments:
    """Fragments of one mesh that are shaded together. chosen: (n,) numbers among all.

    listed: (n, 9) of each, triangle on the device, place (2), body and area (5) of `Fragments`. triangle: (n,) numbers
    of triangles among all. pixel: (n,) numbers, those of a pixel in sequence; weight: (n,) of `Fragments`.
    """

    mesh: Mesh
    chosen: NDArray[np.int64]
    listed: Floats
    triangle: NDArray[np.int64]
    pixel: NDArray[np.int64]
    weight: Floats


def mesh_fragments(layer: PartOf[_LayerOf], body: NDArray[np.int64]) -> list[MeshFragments]:
    """Return the fragments of a layer by mesh. body: (n,) of each."""
    objects, first, fragments, places = layer.whole
    pixel, triangle = fragments.pixel(), fragments.triangle - first[body]
    listed = np.concatenate([triangle[:, None], fragments.place, body[:, None], fragments.area], axis=1)
    meshes = list(dict.fromkeys(placed.mesh for placed in objects))
    of_mesh = np.array([meshes.index(placed.mesh) for placed in objects])[body]
    parts = []
    for k, mesh in enumerate(meshes):
        chosen = np.flatnonzero(of_mesh == k)
        listed[chosen, 0] = places(mesh)[triangle[chosen]]
        for start in range(0, len(chosen), _AT_ONCE):
            part = chosen[start : start + _AT_ONCE]
            numbers = fragments.triangle[part]
            parts.append(MeshFragments(mesh, part, listed[part], numbers, pixel[part], fragments.weight[part]))
    return parts


_APART = 0.4
"""Fragments of a group follow each other within this distance along the ray, in widths of a pixel. Chosen so that
99.99 % of the values that a layer changes stay within a code of those without groups, for two bodies and for twenty.
Twice as much casts a quarter fewer rays, and 99.986 % stay; half as much casts a fifth more."""
_BEND = 0.7
"""Least cosine between the normals of fragments that follow each other in a group."""


_NEAR = 0.01
"""Largest difference in distance, relative, of a pixel from those beside it whose sight of the sun it shares."""


@dataclass(frozen=True, slots=True, eq=False)
class SunGroups:
    """Groups of fragments of one mesh that see the same of the sun, m of them.

    of: (n,) group of each fragment, -1 for those that face away from the sun. listed: (m, 9) of each group what
    `MeshFragments` lists. surface: (m, 4) its unit normal and distance. first: (m,) whether rays are cast from it
    before `fill_between`.
    """

    of: NDArray[np.int64]
    listed: Floats
    surface: Floats
    first: NDArray[np.bool_]

    def fill_between(self, seen: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Set what groups see of the sun (m, k) that lie between others that see all or nothing, and return the groups
        (m,) from which rays are still to be cast.
        """
        column, row = np.floor(self.listed[:, 1:3]).astype(np.int64).T
        left = ~self.first
        if not np.any(left):
            return left
        row, column = row - row.min() // 2 * 2, column - column.min() // 2 * 2
        table = np.full((row.max() // 2 + 2, column.max() // 2 + 2), -1, np.int64)
        known = np.flatnonzero(self.first)
        known = known[(row[known] | column[known]) & 1 == 0]
        table[row[known] // 2, column[known] // 2] = known
        _between(row, column, self.listed[:, 3], self.surface, table, seen, left)
        return left


def sun_groups(shot: Shot, part: MeshFragments, facets: NDArray[np.float32], sun: Floats) -> SunGroups:
    """Return the groups of the fragments of one mesh. facets: of `Surfaces`. sun: (3,) direction in the world."""
    view = shot.view
    surface = np.empty((len(part.listed), 5))
    sunward, size = view.world_from_camera.T @ sun, (float(view.width), float(view.height))
    _meet(part.listed, facets, part.triangle, sunward, float(view.eye_m), size, surface)
    apart = _APART * np.pi / view.height if shot.draw.shading != "sample" else -1.0
    of, chosen = np.full(len(part.listed), -1, np.int64), np.zeros(len(part.listed), np.int64)
    area = np.zeros((len(part.listed), 5))
    count = _group(part.listed, part.pixel, part.weight, surface, apart, of, chosen, area)
    chosen = chosen[:count]
    listed, pixel = part.listed[chosen], part.pixel[chosen]
    listed[:, 4:] = area[:count]
    # a pixel with several groups has an edge of the body: all of its groups are asked
    beside = np.diff(pixel, prepend=-1, append=-1) != 0
    even = np.all(np.floor(listed[:, 1:3]) % 2.0 == 0.0, axis=1)
    return SunGroups(of, listed, surface[chosen, :4], even | ~(beside[:-1] & beside[1:]))


@exact
def _between(row: Any, column: Any, body: Any, surface: Any, table: Any, seen: Any, left: Any) -> None:
    """Set `seen` (m, k) of the groups that are left, (m,), where all beside them see the same, 1 or 0, and are of the
    same surface; those are left no more.

    table: of every second row and column, the group of its pixel, -1 for none.
    """
    for n in range(len(left)):
        if not left[n]:
            continue
        r, c, alike, found = row[n], column[n], True, 0
        for k in range(4):
            found = table[(r + k // 2) // 2, (c + k % 2) // 2] if alike else found
            alike = alike and found >= 0 and body[found] == body[n]
            if not alike:
                continue
            cosine = 0.0
            for axis in range(3):
                cosine += surface[found, axis] * surface[n, axis]
            alike = cosine >= _BEND and abs(surface[found, 3] - surface[n, 3]) <= _NEAR * surface[n, 3]
            for j in range(seen.shape[1]):
                value = seen[found, j]
                alike = alike and (value == 0.0 or value == 1.0) and (k == 0 or value == seen[n, j])
                seen[n, j] = value
        left[n] = not alike


@exact
def _meet(listed: Any, facets: Any, triangle: Any, sun: Any, eye: Any, size: Any, surface: Any) -> None:
    """Set `surface` (n, 5) of fragments (n, 9): unit normal, distance along the ray, and whether it faces the sun.

    facets, triangle: the planes of fragments. sun: (3,) its direction in the camera's axes. eye: [m] to the right of
    the middle of a stereo camera. size: width and height of the frame.
    """
    width, height = size
    for n in range(len(listed)):
        t = triangle[n]
        lon, lat = 2.0 * np.pi * (listed[n, 1] / width - 0.5), np.pi * (0.5 - listed[n, 2] / height)
        dx, dy, dz = np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)
        x = np.float64(facets[t, 0]) + facets[t, 3] + facets[t, 6]
        y = np.float64(facets[t, 1]) + facets[t, 4] + facets[t, 7]
        z = np.float64(facets[t, 2]) + facets[t, 5] + facets[t, 8]
        long, along = np.sqrt(x * x + y * y + z * z), x * dx + y * dy + z * dz
        surface[n, 0], surface[n, 1], surface[n, 2] = x / long, y / long, z / long
        surface[n, 3] = (1.0 - eye * (z * dx - x * dz)) / along if along != 0.0 else 0.0
        # the plane is where the product is 1: the camera's side is that where it is less
        surface[n, 4] = 1.0 if x * sun[0] + y * sun[1] + z * sun[2] < 0.0 else 0.0


@exact
def _follows(listed: Any, pixel: Any, surface: Any, apart: Any, before: Any, n: Any) -> Any:
    """Return whether a fragment belongs to the group of the one before it."""
    if pixel[n] != pixel[before] or listed[n, 3] != listed[before, 3]:
        return False
    cosine = 0.0
    for k in range(3):
        cosine += surface[n, k] * surface[before, k]
    return cosine >= _BEND and abs(surface[n, 3] - surface[before, 3]) <= apart * surface[before, 3]


@exact
def _group(listed: Any, pixel: Any, weight: Any, surface: Any, apart: Any, of: Any, chosen: Any, area: Any) -> Any:
    """Set the group (n,) of each fragment, and of each group the fragment with most samples (m,) and the area (m, 5) of
    all, as `sampling.frame_areas`; return their number m.
    """
    count, before = 0, -1
    moments = np.zeros((len(listed), 6))  # of groups: weight, mean, and second moments about the place of `origin`
    origin = np.zeros((len(listed), 2))
    most = np.zeros(len(listed))
    for n in range(len(listed)):
        if surface[n, 4] == 0.0:
            continue
        if before < 0 or not _follows(listed, pixel, surface, apart, before, n):
            origin[count, 0], origin[count, 1] = listed[n, 1], listed[n, 2]
            count += 1
        k, w = count - 1, weight[n]
        x, y = listed[n, 1] + listed[n, 4] - origin[k, 0], listed[n, 2] + listed[n, 5] - origin[k, 1]
        a, b, c = listed[n, 6], listed[n, 7], listed[n, 8]
        parts = (1.0, x, y, x * x + (a * a + b * b) / 12.0, x * y + (a + c) * b / 12.0, y * y + (b * b + c * c) / 12.0)
        for m in range(6):
            moments[k, m] += w * parts[m]
        if w > most[k]:
            most[k], chosen[k] = w, n
        of[n], before = k, n
    for k in range(count):
        x, y = moments[k, 1] / moments[k, 0], moments[k, 2] / moments[k, 0]
        xx, xy = moments[k, 3] / moments[k, 0] - x * x, moments[k, 4] / moments[k, 0] - x * y
        yy = moments[k, 5] / moments[k, 0] - y * y
        root = np.sqrt(max(xx * yy - xy * xy, 0.0))
        scale = np.sqrt(12.0 / max(xx + yy + 2.0 * root, 1e-18))
        area[k, 0], area[k, 1] = origin[k, 0] + x - listed[chosen[k], 1], origin[k, 1] + y - listed[chosen[k], 2]
        area[k, 2], area[k, 3], area[k, 4] = (xx + root) * scale, xy * scale, (yy + root) * scale
    return count
