# SPDX-License-Identifier: Apache-2.0
"""The middle of a sun's glitter, seen from under water.

Waves break a clipped sun into patches that come and go, and the largest of them wanders by degrees. What hardly moves
is the middle of all that is bright near it. It is that of the sun where the waves' slopes are as often up as down: each
direction of the water stands for the slope of a facet that refracts the sun's light into it, and the middle is taken
over these slopes (a mean shift under a Gaussian window, Comaniciu 2002). Over directions it would be up to 6 degrees
too high: towards the edge of Snell's window the same angle takes twice the slope.
"""

from __future__ import annotations

import functools

import numpy as np

from mr360uw.ibl.level.tilt import level_matrix, roll_pitch
from mr360uw.ibl.plate import Plate
from mr360uw.ibl.sun.blob import brightness
from mr360uw.optics import refract_clamped, refract_to_air
from mr360uw.sphere import unit
from mr360uw.types import Floats

_WINDOW = 0.35
"""Standard deviation of the window, a slope: half as large, the middle of a wide plateau is hardly found; twice as
large, the window's edge and the sky far from the sun count."""
_REACH, _PIXELS = 2.0, 49
"""Radius of the patch in windows, and its size."""
_FLOOR = 0.7
"""Brightness over the patch's largest that counts as the sun's; the sky of a clipped plate is half as bright."""
_ROUNDS = 16
"""Most rounds; each takes a half to a fifth of the way to the middle."""
_STILL_COSINE = 1.0 - 0.5 * np.radians(0.02) ** 2
"""Cosine of the step at which the search ends."""
_FARTHEST_COSINE = np.cos(np.radians(12.0))
"""Cosine of the largest correction; a middle further off is that of something else."""


def glitter_middle(plate: Plate, direction: Floats) -> Floats:
    """Return the direction (3,) in the water of the sun whose largest patch is seen towards `direction` (3,)."""
    level = level_matrix(*map(float, roll_pitch(plate.up)))
    start = level @ direction
    if start[1] <= 0.0:
        return direction
    index = plate.refractive_index
    place: Floats = start
    slope, normal, window = _patch()
    for _ in range(_ROUNDS):
        in_air = refract_to_air(place, index)
        seen, lit = _through_facets(in_air, normal, index)
        value = np.where(lit, brightness(plate.look(seen @ level)), 0.0)
        weight = np.maximum(value - _FLOOR * float(value.max()), 0.0) * window
        if float(weight.sum()) <= 0.0:
            return direction
        middle = np.tensordot(weight, slope, 2) / weight.sum()
        before, place = place, _through_facets(in_air, _normals(middle), index)[0]
        if place[1] <= 0.0:
            return direction
        if float(before @ place) > _STILL_COSINE:
            break
    return place @ level if float(place @ start) > _FARTHEST_COSINE else direction


@functools.cache
def _patch() -> tuple[Floats, Floats, Floats]:
    """Return the slopes (n, n, 2) of the patch, the normals (n, n, 3) of their facets and their weights (n, n)."""
    axis = np.linspace(-_REACH * _WINDOW, _REACH * _WINDOW, _PIXELS)
    slope = np.stack(np.meshgrid(axis, axis), axis=-1)
    return slope, _normals(slope), np.exp(-0.5 * np.sum(slope**2, axis=-1) / _WINDOW**2)


def _normals(slope: Floats) -> Floats:
    """Return the unit normals (..., 3) of facets of slopes (..., 2) over (x, z)."""
    return unit(np.stack([-slope[..., 0], np.ones(slope.shape[:-1]), -slope[..., 1]], axis=-1))


def _through_facets(sun_in_air: Floats, normal: Floats, index: float) -> tuple[Floats, np.ndarray]:
    """Return the directions (..., 3) in the water towards the sun through facets of normals (..., 3), and which of them
    the sun shines on.
    """
    lit = normal @ sun_in_air > 0.0
    travel = refract_clamped(np.broadcast_to(-sun_in_air, normal.shape), normal, 1.0 / index)
    return unit(-travel), lit
