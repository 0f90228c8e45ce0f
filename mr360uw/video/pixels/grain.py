# SPDX-License-Identifier: Apache-2.0
"""Adds grain of the plate's spectrum and strength to the composite, where a layer covers the plate.

    code' = code + amount alpha(pixel) deviation(brightness) noise(place, frame)

noise is white noise filtered to the spectrum's shape, of variance 1. Codes are in units of full scale, Y' from 0 to 1.
`grain_measure` finds spectrum and strength.

White noise is a hash of the pixel's place, its plane and the frame's index, so any rectangle of any frame can be had by
itself (counter-based, as Salmon 2011). The hash is the finaliser of SplitMix64 (Steele 2014, variant 13). Four of its
16-bit pieces add up to a nearly normal number that is never beyond 3.5 standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import Transfer, decode, encode, rgb_from_ycbcr, ycbcr_from_rgb
from mr360uw.jit import fast, inlined
from mr360uw.types import Floats, Rectangle, Tile

_DEVIATION = np.float32(np.sqrt((2.0**32 - 1.0) / 3.0))
"""Standard deviation of the sum of four independent integers, each even over [0, 2^16)."""


@inlined
def _mixed(z: Any) -> Any:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@fast
def white_noise(frame: int, plane: int, row: int, column: int, columns: int, out: Any) -> None:
    """Write noise of mean 0 and variance 1 into `out` (h, w); it repeats after `columns` columns."""
    step, low = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFFFF)
    stream = _mixed(np.uint64(frame) * step + np.uint64(plane + 1))
    for r in range(out.shape[0]):
        along = _mixed(stream + np.uint64(row + r + (1 << 32)) * step)
        for c in range(out.shape[1]):
            z = _mixed(along + np.uint64((column + c) % columns) * step)
            total = (z & low) + ((z >> np.uint64(16)) & low) + ((z >> np.uint64(32)) & low) + (z >> np.uint64(48))
            out[r, c] = (np.float32(total) - np.float32(131070.0)) / _DEVIATION


@fast
def survey(blocks: Any, out: Any) -> None:
    """Write (lowest value, highest value, mean, roughness) of blocks (n, h, w) into `out` (n, 4).

    Roughness is the energy of the second differences, lags 1, 2 and 4, both ways.
    """
    count, height, width = blocks.shape
    for n in range(count):
        block = blocks[n]
        low, high, total, rough = block[0, 0], block[0, 0], np.float32(0.0), np.float32(0.0)
        for r in range(height):
            for c in range(width):
                low, high, total = min(low, block[r, c]), max(high, block[r, c]), total + block[r, c]
        for lag in (1, 2, 4):
            for r in range(lag, height - lag):
                for c in range(lag, width - lag):
                    twice = np.float32(2.0) * block[r, c]
                    across = block[r, c - lag] - twice + block[r, c + lag]
                    down = block[r - lag, c] - twice + block[r + lag, c]
                    rough += across * across + down * down
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = low, high, total / np.float32(height * width), rough


RADIUS = 5
"""Radius of the filter [px]: correlations of codecs end within a few pixels; time grows with the square."""
TABLE = 64
"""Samples of the strength's curve over brightness, Y' from 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Grain:
    """The grain of a frame's planes Y', Cb, Cr.

    deviation: (3, TABLE) standard deviation over brightness, Y' from 0 to 1. filters: (3, 2 RADIUS + 1, 2 RADIUS + 1),
    squares sum to 1 (0 where a plane has no grain). transfer: the curve of the code values.
    """

    deviation: NDArray[np.float32]
    filters: NDArray[np.float32]
    transfer: Transfer = "srgb"

    def noise(self, plane: int, frame_index: int, rectangle: Rectangle, columns: int) -> NDArray[np.float32]:
        """Return grain of variance 1 in a rectangle of a plane, (height, width).

        columns: of the whole plane, after which the noise starts again.
        """
        import cv2

        column, row, width, height = rectangle
        white = np.empty((height + 2 * RADIUS, width + 2 * RADIUS), np.float32)
        white_noise(frame_index, plane, row - RADIUS, (column - RADIUS) % columns, columns, white)
        found = cv2.filter2D(white, -1, self.filters[plane])
        return np.ascontiguousarray(found[RADIUS : RADIUS + height, RADIUS : RADIUS + width])

    def at(self, plane: int, brightness: Floats) -> NDArray[np.float32]:
        """Return the standard deviation in a plane where Y' is `brightness` (...)."""
        place = np.clip(np.asarray(brightness) * (TABLE - 1) + 0.5, 0, TABLE - 1).astype(np.int64)
        return self.deviation[plane][place]


NO_GRAIN = Grain(np.zeros((3, TABLE), np.float32), np.zeros((3, 2 * RADIUS + 1, 2 * RADIUS + 1), np.float32))


def covered_box(alpha: Floats) -> Rectangle:
    """Return the smallest rectangle around the coverage (h, w) above 0; there is some."""
    rows, columns = (np.flatnonzero(np.any(alpha > 0.0, axis=axis)) for axis in (1, 0))
    width, height = int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1)
    return Rectangle(int(columns[0]), int(rows[0]), width, height)


def add_grain(linear: Floats, tile: Tile, grain: Grain, amount: float, columns: int, frame_index: int) -> Floats:
    """Return the composite of one tile, linear (h, w, 3), with grain where the tile covers the plate.

    grain: of `grain_of_rgb`; it is added to code values. columns: of the whole frame.
    """
    if not np.any(tile.alpha > 0.0):
        return linear
    column, row, width, height = covered_box(tile.alpha)
    window = slice(row, row + height), slice(column, column + width)
    code = encode(linear[window], grain.transfer)
    brightness = code @ ycbcr_from_rgb("bt709")[0]
    place = Rectangle(tile.column + column, tile.row + row, width, height)
    step = [grain.noise(n, frame_index, place, columns) * grain.at(n, brightness) for n in range(3)]
    alpha = tile.alpha[window][..., None]
    grainy = code + amount * alpha * (np.stack(step, axis=-1) @ rgb_from_ycbcr("bt709").T)
    out = linear.copy()
    dark = np.minimum(linear[window], 0.0)  # grain makes no light negative that was not
    out[window] = np.where(alpha > 0.0, np.maximum(decode(grainy, grain.transfer), dark), linear[window])
    return out
