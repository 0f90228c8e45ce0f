# SPDX-License-Identifier: Apache-2.0
"""Caustics as two scrolling copies of one still map, the darker of which shows (Stam 1996; Monzon et al. 2022)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.sea.base import SeaParameters

Array = NDArray[np.floating[Any]]

_SCROLL = ((0.37, 0.21), (-0.29, 0.33))
"""Velocity [m/s] of the two copies over (x, z), about that of short waves; twice as large, the pattern moves as fast
as waves four times as long."""


def scroll_offsets(sea: SeaParameters, time_s: float) -> Array:
    """Return how far (2, 2) over (x, z), in tiles, the two copies have moved."""
    rate = np.array(_SCROLL) / sea.tile_m
    if sea.loop_s is not None:
        rate = np.round(rate * sea.loop_s) / sea.loop_s
    return rate * time_s


def scroll(ratio: Array, sea: SeaParameters, time_s: float) -> Array:
    """Return the darker of two scrolled copies of a map (size, size), of mean 1; the second has x and z swapped."""
    size = ratio.shape[0]
    first, second = np.round(scroll_offsets(sea, time_s) * size).astype(np.int64)
    darker = np.minimum(np.roll(ratio, (first[1], first[0]), (0, 1)), np.roll(ratio.T, (second[1], second[0]), (0, 1)))
    return darker / darker.mean()
