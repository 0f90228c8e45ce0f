# SPDX-License-Identifier: Apache-2.0
"""Sample pattern of a pixel, and the limits within which its samples share one shading evaluation.

Samples lie on a rotated grid. Frame coordinates (x, y) in pixels map to the grid by the Gaussian integer a + ib,

    (X, Y) = (a x - b y, b x + a y),

and a sample sits in the middle of every unit cell of the grid. A whole pixel is a whole step of the grid, so every
pixel has the same n = a^2 + b^2 samples, and for a and b without a common factor they lie in n different columns and n
different rows: edges of every direction get n levels of coverage. Where n is odd, one sample is the pixel's centre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.jit import exact_making, inlined
from mr360uw.types import Floats

PLANE_TOLERANCE = 0.5
"""Distance from a common plane, in widths of the pixel's filter, within which samples are shaded together. Twice as
large: fewer evaluations, coarser shading of curved silhouettes."""
PIXEL_FILTER = 0.5
"""Filter width of textures [pixels] for a pixel shaded once. It is closest to the mean of many samples; twice as large
blurs textures."""
GROUPS = 8
"""Most groups of samples in one pixel, an even number; the last takes all samples that are left."""
BLEND_LAYERS = 4
"""Most transparent surfaces drawn in front of each other."""

WHOLE_PIXEL = (0.0, 0.0, 1.0, 0.0, 1.0)
"""The area of a whole pixel about its centre, as in `frame_areas`."""

_PART_OF_GAP = 1.0 / 3.0
"""Width over which the receiver's shadow is averaged in a partly covered pixel, in widths of its uncovered part. Twice
as large reaches below the body where that part is a triangle; a point makes shadow edges jagged."""

_CLEAR = 0.25
"""Distance [pixels] within which few samples around a gap's place are to be covered. Twice as large: the place moves to
the pixel's border; half as large: the averaged area reaches below the body."""

_GAUSSIAN = {1: (1, 0), 5: (2, 1), 13: (3, 2), 17: (4, 1), 29: (5, 2), 41: (5, 4), 65: (8, 1)}


@dataclass(frozen=True, slots=True)
class Pattern:
    """The samples of a pixel. cells: (n, 2) of the grid that belong to pixel (0, 0), the nearest to its centre first.
    positions: (n, 2) in that pixel, in [0, 1)^2. step: (x, y) in the frame [pixels] of a step to the next cell.
    """

    cells: NDArray[np.int64]
    positions: NDArray[np.float64]
    step: tuple[float, float]

    @property
    def count(self) -> int:
        """Samples of a pixel."""
        return len(self.cells)


def pattern(samples: int) -> Pattern:
    """Return the pattern of so many samples; raise `ParameterError` for a number that has none."""
    if samples not in _GAUSSIAN:
        counts = ", ".join(map(str, _GAUSSIAN))
        raise ParameterError(f"samples - no rotated grid of that size (got {samples}) - take one of {counts}")
    a, b = _GAUSSIAN[samples]
    reach = np.arange(-b - 1, a + b + 2)
    cells = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
    x, y = cells.T + 0.5
    positions = np.stack([a * x + b * y, a * y - b * x], axis=-1) / (a * a + b * b)
    inside = np.all((positions >= 0.0) & (positions < 1.0), axis=-1)
    cells, positions = cells[inside], positions[inside]
    order = np.lexsort((cells[:, 1], cells[:, 0], np.round(np.sum((positions - 0.5) ** 2, axis=-1), 9)))
    return Pattern(cells[order], positions[order], (a / (a * a + b * b), -b / (a * a + b * b)))


