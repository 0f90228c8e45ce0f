# SPDX-License-Identifier: Apache-2.0
"""Where a pixel is sampled, and which of its samples are lit together.

Samples lie on a rotated grid. Frame coordinates (x, y) in pixels map to the grid by the Gaussian integer a + ib,

    (X, Y) = (a x - b y, b x + a y),

and a sample sits in the middle of every unit cell of the grid. A whole pixel is a whole step of the grid, so every
pixel has the same n = a^2 + b^2 samples, and for a and b without a common factor they lie in n different columns and n
different rows: edges of every direction get n levels of coverage. Where n is odd, one sample is the pixel's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError
from mr360uw.types import Floats

PLANE_TOLERANCE = 0.5
"""Samples lit together lie within so many widths of the pixel's filter of one plane."""
PIXEL_FILTER = 0.5
"""Width in pixels that textures are filtered over where a pixel is lit once: nearest to the mean of many samples."""
GROUPS = 8
"""Groups of samples that are lit in one pixel, an even number; the last takes all that are left."""
BLEND_LAYERS = 4
"""Transparent surfaces in front of each other that are told apart."""

_GAUSSIAN = {1: (1, 0), 5: (2, 1), 13: (3, 2), 17: (4, 1), 29: (5, 2), 41: (5, 4), 65: (8, 1)}


@dataclass(frozen=True, slots=True)
class Pattern:
    """The samples of a pixel. cells: (n, 2) of the grid that belong to pixel (0, 0), the nearest to its centre first.
    positions: (n, 2) where they are in that pixel, in [0, 1)^2.
    """

    cells: NDArray[np.int64]
    positions: Floats

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
    positions = np.stack(frame_from_grid(cells[:, 0] + 0.5, cells[:, 1] + 0.5, a, b), axis=-1)
    inside = np.all((positions >= 0.0) & (positions < 1.0), axis=-1)
    cells, positions = cells[inside], positions[inside]
    order = np.lexsort((cells[:, 1], cells[:, 0], np.round(np.sum((positions - 0.5) ** 2, axis=-1), 9)))
    return Pattern(cells[order], positions[order])


def frame_from_grid(x: ArrayLike, y: ArrayLike, a: int, b: int) -> tuple[Floats, Floats]:
    """Return the frame coordinates of grid coordinates."""
    x, y, n = np.asarray(x, np.float64), np.asarray(y, np.float64), a * a + b * b
    return (a * x + b * y) / n, (a * y - b * x) / n


def filter_width(samples: int, shading: str) -> float:
    """Return the width [pixels] that textures are filtered over: a sample's share of the pixel where each is lit."""
    return float(samples) ** -0.5 if shading == "sample" else PIXEL_FILTER
