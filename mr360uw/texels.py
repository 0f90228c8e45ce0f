# SPDX-License-Identifier: Apache-2.0
"""Interpolation of numbers and arrays: between the four texels around a place (`jit.inlined` makes these part of
kernels), and the cubic step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def between_four(a: Any, b: Any, c: Any, d: Any, x: Any, y: Any) -> Any:
    """Return the value at a place x in [0, 1] from left to right, y down, between texels a, b above and c, d below."""
    return (a * (1.0 - x) + b * x) * (1.0 - y) + (c * (1.0 - x) + d * x) * y


def periodic_four(first: int, size: int, x: float, y: float) -> tuple[int, int, int, int, float, float]:
    """Return the numbers of the texels around (x, y), of a picture that repeats, and x and y between them.

    The rows of the picture follow each other from texel `first` on. size: its side, a power of two. Texel 0 is at 0.
    """
    column, row, last = math.floor(x), math.floor(y), size - 1
    i, j = int(column), int(row)
    above, below = first + (j & last) * size, first + ((j + 1) & last) * size
    left, right = i & last, (i + 1) & last
    return above + left, above + right, below + left, below + right, x - column, y - row


def texels_around(x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Return column and row of the texel to the upper left of places (...,), and (..., 1) how far these are from it."""
    i, j = np.floor(x), np.floor(y)
    return i.astype(np.int64), j.astype(np.int64), (x - i)[..., None], (y - j)[..., None]


def smoothstep(value: ArrayLike, zero: float, one: float) -> NDArray[Any]:
    """Return the cubic step (...,) from 0 for values on the side of `zero` to 1 on that of `one`."""
    t = np.clip((np.asarray(value) - zero) / (one - zero), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))