class Gaps(NamedTuple):
    """Uncovered parts of n pixels that opaque surfaces cover partly.

    row, column: (n,) of the pixels in the frame. place: (n, 2) frame coordinates of an uncovered sample. area: (n, 5)
    around it over which shadows are averaged, in the form of `frame_areas`.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    place: Floats
    area: Floats


NO_GAPS = Gaps(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 5)))


def find_gaps(samples: Pattern, row: NDArray[np.int64], column: NDArray[np.int64], covered: NDArray[np.bool_]) -> Gaps:
    """Return the gaps of pixels (n,) of which opaque surfaces cover some samples (n, s).

    Of the uncovered samples with the fewest covered ones around them, the place is that nearest to the mean of all
    uncovered ones. The mean itself may lie below the body.
    """
    partly = np.flatnonzero(covered.any(axis=1) & ~covered.all(axis=1))
    row, column, free = row[partly], column[partly], ~covered[partly]
    apart = np.sum((samples.positions[:, None] - samples.positions) ** 2, axis=-1)
    around = (~free).astype(np.float32) @ (apart <= _CLEAR**2).astype(np.float32)  # covered ones around each
    around[~free] = np.inf
    clear = around == around.min(axis=1, keepdims=True)
    nearest = nearest_to_mean(samples.cells, free, clear)
    area = _PART_OF_GAP * frame_areas(samples.positions, free, nearest)
    area[:, :2] = 0.0
    return Gaps(row, column, np.stack([column, row], axis=-1) + samples.positions[nearest], area)


def join_gaps(*parts: Gaps) -> Gaps:
    """Return the gaps of several sets of pixels as one."""
    return Gaps(*map(np.concatenate, zip(NO_GAPS, *parts, strict=True)))


def filter_width(samples: int, shading: str) -> float:
    """Return the filter width of textures [pixels]; shading "sample": the width of one sample's share of the pixel."""
    return float(samples) ** -0.5 if shading == "sample" else PIXEL_FILTER


Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@exact_making
def nearest_to_mean(cells: NDArray[np.int64], member: Mask, among: Mask) -> NDArray[np.int64]:
    """Return the index (n,) of the sample of `among` (n, s) nearest to the mean of members (n, s).

    cells: (s, 2) of a `Pattern`, s below 256. In whole numbers ties are exact, and several samples are added at once;
    the first of equals is taken.
    """
    found = np.zeros(len(member), np.int64)
    x, y = cells[:, 0].copy(), cells[:, 1].copy()
    for n in range(len(member)):
        count, sum_x, sum_y = np.int64(0), np.int64(0), np.int64(0)
        for k in range(len(x)):
            inside = np.int64(member[n, k])
            count += inside
            sum_x += inside * x[k]
            sum_y += inside * y[k]
        least = np.int64(1 << 62)
        for k in range(len(x)):
            value = count * (x[k] * x[k] + y[k] * y[k]) - 2 * (sum_x * x[k] + sum_y * y[k])
            least = min(least, value * 256 + k if among[n, k] else np.int64(1 << 62))
        found[n] = least & 255
    return found


@inlined
def root_of_moments(xx: Any, xy: Any, yy: Any, own: Any) -> Any:
    """Return xx, xy and yy of the symmetric root of 12 C, C the second moments of an area. own: least root of their
    determinant, that of one sample.

    The root of M is (M + |M|^(1/2) 1) / (tr M + 2 |M|^(1/2))^(1/2) (Cayley and Hamilton's theorem for 2 x 2).
    """
    root = math.sqrt(max(xx * yy - xy * xy, own * own))
    scale = math.sqrt(12.0 / (xx + yy + 2.0 * root))
    return (xx + root) * scale, xy * scale, (yy + root) * scale


@exact_making
def frame_areas(positions: Array, member: Mask, nearest: NDArray[np.int64]) -> Array:
    """Return the areas of a pixel that members (n, s) represent, (n, 5): offset x, y, and matrix xx, xy, yy [pixels].

    The area is the parallelogram with the mean and the second moments C of the members, each a square of 1/s pixel: its
    sides are the columns of the symmetric root of 12 C, the unit matrix for a whole pixel. positions: (s, 2) of a
    `Pattern`. offset: from the sample `nearest` (n,) to the mean.
    """
    areas = np.zeros((len(member), 5))
    own = 1.0 / (12.0 * len(positions))
    for n in range(len(member)):
        count, sum_x, sum_y, sum_xx, sum_xy, sum_yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(len(positions)):
            if member[n, k]:
                x, y = positions[k, 0], positions[k, 1]
                count += 1.0
                sum_x += x
                sum_y += y
                sum_xx += x * x
                sum_xy += x * y
                sum_yy += y * y
        mean_x, mean_y = sum_x / count, sum_y / count
        xx, yy = sum_xx / count - mean_x * mean_x + own, sum_yy / count - mean_y * mean_y + own
        xy = sum_xy / count - mean_x * mean_y
        areas[n, 0], areas[n, 1] = mean_x - positions[nearest[n], 0], mean_y - positions[nearest[n], 1]
        areas[n, 2], areas[n, 3], areas[n, 4] = root_of_moments(xx, xy, yy, own)
    return areas
