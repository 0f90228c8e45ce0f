# SPDX-License-Identifier: Apache-2.0
"""Directions over a light's disc and footprints of pixels, for the fraction of the disc that bodies leave visible.

Visibility is the mean over directions that fill the disc, each from a place of its own in the footprint.
Light that the water has scattered forwards comes from a wider disc: a Gaussian spread of standard deviation sigma is
taken as a disc of the same second moment (`sphere.effective_half_angle`). The device traces the same rays through
filtered columns (gl/shaders/shadow.glsl).

A footprint is the area of a surface that a pixel shows. A shadow's edge may be narrower than a pixel. Its mean over the
pixel is the mean over rays that start from the whole footprint, a parallelogram in the plane of the surface. Its sides
come from the derivatives of the visible point P by the frame coordinates, taken as differences over a step s:

    side_k = dP/dx m_xk + dP/dy m_yk        dP/dx = (P(x + s, y) - P(x, y))/s

with m the symmetric matrix (2, 2) of an area in the frame (see sampling.py); the unit matrix is a whole pixel. On the
device: footprint.glsl.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import LONGEST_FOOTPRINT
from mr360uw.types import Floats, View


def pixel_steps(point: Floats, normal: Floats, neighbours: Floats, step: float) -> Floats:
    """Return the derivatives (n, 2, 3) [m] of points (n, 3) on planes by the frame's columns and rows.

    neighbours: (n, 2, 3) directions that lie `step` pixels to the right and below. On slanted planes a derivative is at
    most `LONGEST_FOOTPRINT` times as long as across the ray; beyond the plane's horizon it is the one across the ray.
    """
    distance = np.linalg.norm(point, axis=-1)[:, None, None]
    cosine, height = (np.einsum("nk,n...k->n...", normal, a) for a in (neighbours, point))
    along = height[:, None] / np.where(np.abs(cosine) > 1e-6, cosine, np.inf)
    flat = neighbours * distance - point[:, None]
    slanted = neighbours * along[..., None] - point[:, None]
    longest = LONGEST_FOOTPRINT * np.linalg.norm(flat, axis=-1)
    shorter = np.minimum(longest / np.maximum(np.linalg.norm(slanted, axis=-1), 1e-30), 1.0)
    steps = np.where(along[..., None] > 0.0, slanted * shorter[..., None], flat)
    return np.asarray(steps / step)


def pixel_footprint(
    view: View, x: Floats, y: Floats, point: Floats, normal: Floats, area: Floats | None = None
) -> Floats:
    """Return the sides (n, 2, 3) [m] of the footprints of areas (n, 5) of the frame about frame coordinates (n,), whole
    pixels if not given.

    point, normal: (n, 3) of the surface seen there.
    """
    neighbours = np.stack([view.directions(x + 1.0, y), view.directions(x, y + 1.0)], axis=1)
    seen = point - view.starts(view.directions(x, y)) if view.eye_m else point
    steps = pixel_steps(seen, normal, neighbours, 1.0)
    return steps if area is None else footprint(point, steps, area)[1]


def footprint(point: Floats, steps: Floats, area: Floats) -> tuple[Floats, Floats]:
    """Return the middles (n, 3) and the sides (n, 2, 3) [m] of the parallelograms that areas (n, 5) of the frame
    (`sampling.frame_areas`) have about points (n, 3), from the camera in the world's axes.

    steps: (n, 2, 3) of `pixel_steps`.
    """
    x, y = steps[:, 0], steps[:, 1]
    ox, oy, xx, xy, yy = area.T[..., None]
    return point + ox * x + oy * y, np.stack([xx * x + xy * y, xy * x + yy * y], axis=1)


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


Passed = Callable[[NDArray[np.int64], Floats, NDArray[np.int64]], Floats]
"""Fraction (m,) of the light that is left of rays in directions of given numbers from starts (m, 3), moved points of
indices (m,)."""
_RAYS_AT_ONCE = 1 << 16
"""Rays traced together, which bounds memory."""


def visible_fraction(passed: Passed, start: Floats, sides: Floats | None, count: int) -> Floats:
    """Return the fraction (n,) of the light of rays in `count` directions that is left, each from its own place of the
    footprint.

    start: (n, 3) middles, sides: (n, 2, 3) of the footprints; None for points. At the edge of a shadow,
    every direction is taken from `_ROUNDS` places.
    """
    every, directions, places = np.arange(len(start)), np.arange(count), pixel_offsets(count)
    if sides is None:
        return _free(passed, start, np.zeros((len(start), 2, 3)), directions, places, every) / count
    seen = _free(passed, start, sides, directions, places, every)
    partly = (seen > 0) & (seen < count)
    fine = np.flatnonzero(partly | _reaches_edge(passed, start, sides, seen, count))
    turns = np.arange(1, _ROUNDS)[:, None, None] * _TURN_OF_PLACES
    more = (np.remainder(places + 0.5 + turns, 1.0) - 0.5).reshape(-1, 2)
    fraction = seen / count
    again = _free(passed, start, sides, np.tile(directions, _ROUNDS - 1), more, fine)
    fraction[fine] = (seen[fine] + again) / (_ROUNDS * count)
    return np.asarray(fraction)


def _free(
    passed: Passed,
    start: Floats,
    sides: Floats,
    directions: NDArray[np.int64],
    places: Floats,
    chosen: NDArray[np.int64],
) -> Floats:
    """Return how many (m,) of the rays from chosen points (m,) are free, each by the fraction of its light that is
    left, which start at places (r, 2) in [-0.5, 0.5]^2 of their footprints in directions of given numbers (r,).
    """
    seen = np.zeros(len(chosen))
    begin, across, at_once = start[chosen], sides[chosen], max(_RAYS_AT_ONCE // max(len(chosen), 1), 1)
    for first in range(0, len(places), at_once):
        some, number = places[first : first + at_once], directions[first : first + at_once]
        begins = begin + np.einsum("rp,mpk->rmk", some, across)
        free = passed(np.repeat(number, len(chosen)), begins.reshape(-1, 3), np.tile(chosen, len(some)))
        seen += free.reshape(len(some), -1).sum(axis=0)
    return seen


def _reaches_edge(passed: Passed, start: Floats, sides: Floats, seen: Floats, count: int) -> NDArray[np.bool_]:
    """Return where (n,) all rays were free, or all blocked, but one from a corner of the footprint is not."""
    other = np.zeros(len(start), np.bool_)
    same = np.flatnonzero((seen == 0) | (seen == count))
    outermost = count - 1 - np.arange(4) * max(count // 13, 1)
    corners = np.repeat([(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)], len(outermost), axis=0)
    free = _free(passed, start, sides, np.tile(outermost, 4), corners, same)
    other[same] = free != np.where(seen[same] > 0, len(corners), 0)
    return other
