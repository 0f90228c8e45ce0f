# SPDX-License-Identifier: Apache-2.0
"""Grid over the space about a shot's bodies: which of them may occlude part of the sun from a place in each cell.

A place looks up its cell and tests the few bodies listed there instead of all. Held to sun.glsl, which reads the grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

CELLS = (16, 16, 8)
"""Cells across, across and along the sun's direction: twice as many along each side take eight times the memory, 16 kB,
and save twenty small bodies less than a tenth of their tests."""
HALF_BITS = 15
"""Bodies are the bits of two whole numbers, which single floats hold exactly up to 24 bits."""
_ROW_TEXELS = 4
"""Texels of a row of the table that are used: powers of two divide by shifts."""
_BELOW = 0.5
"""How far the grid reaches below the bodies, over its extent across; everything lower counts as its lowest cells."""
_RADIUS = 0.25
"""Largest ball about a place for which a cell's list is enough, over the side of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class CasterGrid:
    """Lists of bodies for cells in the sun's axes. low: (3,) [m] the grid's corner; scale: (3,) cells per metre.

    radius_m: of the largest ball about a place for which the lists hold. table: (rows, 4, 4), two cells a texel, two
    numbers of `HALF_BITS` bits each.
    """

    low: Floats
    scale: Floats
    radius_m: float
    table: Floats


def make_caster_grid(extents: Floats, spread: float) -> CasterGrid:
    """Return the grid of bodies, at most 2 `HALF_BITS`.

    extents: (m, 6) of `LightFrame.extents` about the world's origin: centre across, half size across, ends along, two
    numbers each [m]. spread: tangent of the largest angle between the axis along and a ray towards the sun.
    """
    center, half, (bottom, top) = extents[:, :2], extents[:, 2:4], extents[:, 4:].T
    across = max(float(np.ptp(np.concatenate([center - half, center + half]), axis=0).max()), 1e-3)
    below = float(bottom.min()) - _BELOW * across
    wider = spread * (float(top.max()) - below)
    low = np.append((center - half).min(axis=0) - wider, below)
    high = np.append((center + half).max(axis=0) + wider, top.max())
    side = np.maximum((high - low) / CELLS, 1e-6)
    radius = _RADIUS * float(side.min())
    # the outermost cells hold everything beyond; rounding moves places by far less than the margin
    begins, ends = (_sides(low, side, shift) for shift in (0, 1))
    margin = 1.01 * radius
    height = np.maximum(top - begins[2][:, None] + margin, 0.0)
    reach = np.where(top - begins[2][:, None] + margin > 0.0, margin + spread * height, -np.inf)
    near: NDArray[np.bool_] = np.ones((*CELLS[::-1], len(extents)), np.bool_)
    for axis, shape in ((0, (1, 1, -1)), (1, (1, -1, 1))):
        apart = np.maximum(begins[axis][:, None] - center[:, axis], center[:, axis] - ends[axis][:, None])
        near &= (apart - half[:, axis]).reshape(*shape, len(extents)) <= reach[:, None, None]
    return CasterGrid(low, 1.0 / side, radius, _table(near.reshape(-1, len(extents))))


def _sides(low: Floats, side: Floats, shift: int) -> list[Floats]:
    """Return where the cells of each axis begin (shift 0) or end (1), the outermost at infinity."""
    found = []
    for axis, count in enumerate(CELLS):
        places = low[axis] + side[axis] * (np.arange(count, dtype=np.float64) + shift)
        places[-1 if shift else 0] = np.inf if shift else -np.inf
        found.append(places)
    return found


def _table(near: NDArray[np.bool_]) -> Floats:
    """Return the table (rows, 4, 4) of lists (cells, m)."""
    bits = np.zeros((len(near), 2 * HALF_BITS))
    bits[:, : near.shape[1]] = near
    halves = bits.reshape(-1, 2, HALF_BITS) @ np.exp2(np.arange(HALF_BITS))
    return np.asarray(halves.reshape(-1, _ROW_TEXELS, 4))
