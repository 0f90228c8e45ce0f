# SPDX-License-Identifier: Apache-2.0
"""Irradiance at the camera from the light of open water at the horizon, for the sun's height and the floor's light.

    l = s l_s + f l_f        u = s u_s + f u_f        E = s e_s + f e_f

l, u: light that the plate shows along the horizon, and on a level plane that faces down. l_s, u_s, e_s: the same and
the irradiance of a level plane that faces up, in the same water under a sun of that height over a black floor; l_f,
u_f, e_f: of a floor of radiance 1. Level light is what is typical of the azimuths, as the gain is. Without a floor
E = l e_s/l_s. A high sun sends less of its light along the horizon than a uniform sky: under a uniform sky alone E
would be a fifth too low. How strong the sun is beside the sky matters less: a beam of 0.6 instead of 0.75 makes 5 %.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.ambient import two_lights
from mr360uw.medium.around_sun import around_sun, placed, typical_level
from mr360uw.medium.medium import Medium
from mr360uw.medium.spectral.sensor import Sensor
from mr360uw.medium.transfer import Sky, SurfaceKind
from mr360uw.medium.water import Water
from mr360uw.types import Floats

Array = NDArray[np.float64]

_STEP = 0.01
"""Interval of the sine of the sun's elevation in the water at which fields are solved: 0.3 % of E."""
_COARSE = 0.05
"""The same for what is typical of the azimuths: 0.5 % of E."""
_LEVEL = np.zeros(1)


def irradiance_from_level(medium: Medium, sun_up: float | None, direct: Floats | float, upwelling: Floats) -> Array:
    """Return the irradiance (3,) of a level plane at the camera, sun included, in the medium's light times its gain.

    sun_up: y of the sun's direction in the water, in (0, 1], or None where it is not known. direct: fraction, (3,) or
    of all channels, of the light just below the surface that is its beam. upwelling: (3,) the plate's light on a level
    plane that faces down, which tells the floor's. A medium that was solved for a sun keeps its height. medium: of mode
    "table".
    """
    sky: Sky = medium.sky
    if isinstance(sky, tuple):
        sun_up, sky = sky[1], "uniform"
    of_water = medium.water, medium.sensor, medium.illuminant, medium.surface, medium.refractive_index
    at = medium.camera_depth_m, medium.floor_m
    of_sky, of_floor = _lights(*of_water, sky, *at)
    if sun_up is not None and medium.surface != "none":
        of_sun, _ = _lights(*of_water, ("sun", min(max(round(sun_up / _STEP), 1) * _STEP, 1.0), 1.0), *at)
        of_sky = (1.0 - direct) * of_sky + direct * of_sun
    shown = medium.gain * medium.level_radiance(_LEVEL)[0]
    strength, floor = two_lights(of_sky[:2], of_floor[:2], shown, np.asarray(upwelling, np.float64))
    return np.asarray(strength * of_sky[2] + floor * of_floor[2])


@functools.lru_cache(maxsize=64)
def _lights(
    water: Water, sensor: Sensor, illuminant: str, surface: SurfaceKind, refractive_index: float, sky: Sky,
    depth_m: float, floor_m: float | None,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the level light and the irradiance of level planes that face down and up (3, 3): of a sky, and of a floor
    of radiance 1. It takes 30 ms to solve.
    """
    medium = Medium(
        water, sensor, camera_depth_m=depth_m, illuminant=illuminant, surface=surface,
        refractive_index=refractive_index, sky=sky, floor_m=floor_m,
    )  # fmt: skip
    level, facing = medium.model.radiance(depth_m, _LEVEL), medium.model.irradiance(depth_m, np.array([-1.0, 1.0]))
    of_sky = medium.light.display(np.concatenate([level, facing]))
    if isinstance(sky, tuple):  # what is typical of the azimuths, as the gain is
        coarse = min(max(round(sky[1] / _COARSE), 1) * _COARSE, 1.0)
        if (around := around_sun(medium.under(("sun", coarse, 1.0)))) is not None:
            of_sky[0] *= typical_level(placed(around, np.array([1.0, 0.0, 0.0])))
    if floor_m is None:
        return of_sky, np.zeros((3, 3))
    return of_sky, np.stack([medium.floor_level, *(medium.floor_irradiance(depth_m, up) for up in (-1.0, 1.0))])
