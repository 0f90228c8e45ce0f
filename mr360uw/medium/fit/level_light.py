# SPDX-License-Identifier: Apache-2.0
"""Irradiance at the camera from the light of open water at the horizon, for the sun's height.

    E = g l e_s/l_s

g, l: gain and level radiance of a medium, whose product is what the plate shows; e_s, l_s: irradiance and level
radiance of the same water under a sun of that height, typical of all azimuths as the gain is. A high sun sends less of
its light along the horizon than a uniform sky: under a uniform sky alone E would be a fifth too low. How strong the sun
is beside the sky matters less: a beam of 0.6 instead of 0.75 of the light makes 5 %.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.around_sun import around_sun, placed, typical_level
from mr360uw.medium.medium import Medium
from mr360uw.medium.spectral.sensor import Sensor
from mr360uw.medium.water import Water

Array = NDArray[np.float64]

_STEP = 0.01
"""Interval of the sine of the sun's elevation in the water at which fields are solved: 0.3 % of E."""
_COARSE = 0.05
"""The same for what is typical of the azimuths: 0.5 % of E."""
_LEVEL = np.zeros(1)


def irradiance_from_level(medium: Medium, sun_up: float | None, direct: float) -> Array:
    """Return the irradiance (3,) of a level plane at the camera, sun included, in the medium's light times its gain.

    sun_up: y of the sun's direction in the water, in (0, 1], or None where it is not known. direct: fraction of the
    light just below the surface that is its beam. A medium that was solved for a sun, or without a surface, keeps its
    own. medium: of mode "table".
    """
    depth = medium.camera_depth_m
    if sun_up is None or medium.sky != "uniform" or medium.surface == "none":
        return np.maximum(medium.irradiance(depth), 0.0)
    up = min(max(round(sun_up / _STEP), 1) * _STEP, 1.0)
    ratio = _ratio(medium.water, medium.sensor, medium.illuminant, medium.refractive_index, up, direct, depth)
    return np.asarray(medium.gain * medium.level_radiance(_LEVEL)[0] * ratio)


@functools.lru_cache(maxsize=64)
def _ratio(
    water: Water, sensor: Sensor, illuminant: str, refractive_index: float, sun_up: float, direct: float, depth_m: float
) -> Array:
    """Return e_s/l_s (3,) [sr] at a depth."""
    under_sun = _under_sun(water, sensor, illuminant, refractive_index, sun_up, direct)
    whole = under_sun.light.display(under_sun.model.irradiance(depth_m, 1.0))
    level = under_sun.light.display(under_sun.model.radiance(depth_m, _LEVEL))[0]
    coarse = min(max(round(sun_up / _COARSE), 1) * _COARSE, 1.0)
    lit = _under_sun(water, sensor, illuminant, refractive_index, coarse, direct).at_depth(depth_m)
    if (around := around_sun(lit)) is not None:
        level = level * typical_level(placed(around, np.array([1.0, 0.0, 0.0])))
    return np.asarray(whole / np.maximum(level, 1e-300))


@functools.lru_cache(maxsize=64)
def _under_sun(
    water: Water, sensor: Sensor, illuminant: str, refractive_index: float, sun_up: float, direct: float
) -> Medium:
    """Return the water under a sun and a sky. It takes 30 ms to solve."""
    return Medium(
        water, sensor, illuminant=illuminant, refractive_index=refractive_index, sky=("sun", sun_up, direct)
    )  # fmt: skip
