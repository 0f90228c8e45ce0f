# SPDX-License-Identifier: Apache-2.0
"""Directions over a light's disc, for the fraction of it that bodies leave visible.

Visibility is the mean over directions that fill the disc, each from a place of its own in the footprint (footprint.py).
Light that the water has scattered forwards comes from a wider disc: a Gaussian spread of standard deviation sigma is
taken as a disc of the same second moment (`sphere.effective_half_angle`). The device traces the same rays through
filtered columns (gl/shaders/shadow.glsl).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.lighting.footprint import moved
from mr360uw.types import Floats

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_STRIDE = 0.24
"""Step through the lattice of places, as a fraction of its points: of those tried, the one of least error at straight
edges whose penumbra is as wide as a pixel, 0.015 by 24 rays. Neighbours in the lattice (1/n) have twice that error."""
_WIDE_STRIDE = 0.54
"""The same for wide rays: edges at all angles, penumbrae of 0.03 to 3 pixels. RMS error 0.015 by 24 rays, 0.021
by 12; with `pixel_offsets` 0.018 and 0.027."""

_ROUNDS = 4
"""Places for each direction at the edge of a shadow. RMS error at straight edges: 0.006 of the
light; with one place 0.014."""
_TURN_OF_PLACES = np.array([0.7549, 0.5698])
"""Shift of the places from round to round: the additive sequence in two dimensions of least discrepancy (1/g and 1/g^2,
g^3 = g + 1)."""


def pixel_offsets(count: int) -> Floats:
    """Return places (count, 2) in [-0.5, 0.5]^2, one for each of `disc_offsets`, that fill a footprint evenly.

    A Fibonacci lattice, in an order in which every ring of the disc meets places all over the footprint: rays of
    direction k from place k sample the disc and the footprint at once.
    """
    k = _strided(count, _STRIDE)
    return np.stack([(k + 0.5) / count, np.remainder(0.5 + k * _GOLDEN, 1.0)], axis=-1) - 0.5


def wide_pixel_offsets(count: int) -> Floats:
    """Return what `pixel_offsets` does, for rays as wide as the part of the footprint that they represent.

    Wide rays fill the gaps of a grid. It has half as many columns as rows, because most footprints on the ground are
    twice as long as wide; every place has a row of its own.
    """
    k, columns = _strided(count, _WIDE_STRIDE), max(round(np.sqrt(0.5 * count)), 1)
    return np.stack([(k % columns + 0.5) / columns, (k + 0.5) / count], axis=-1) - 0.5


def _strided(count: int, stride: float) -> NDArray[np.int64]:
    """Return the numbers below `count` in steps of about a fraction of it, each once."""
    step = next(n for n in range(max(round(stride * count), 1), 2 * count + 2) if math.gcd(n, count) == 1)
    return np.arange(count) * step % count


Blocked = Callable[[int, Floats, NDArray[np.int64]], NDArray[np.bool_]]
"""Whether rays in direction k from starts (m, 3), moved points of the given indices (m,), are blocked, (m,)."""


def visible_fraction(blocked: Blocked, start: Floats, sides: Floats | None, count: int) -> Floats:
    """Return the fraction (n,) of rays in `count` directions that are free, each from its own place of the footprint.

    start: (n, 3) middles, sides: (n, 2, 3) of the footprints; None for points. At the edge of a shadow,
    every direction is taken from `_ROUNDS` places.
    """
    seen, every = np.zeros(len(start)), np.arange(len(start))
    places = pixel_offsets(count)
    for k, place in enumerate(places):
        seen += ~blocked(k, moved(start, sides, place), every)
    if sides is None:
        return seen / count
    partly = (seen > 0.0) & (seen < count)
    fine = np.flatnonzero(partly | _reaches_edge(blocked, start, sides, seen, count))
    for turn in range(1, _ROUNDS):
        for k, place in enumerate(np.remainder(places + 0.5 + turn * _TURN_OF_PLACES, 1.0) - 0.5):
            seen[fine] += ~blocked(k, moved(start[fine], sides[fine], place), fine)
    seen[fine] /= _ROUNDS
    return seen / count


def _reaches_edge(blocked: Blocked, start: Floats, sides: Floats, seen: Floats, count: int) -> NDArray[np.bool_]:
    """Return where (n,) all rays were free, or all blocked, but one from a corner of the footprint is not."""
    other = np.zeros(len(start), np.bool_)
    same = np.flatnonzero((seen == 0.0) | (seen == count))
    outermost = count - 1 - np.arange(4) * max(count // 13, 1)
    for corner in np.array([(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)]):
        for k in outermost:
            free = ~blocked(int(k), moved(start[same], sides[same], corner), same)
            other[same] |= free != (seen[same] > 0.0)
    return other
