# SPDX-License-Identifier: Apache-2.0
"""Ratio and veil of the receiver's pixels from the light on its blocks, in one compiled pass.

    ratio = 1 + weight ((share free + (r - share) seen waves + added)/r - 1)

with the symbols of ratio.py and pattern.py; r is 1 without a pattern. Each quantity is interpolated between the corners
of a block, or taken from an image of the block's pixels if there is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.receiver.ground import BLOCK
from mr360uw.composite.receiver.pattern import LEAST_DIRECT, LEAST_LIGHT, PlatePattern
from mr360uw.types import Tile

SHARE, VEIL, FREE, SEEN = slice(0, 3), slice(3, 6), slice(6, 9), 9
CORNER_CHANNELS = 10
_CHANGED = 1e-4
"""Least change of the plate, as a fraction, that is written."""


@dataclass(frozen=True, slots=True, eq=False)
class PixelImages:
    """Images of some blocks, (m, B, B, k) float32. at: (n,) for each block the number of its image, or -1."""

    at: NDArray[np.int32]
    image: NDArray[np.float32]


Gathered = list[tuple[NDArray[np.bool_], NDArray[np.float32]]]
"""Pairs of a mask (n,) of m blocks and their images (m, B, B, k)."""


def gather_images(count: int, channels: int, parts: Gathered) -> PixelImages:
    """Return the images of `count` blocks from parts, each block in one part at most."""
    at, first = np.full(count, -1, np.int32), 0
    for which, images in parts:
        at[which] = first + np.arange(len(images))
        first += len(images)
    none = np.zeros((0, BLOCK, BLOCK, channels), np.float32)
    return PixelImages(at, np.concatenate([none, *(images for _, images in parts)]))


@dataclass(frozen=True, slots=True, eq=False)
class BlockLight:
    """Light on blocks of the receiver.

    row, column: (n,) of the blocks. corner: (R + 1, C + 1, 10) float32, channels SHARE, VEIL, FREE, SEEN. Images of
    pixels, used instead of corners: free (k = 3), seen (1), waves (3), shape (7: share, weight, veil), added (3; 0 if
    there is none).
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    corner: NDArray[np.float32]
    free: PixelImages
    seen: PixelImages
    waves: PixelImages
    shape: PixelImages
    added: PixelImages


def lay_receiver(light: BlockLight, tile: Tile, width: int, height: int, pattern: PlatePattern | None = None) -> None:
    """Write ratio and veil of the blocks into a tile of a width x height frame; where nothing changes it is left.

    pattern: the plate's own caustics, which go with the sun's light (see pattern.py).
    """
    none = np.zeros((0, 0, 3), np.float32)
    shown, calm = (none, none) if pattern is None else pattern.light(tile.rectangle)
    _lay(
        light.row, light.column, light.corner, light.free.at, light.free.image, light.seen.at, light.seen.image,
        light.waves.at, light.waves.image, light.shape.at, light.shape.image,
        light.added.at, light.added.image, width,
        height, tile.row, tile.column, np.ascontiguousarray(shown), np.ascontiguousarray(calm), tile.ratio, tile.veil,
    )  # fmt: skip


@numba.njit(nogil=True, fastmath=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator, unused-ignore]
def _pattern_at(shown: Any, calm: Any, veil: Any, share: Any) -> Any:
    """Return what `pattern.direct_pattern` returns, at one pixel of one channel."""
    one, dark, direct = np.float32(1.0), np.float32(LEAST_LIGHT), np.float32(LEAST_DIRECT)
    r = (shown - veil) / (calm - veil) if calm - veil > dark else one
    return max(r, share + direct * (one - share))


