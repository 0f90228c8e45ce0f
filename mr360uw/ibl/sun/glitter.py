# SPDX-License-Identifier: Apache-2.0
"""The middle of a sun's glitter, seen from under water.

Waves break a clipped sun into patches that come and go, and the largest of them wanders by degrees. What hardly moves
is the middle of all that is bright near it, and it is that of the sun only where the glow about the sun is round: above
the surface. A flat surface squeezes it towards the edge of Snell's window, so the middle is taken in the air (a mean
shift under a Gaussian window, Comaniciu 2002) and refracted back.
"""

from __future__ import annotations

import numpy as np

from mr360uw.ibl.level.tilt import level_matrix, roll_pitch
from mr360uw.ibl.plate import Plate
from mr360uw.ibl.sun.blob import brightness
from mr360uw.ibl.sun.tangent import patch_directions
from mr360uw.optics import refract_to_air, refract_to_water
from mr360uw.sphere import unit
from mr360uw.types import Floats

_WINDOW_RAD = np.radians(12.0)
"""Standard deviation [rad] of the window: waves of a light breeze spread the glitter over about as much."""
_REACH, _PIXELS = 3.0, 49
"""Radius of the patch in windows, and its size."""
_FLOOR = 0.7
"""Brightness over the patch's largest that counts as the sun's; the sky of a clipped plate is half as bright."""
_ROUNDS = 8
"""Most rounds; each halves the way to the middle at least."""
_STILL_COSINE = 1.0 - 0.5 * np.radians(0.02) ** 2
"""Cosine of the step at which the search ends."""
_LOWEST_SINE = 0.03
"""Least sine of the elevation in the air: lower light is at the very edge of the window."""
_FARTHEST_COSINE = np.cos(np.radians(8.0))
"""Cosine of the largest correction; a middle further off is that of something else."""


def glitter_middle(plate: Plate, direction: Floats) -> Floats:
    """Return the direction (3,) in the water of the sun whose largest patch is seen towards `direction` (3,)."""
    level = level_matrix(*map(float, roll_pitch(plate.up)))
    start = level @ direction
    if start[1] <= 0.0:
        return direction
    place = refract_to_air(start, plate.refractive_index)
    for _ in range(_ROUNDS):
        air = patch_directions(place, min(_REACH * _WINDOW_RAD, 1.0), _PIXELS)
        high = air[..., 1] > _LOWEST_SINE
        water = refract_to_water(np.where(high[..., None], air, [0.0, 1.0, 0.0]), plate.refractive_index)
        value = np.where(high, brightness(plate.look(water @ level)), 0.0)
        window = np.exp((air @ place - 1.0) / _WINDOW_RAD**2)
        weight = np.maximum(value - _FLOOR * float(value.max()), 0.0) * window
        if float(weight.sum()) <= 0.0:
            return direction
        before, place = place, unit(weight.ravel() @ air.reshape(-1, 3))
        if float(before @ place) > _STILL_COSINE:
            break
    if place[1] <= 0.0:
        return direction
    found: Floats = refract_to_water(place, plate.refractive_index)
    return found @ level if float(found @ start) > _FARTHEST_COSINE else direction
