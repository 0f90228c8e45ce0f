# SPDX-License-Identifier: Apache-2.0
"""Light just below a level surface as bodies in the water need it: a map of radiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import PI
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.optics import radiance_factor, refract_to_air
from mr360uw.sphere import directions
from mr360uw.surface import SeaScene

Array = NDArray[np.float64]


def light_below(sea: SeaScene, floor_depth_m: float) -> Array:
    """Return the radiance (128, 256, 3) just below a level surface by direction, without the sun's beam.

    From above: the sky through Snell's window, and outside of it the mirrored light from below. From below: the floor
    at its mean light, behind the water.
    """
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    up = towards[..., 1]
    flat = np.minimum(up, -1e-3).ravel()
    water = sea.light_in_water(floor_depth_m)
    passed, veil = water.along(floor_depth_m / -flat, flat, from_camera=False)
    assert water.floor is not None
    veil = veil * water.about_sun(towards.reshape(-1, 3))
    below = (passed * water.floor.radiance + veil).reshape(towards.shape)
    window = up > np.sqrt(1.0 - 1.0 / sea.refractive_index**2)
    air = refract_to_air(np.where(window[..., None], towards, [0.0, 1.0, 0.0]), sea.refractive_index)
    factor = radiance_factor(np.clip(air[..., 1], 0.0, 1.0), sea.refractive_index)
    footprint = np.full(up.size, PI / COARSE_ROWS)
    sky = factor[..., None] * sea.dome.look(air.reshape(-1, 3), footprint).reshape(towards.shape)
    lost = np.where(window, 1.0 - factor / sea.refractive_index**2, 1.0)[..., None]
    above = np.where(window[..., None], sky, 0.0) + lost * below[::-1]
    return np.asarray(np.where(up[..., None] > 0.0, above, below))