@numba.njit(nogil=True, fastmath=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator, unused-ignore]
def _take_images(
    line: Any, weight: Any, waves_row: Any, added_row: Any, j: int, f: int, free: Any, s: int, seen: Any, w: int,
    waves: Any, g: int, shape: Any, p: int, added: Any,
) -> None:  # fmt: skip
    """Set row j of a block to that of its images, of those whose number is not negative."""
    weight[:] = np.float32(1.0)
    added_row[:], waves_row[:] = np.float32(0.0), np.float32(1.0)
    if g >= 0:
        for k in range(6):
            for i in range(BLOCK):
                line[k, i] = shape[g, j, i, k if k < 3 else k + 1]
        for i in range(BLOCK):
            weight[i] = shape[g, j, i, 3]
    if f >= 0:
        for k in range(3):
            for i in range(BLOCK):
                line[6 + k, i] = free[f, j, i, k]
    if s >= 0:
        for i in range(BLOCK):
            line[9, i] = seen[s, j, i, 0]
    if w >= 0:
        for k in range(3):
            for i in range(BLOCK):
                waves_row[k, i] = waves[w, j, i, k]
    if p >= 0:
        for k in range(3):
            for i in range(BLOCK):
                added_row[k, i] = added[p, j, i, k]


@numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")  # type: ignore[untyped-decorator, unused-ignore]
def _lay(
    row: Any, column: Any, corner: Any, free_at: Any, free: Any, seen_at: Any, seen: Any, waves_at: Any, waves: Any,
    shape_at: Any, shape: Any, added_at: Any, added: Any,
    width: int, height: int, first_row: int, first_column: int, shown: Any, calm: Any, ratio: Any, veil: Any,
) -> None:  # fmt: skip
    one, half, zero, least = np.float32(1.0), np.float32(0.5), np.float32(0.0), np.float32(_CHANGED)
    # one row of a block: channels of `corner`, weight of the change, the plate and its pattern r, relative change
    line, weight = np.empty((10, BLOCK), np.float32), np.empty(BLOCK, np.float32)
    waves_row, added_row, plate, calm_row, direct, change = np.ones((6, 3, BLOCK), np.float32)
    for n in range(len(row)):
        top, left = row[n] * BLOCK, column[n] * BLOCK
        y0, y1 = max(top, first_row), min(top + BLOCK, height, first_row + ratio.shape[0])
        x0, x1 = max(left, first_column), min(left + BLOCK, width, first_column + ratio.shape[1])
        if y0 >= y1 or x0 >= x1:
            continue
        at, skipped, count = slice(x0 - first_column, x1 - first_column), x0 - left, x1 - x0
        a, b = corner[row[n], column[n]], corner[row[n], column[n] + 1]
        c, d = corner[row[n] + 1, column[n]], corner[row[n] + 1, column[n] + 1]
        f, s, w, g, p = free_at[n], seen_at[n], waves_at[n], shape_at[n], added_at[n]
        if f < 0 and s < 0 and w < 0 and g < 0:
            most = zero
            for k in range(6, 10):
                most = max(most, abs(a[k] - one), abs(b[k] - one), abs(c[k] - one), abs(d[k] - one))
            if most < half * least:
                continue
        down, across = one / np.float32(min(BLOCK, height - top)), one / np.float32(BLOCK)
        for y in range(y0, y1):
            j, v = y - top, (np.float32(y - top) + half) * down
            for k in range(10):
                start = a[k] + v * (c[k] - a[k])
                step = across * (b[k] + v * (d[k] - b[k]) - start)
                for i in range(BLOCK):
                    line[k, i] = start + (np.float32(i) + half) * step
            _take_images(line, weight, waves_row, added_row, j, f, free, s, seen, w, waves, g, shape, p, added)
            if len(shown):
                now, mean = shown[y - first_row, at], calm[y - first_row, at]
                for i in range(count):
                    for k in range(3):
                        plate[k, skipped + i], calm_row[k, skipped + i] = now[i, k], mean[i, k]
                for k in range(3):
                    for i in range(BLOCK):
                        direct[k, i] = _pattern_at(plate[k, i], calm_row[k, i], line[3 + k, i], line[k, i])
            for k in range(3):
                for i in range(BLOCK):
                    share, r = line[k, i], direct[k, i]
                    lit = share * line[6 + k, i] + (r - share) * (line[9, i] * waves_row[k, i]) + added_row[k, i]
                    change[k, i] = weight[i] * (lit / r - one)
            of_ratio, of_veil = ratio[y - first_row, at], veil[y - first_row, at]
            for i in range(count):
                m = i + skipped
                if max(abs(change[0, m]), abs(change[1, m]), abs(change[2, m])) > least:
                    for k in range(3):
                        of_ratio[i, k], of_veil[i, k] = one + change[k, m], line[3 + k, m]
