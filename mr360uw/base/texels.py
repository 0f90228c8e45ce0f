# SPDX-License-Identifier: Apache-2.0
"""Interpolation of numbers and arrays: between the four texels around a place (`jit.inlined` makes these part of
kernels), and the cubic step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.jit import exact, inlined

Vector = tuple[float, float, float]


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


_periodic_four = inlined(periodic_four)


def packed(pictures: Sequence[NDArray[Any]]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the texels (n, 3) of pictures (1, height, width, 1 or 3), and first texel, width and height of each."""
    table, texels, first = [], [], 0
    for picture in pictures:
        height, width = picture.shape[1:3]
        table.append((first, width, height))
        texels.append(np.broadcast_to(picture, (1, height, width, 3)).reshape(-1, 3).astype(np.float32))
        first += width * height
    return np.concatenate(texels), np.array(table, np.int64)


@exact
def add(a: Vector, b: Vector, share: float) -> Vector:
    """Return a + share b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@exact
def times(a: Vector, b: Vector) -> Vector:
    """Return the products of the parts of two vectors."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@exact
def four(t: Any, a: int, b: int, c: int, d: int, fx: float, fy: float) -> Vector:
    """Return the value between four texels of t (n, 3): a, b above, c, d below."""
    wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        wa * t[a, 0] + wb * t[b, 0] + wc * t[c, 0] + wd * t[d, 0],
        wa * t[a, 1] + wb * t[b, 1] + wc * t[c, 1] + wd * t[d, 1],
        wa * t[a, 2] + wb * t[b, 2] + wc * t[c, 2] + wd * t[d, 2],
    )


@exact
def periodic(t: Any, n: Any, first: int, levels: int, u: float, v: float, level: float) -> Vector:
    """Return the value of a picture with its halves at tile coordinates (`caustic_lookup.periodic_trilinear`).

    t: (n, 3) texels of all pictures. n: (k, 3) first texel, width and height of every level of all; those of this one
    are `levels` from row `first` on, squares whose sides are powers of two. level: fractional.
    """
    lower = min(int(level), levels - 1)
    share = level - lower
    value = _periodic_level(t, n[first + lower, 0], n[first + lower, 1], u, v)
    if share <= 0.0 or lower + 1 >= levels:
        return value
    return between(value, _periodic_level(t, n[first + lower + 1, 0], n[first + lower + 1, 1], u, v), share)


@exact
def between(a: Vector, b: Vector, share: float) -> Vector:
    """Return (1 - share) a + share b."""
    rest = 1.0 - share
    return rest * a[0] + share * b[0], rest * a[1] + share * b[1], rest * a[2] + share * b[2]


@exact
def _periodic_level(t: Any, first: int, size: int, u: float, v: float) -> Vector:
    a, b, c, d, fx, fy = _periodic_four(first, size, u * size - 0.5, v * size - 0.5)
    return four(t, a, b, c, d, fx, fy)


@exact
def level_for(footprint: float, pixel: float, last: int) -> float:
    """Return the level for a footprint and a pixel [m] (`caustic_lookup.mip_level`)."""
    wanted = footprint / (math.sqrt(3.0) * pixel)
    return min(math.log2(wanted), float(last)) if wanted > 1.0 else 0.0
