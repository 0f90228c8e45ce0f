# SPDX-License-Identifier: Apache-2.0
"""Interpolation of numbers and arrays: between the four texels around a place (`jit.inlined` makes these part of
kernels), along a curve through points, and the cubic step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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


def curve_through(places: ArrayLike, values: ArrayLike, *, smooth: bool) -> Callable[[float], NDArray[Any]]:
    """Return the function of a place that has values (n, ...) at ascending places (n,), two or more, and is straight
    between them or, if it is to be smooth, a monotone cubic (Fritsch & Butland 1984).

    With t from 0 to 1 between two places h apart, y linear between their values, m its slope and d the cubic's:

        c(t) = y(t) + h t (1 - t) ((1 - t)(d_0 - m) - t (d_1 - m))
    """
    x, y = np.asarray(places, np.float64), np.asarray(values, np.float64)
    step = np.diff(x).reshape(-1, *(1,) * (y.ndim - 1))
    rise = np.diff(y, axis=0)
    slope = rise / step
    bend = _monotone_slopes(step, slope) if smooth and len(x) > 2 else None

    def curve(place: float) -> NDArray[Any]:
        k = min(max(int(np.searchsorted(x, place)), 1), len(x) - 1) - 1
        t = (place - x[k]) / (x[k + 1] - x[k])
        value = y[k] + t * rise[k]
        if bend is not None:
            cubic = (1.0 - t) * (bend[k] - slope[k]) - t * (bend[k + 1] - slope[k])
            value = value + step[k] * t * (1.0 - t) * cubic
        return np.asarray(value)

    return curve


def _monotone_slopes(step: NDArray[Any], slope: NDArray[Any]) -> NDArray[Any]:
    """Return slopes (n, ...) at points, from those between them and their steps: a weighted harmonic mean of the two on
    either side, 0 where these differ in sign; at both ends that of a parabola, as far as it keeps to the sign.
    """
    before, after, wide, wider = slope[:-1], slope[1:], step[:-1] + 2.0 * step[1:], 2.0 * step[:-1] + step[1:]
    same = before * after > 0.0
    mean = wide / np.where(same, before, 1.0) + wider / np.where(same, after, 1.0)
    inner = np.where(same, (wide + wider) / np.where(same, mean, 1.0), 0.0)
    ends = []
    for near, far in ((0, 1), (-1, -2)):
        first, second = slope[near], slope[far]
        end = ((2.0 * step[near] + step[far]) * first - step[near] * second) / (step[near] + step[far])
        end = np.where((first * second < 0.0) & (np.abs(end) > 3.0 * np.abs(first)), 3.0 * first, end)
        ends.append(np.where(end * first > 0.0, end, 0.0)[None])
    return np.concatenate([ends[0], inner, ends[1]])
