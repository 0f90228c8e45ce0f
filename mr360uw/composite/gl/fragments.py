# SPDX-License-Identifier: Apache-2.0
"""Fragments: shaded pieces of surface in pixels, and their compositing into the tiles of a layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import PartOf
from mr360uw.composite.gl.blocks import BLOCK
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.sampling import NO_GAPS, Gaps, join_gaps
from mr360uw.composite.shot import PlacedObject
from mr360uw.jit import exact
from mr360uw.types import Floats, Tile


@exact
def take_lanes(image: Any, chosen: Any, first: int, values: Any) -> None:
    """Write the texels (h, w, c) of a target into the rows `chosen` (m,) of values (n, first + c...).

    Texel k in the order of numbers (`blocks.write_lanes`) goes to row chosen[k], from column `first` on.
    """
    blocks_across = image.shape[1] // BLOCK
    for k in range(len(chosen)):
        block, within = k // (BLOCK * BLOCK), k % (BLOCK * BLOCK)
        row = BLOCK * (block // blocks_across) + within // BLOCK
        column = BLOCK * (block % blocks_across) + within % BLOCK
        for c in range(image.shape[2]):
            values[chosen[k], first + c] = image[row, column, c]


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


_NONE = np.zeros(0, np.int64)
NOTHING = Fragments(_NONE, _NONE, _NONE, _NONE, np.zeros((0, 2)), np.zeros((0, 5)), np.zeros(0))


def joined_fragments(parts: Sequence[Fragments]) -> Fragments:
    """Return the fragments of several disjoint sets of pixels as one."""
    shift = np.cumsum([0, *(len(part) for part in parts)])
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("row", "column", "triangle", "place", "area", "weight")
    }
    first = np.concatenate([part.first + start for part, start in zip(parts, shift[:-1], strict=True)])
    return Fragments(first=first, gaps=join_gaps([part.gaps for part in parts]), **joined)


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
ListedOf = tuple[Sequence[PlacedObject], NDArray[np.int64], NDArray[Any]]
"""Objects, the number of each one's first triangle, and the body (n,) of each fragment."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshFragments:
    """Fragments of one mesh that are shaded together. chosen: (n,) numbers among all.

    listed: (n, 9) of each, triangle on the device, place (2), body and area (5) of `Fragments`. pixel: (n,) numbers,
    those of a pixel in sequence; weight: (n,) of `Fragments`.
    """

    mesh: Mesh
    chosen: NDArray[np.int64]
    listed: Floats
    pixel: NDArray[np.int64]
    weight: Floats


def mesh_fragments(listed_of: PartOf[ListedOf], fragments: Fragments) -> list[MeshFragments]:
    """Return the fragments of a layer by mesh."""
    objects, first, body = listed_of.whole
    triangle, pixel = fragments.triangle - first[body], fragments.pixel()
    listed = np.concatenate([triangle[:, None], fragments.place, body[:, None], fragments.area], axis=1)
    meshes = list(dict.fromkeys(placed.mesh for placed in objects))
    of_mesh = np.array([meshes.index(placed.mesh) for placed in objects])[body]
    parts = []
    for k, mesh in enumerate(meshes):
        chosen = np.flatnonzero(of_mesh == k)
        for start in range(0, len(chosen), _AT_ONCE):
            part = chosen[start : start + _AT_ONCE]
            parts.append(MeshFragments(mesh, part, listed[part], pixel[part], fragments.weight[part]))
    return parts
