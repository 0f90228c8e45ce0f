# SPDX-License-Identifier: Apache-2.0
"""Light in the water of a synthetic dive, solved for its sun and its sky: veil, image and irradiance of the floor.

    E(d) = s_sky E_sky(d)/E_sky(0) + s_sun E_sun(d)/E_sun(0) + s_sun u(d) (C - 1)        u = exp(-c d/sun_up)

E: downwelling irradiance at the depth d. s: fractions (RGB) of the irradiance just below the surface. C: caustic
pattern, mean 1, of the light that has not been scattered, u. sun_up: y of the sun's direction in the water. The sun's
field E_sun holds its beam and all that has left it.
"""

from __future__ import annotations

import numpy as np

from mr360uw.medium import Medium, Water
from mr360uw.medium.jerlov import JerlovType
from mr360uw.medium.lookup import transmittance_lookup, veil_lookup
from mr360uw.medium.spectral.sensor import named_sensor
from mr360uw.types import Floats

SENSOR = "CIE 1931"
"""Sensor of the clip: its code values are colours, not raw camera values."""
SUN_SHARE = 0.7
"""Fraction of the downwelling irradiance below the surface that is the sun's beam: a clear sky with the sun high."""
SKY_COLOR = (1.0 - SUN_SHARE) * np.array([0.82, 1.03, 1.25])
"""Fraction (3,) of that irradiance from the sky, which is blue; the sun, slightly yellow, gives the rest."""


class DiveLight:
    """The solved light of a water under a sun at `sun_up` (y of its direction in the water) for a camera's depth."""

    def __init__(self, water: JerlovType, camera_depth_m: float, sun_up: float) -> None:
        of = Water.jerlov(water), named_sensor(SENSOR)
        sky = Medium(*of, camera_depth_m=camera_depth_m)
        sun = Medium(*of, camera_depth_m=camera_depth_m, sky=("sun", sun_up, 1.0))
        self._parts = ((SKY_COLOR, sky), (1.0 - SKY_COLOR, sun))
        self._sun, self._sun_up = sun, sun_up

    def veil(self, distance_m: Floats, up: Floats) -> Floats:
        """Return the radiance (..., 3) that the water adds to camera rays, per unit irradiance below the surface."""
        return sum((color * veil_lookup(m.table, distance_m, up) for color, m in self._parts), np.zeros(3))

    def transmittance(self, distance_m: Floats, up: Floats) -> Floats:
        """Return the factor (..., 3) on the radiance at the end of camera rays."""
        return transmittance_lookup(self._sun.table, distance_m, up)

    def irradiance(self, depth_m: float) -> Floats:
        """Return the downwelling irradiance (3,) at a depth, all light, over that just below the surface."""
        depths = np.array([depth_m, 0.0])
        logs = [(color, medium.light.ambient_log(depths)) for color, medium in self._parts]
        return sum((color * np.exp(log[0] - log[1]) for color, log in logs), np.zeros(3))

    def patterned(self, depth_m: float) -> Floats:
        """Return the part (3,) of that irradiance that carries the waves' pattern: the sun's, not scattered."""
        log = self._sun.light.beam_log(np.array(depth_m / self._sun_up), self._sun.model.attenuation)
        return (1.0 - SKY_COLOR) * np.exp(log)
