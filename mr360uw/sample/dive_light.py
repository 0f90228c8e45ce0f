# SPDX-License-Identifier: Apache-2.0
"""Light in the water of a synthetic dive, solved for its sun and its sky: veil, image and irradiance of the floor.

    E(d) = s_sky E_sky(d)/E_sky(0) + s_sun E_sun(d)/E_sun(0) + s_sun (u(d) (C - 1) + (v(d) - u(d)) (B - 1))

E: downwelling irradiance at the depth d. s: fractions (RGB) of the irradiance just below the surface. C: caustic
pattern, mean 1, of the light that has not been scattered, u = exp(-c d/sun_up). B: that of the light turned by small
angles, the rest of the beam v. sun_up: y of the sun's direction in the water. The sun's field E_sun holds its beam and
all that has left it.
"""

from __future__ import annotations

import numpy as np

from mr360uw.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R
from mr360uw.medium import Medium, Water
from mr360uw.medium.jerlov import JerlovType
from mr360uw.medium.lookup import beam_fraction, transmittance_lookup, veil_lookup
from mr360uw.medium.small_angles import spread_of
from mr360uw.medium.spectral.sensor import DEFAULT_SENSOR, named_sensor
from mr360uw.types import BeamSpread, Floats

SENSOR = DEFAULT_SENSOR
"""Sensor of the clip. A camera's responses are nowhere negative, so light adds up in each channel."""
SUN_SHARE = 0.7
"""Fraction of the downwelling irradiance below the surface that is the sun's beam: a clear sky with the sun high."""
SKY_COLOR = (1.0 - SUN_SHARE) * np.array([CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B])
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
        parts = ((color, medium.light.display(medium.model.irradiance(depth_m, 1.0))) for color, medium in self._parts)
        return sum((color * light for color, light in parts), np.zeros(3))

    def beam(self, depth_m: float) -> Floats:
        """Return the part (3,) of that irradiance that comes from about the sun: its beam, with what is scattered
        forwards.
        """
        return (1.0 - SKY_COLOR) * beam_fraction(self._sun.table, depth_m, self._sun_up)

    @property
    def spread(self) -> BeamSpread | None:
        """Spread of the beam by small angles."""
        return spread_of(self._sun)

    def patterned(self, depth_m: float) -> Floats:
        """Return the part (3,) of that irradiance that carries the waves' pattern: the sun's, not scattered."""
        unscattered = np.exp(-self._sun.model.attenuation * depth_m / self._sun_up)
        return (1.0 - SKY_COLOR) * self._sun.light.display(unscattered)
