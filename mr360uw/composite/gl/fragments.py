# SPDX-License-Identifier: Apache-2.0
"""Fragments: shaded pieces of surface in pixels, and their compositing into the tiles of a layer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.gl.fragment_kernel import sum_behind
from mr360uw.composite.sampling import NO_GAPS, Gaps, join_gaps
from mr360uw.types import Floats, Tile


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
    for tile, inside, at in _places(tiles, fragments):
        free[inside] = 1.0 - tile.alpha.reshape(-1)[at]
    return free


def add_behind(tiles: Sequence[Tile], fragments: Fragments, values: Floats) -> None:
    """Composite fragments behind the contents of tiles. values: (n, 5) radiance, alpha and distance [m]."""
    for tile in tiles:
        sum_behind(
            fragments.row, fragments.column, fragments.first, fragments.weight, values, tile.row, tile.column,
            tile.radiance, tile.alpha, tile.distance_m,
        )  # fmt: skip


def _places(tiles: Sequence[Tile], fragments: Fragments) -> Iterator[tuple[Tile, NDArray[np.int64], NDArray[np.int64]]]:
    """Yield tiles, the pixels of fragments in each, and their flat indices in the tile."""
    for tile in tiles:
        rows, columns = tile.alpha.shape
        r, c = fragments.row - tile.row, fragments.column - tile.column
        inside = np.flatnonzero((r >= 0) & (r < rows) & (c >= 0) & (c < columns))
        if len(inside):
            yield tile, inside, r[inside] * columns + c[inside]
