# SPDX-License-Identifier: Apache-2.0
"""Lookup tables that map a plate's R'G'B' values to a display picture or to light, and their inverse.

A table has one stage or two: curves of one channel each (n, 3), and a cube (n, n, n, 3), whose axes are red, green,
blue. Values outside a stage's domain are held at its edge. Curves are interpolated linearly, cubes by tetrahedra
(`cube_kernels`). What comes out is in the space `to`: an encoded display picture, or linear light, of Rec.709.

The inverse is that of the interpolated table. A value that the table lacks gets the code of the closest that it has.
Where the table clips, many codes have one value, and the inverse gives the one that is closest to the middle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import DisplayTransfer, decode, encode

Array = NDArray[np.float64]

_EXACT = 1e-9
"""Distance of values at which the inverse is found, of the table's range: far below any code."""

_GREYS = 1001  # values at which clipping is looked for, for a note of three digits


@dataclass(frozen=True, eq=False)
class LutTable:
    """One table: (n, 3) of curves, or (n, n, n, 3). low, high: (3,) ends of its domain."""

    table: Array
    low: Array
    high: Array

    @property
    def is_cube(self) -> bool:
        """Whether the table mixes channels."""
        return self.table.ndim == 4

    @cached_property
    def diagonal(self) -> Array:
        """The values (n, 3) for equal positions in all channels, made to rise."""
        n = np.arange(len(self.table))
        return np.maximum.accumulate(self.table[n, n, n] if self.is_cube else self.table, axis=0)

    @property
    def span(self) -> float:
        """The range of the values."""
        return float(np.ptp(self.table)) or 1.0

    def forward(self, values: Array) -> Array:
        """Return the stage's output (m, 3) of input (m, 3)."""
        last = len(self.table) - 1
        x = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0) * last
        if not self.is_cube:
            places = np.arange(last + 1)
            return np.stack([np.interp(x[:, c], places, self.table[:, c]) for c in range(3)], axis=-1)
        from mr360uw.yuv.cube_kernels import interpolate

        out = np.empty_like(x)
        interpolate(self.table, x, out)
        return out

    def inverse(self, wanted: Array) -> Array:
        """Return the input (m, 3) of output (m, 3)."""
        last = len(self.table) - 1
        x = np.stack([_risen(wanted[:, c], self.diagonal[:, c]) for c in range(3)], axis=-1)
        if self.is_cube:
            from mr360uw.yuv.cube_kernels import invert

            reached = np.clip(wanted, self.table.min(axis=(0, 1, 2)), self.table.max(axis=(0, 1, 2)))
            invert(self.table, reached, _EXACT * self.span, x)
        return self.low + x / last * (self.high - self.low)


@dataclass(frozen=True)
class CubeLut:
    """The mapping of a table to light; see `color.ColorSpec`.

    stages: applied one after the other. to: space of the last one's output. digest: of the file's bytes.
    on_file_codes: whether the input is codes over full scale. is_wide: see `color.PlateMapping`.
    """

    stages: tuple[LutTable, ...] = field(compare=False)
    digest: str
    to: DisplayTransfer
    on_file_codes: bool
    is_wide: bool = True

    def to_light(self, values: NDArray[Any]) -> Array:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        found = np.asarray(values, np.float64).reshape(-1, 3)
        for stage in self.stages:
            found = stage.forward(found)
        return np.asarray(decode(found, self.to), np.float64).reshape(values.shape)

    def to_values(self, light: NDArray[Any]) -> Array:
        """Return the values (..., 3) of linear Rec.709 light (..., 3), within the table's domain."""
        found = np.asarray(encode(np.asarray(light, np.float64), self.to)).reshape(-1, 3)
        for stage in reversed(self.stages):
            found = stage.inverse(found)
        return found.reshape(light.shape)


def clipped_greys(lut: CubeLut) -> str:
    """Return the ranges of grey input that a table clips to black or white, in words; "" where it clips none."""
    first = lut.stages[0]
    part = np.linspace(0.0, 1.0, _GREYS)[:, None]
    light = lut.to_light(first.low + part * (first.high - first.low))
    grey = (first.low + part * (first.high - first.low)).max(axis=1)
    black = np.flatnonzero(np.all(light <= light[0], axis=1))[-1]
    white = np.flatnonzero(np.all(light >= light[-1], axis=1))[0]
    ends = [f"below {grey[black]:.3g}"] * int(black > 0) + [f"above {grey[white]:.3g}"] * int(white < _GREYS - 1)
    return " and ".join(ends)


def _risen(wanted: Array, curve: Array) -> Array:
    """Return the positions (m,) at which a curve (n,) that does not fall has the values wanted (m,).

    Where it is flat, at its foot the last position, at its head the first.
    """
    last = np.flatnonzero(curve <= curve[0])[-1]
    first = np.flatnonzero(curve >= curve[-1])[0]
    if first <= last:
        return np.full(wanted.shape, 0.5 * (len(curve) - 1))
    kept = np.arange(last, first + 1)
    steady = np.concatenate([[True], np.diff(curve[kept]) > 0.0])
    return np.interp(wanted, curve[kept][steady], kept[steady])
