# SPDX-License-Identifier: Apache-2.0
"""The sky over a synthetic dive: sun and dome, clear or overcast, or of a picture of the sky.

The unit is the irradiance just below a level surface: of a clear sky with the sun at 45 degrees or more, and of an
overcast one, it is 1 in each channel, since a camera's white balance makes daylight white. Under a lower sun the beam
is redder and the rest is not, so the sum is warm.

The dome is a standard sky (`surface.sky`). Its colour in each direction is that of light scattered once along
the way, 1 - exp(-depth m), m: air mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw.color import luminance
from mr360uw.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.ibl import environment
from mr360uw.ibl.sun.closure import CLEAR_SKY, air_mass, beam_below, clear_air_depth, direct_share
from mr360uw.optics import fresnel_transmittance
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sphere import directions, row_solid_angle, unit
from mr360uw.surface.sky import CLEAR, LOWEST_SINE, OVERCAST, SKY_ROWS, Dome, standard_sky, sun_below
from mr360uw.types import Floats, Sun

_GLARE_RAD = 0.05
"""Radius [rad] about the sun of a map within which light above the ring around it counts as the sun's."""


@dataclass(frozen=True, slots=True, eq=False)
class DiveSky:
    """dome: (h, w, 3) radiance of the sky without the sun. sun: as seen in the air, or None."""

    dome: Floats
    sun: Sun | None

    @property
    def sky_below(self) -> Floats:
        """Irradiance (3,) just below a level surface that the dome brings."""
        return Dome(self.dome).irradiance_below(REFRACTIVE_INDEX_SEA)

    @property
    def sun_below(self) -> Floats:
        """The same that the sun brings."""
        return sun_below(self.sun, REFRACTIVE_INDEX_SEA)

    @property
    def sun_share(self) -> float:
        """Fraction of the luminance just below the surface that is the sun's."""
        sun = float(luminance(self.sun_below))
        return sun / (sun + float(luminance(self.sky_below)))


def dive_sky(settings: DiveSettings) -> DiveSky:
    """Return the sky of a dive; raise `VideoError` or `ParameterError` for a picture that is none of the sky."""
    if settings.sky_map is not None:
        return sky_of_map(settings.sky_map)
    if settings.sky == "overcast":
        return DiveSky(_scaled(standard_sky(OVERCAST, np.array([0.0, 1.0, 0.0]))[..., None], np.ones(3)), None)
    toward = settings.sun_in_air
    sine = float(toward[1])
    share = direct_share(sine) if settings.sun_share is None else settings.sun_share
    beam = beam_below(share, sine)
    passed = fresnel_transmittance(sine, REFRACTIVE_INDEX_SEA)
    sun = Sun(toward, beam / (sine * passed), SUN_HALF_ANGLE_RAD, 1.0)
    shape = (
        np.ones((SKY_ROWS, 2 * SKY_ROWS, 1))
        if settings.sky == "even"
        else standard_sky(CLEAR, toward)[..., None] * _scattered()
    )
    return DiveSky(_scaled(shape, (1.0 - share) * CLEAR_SKY), sun)


def sky_of_map(path: Path) -> DiveSky:
    """Return the sky of an equirectangular HDR picture, its sun apart, in units of its light just below the surface."""
    from mr360uw.video import open_video

    with open_video(path) as video:
        radiance = np.maximum(next(iter(video.frames())).image_linear, 0.0).astype(np.float64)
    found = environment(radiance.astype(np.float32), underwater=False).sun
    sky = DiveSky(radiance, None)
    if found is not None and found.direction[1] > LOWEST_SINE:
        sky = _without_sun(radiance, unit(found.direction))
    light = float(luminance(sky.sky_below + sky.sun_below))
    sun = sky.sun
    if sun is not None:
        sun = Sun(sun.direction, sun.irradiance / light, sun.half_angle_rad, 1.0)
    return DiveSky(sky.dome / light, sun)


def _without_sun(radiance: Floats, toward: Floats) -> DiveSky:
    """Return a map with what is brighter about the sun than the ring around it as a sun of true size."""
    height, width = radiance.shape[:2]
    apart = np.arccos(np.clip(directions(width, height) @ toward, -1.0, 1.0))
    reach = max(_GLARE_RAD, 3.0 * np.pi / height)
    near, ring = apart < reach, (apart >= reach) & (apart < 1.5 * reach)
    even = np.median(radiance[ring], axis=0)
    weight = np.broadcast_to(row_solid_angle(width, height)[:, None], apart.shape)[near]
    excess = np.maximum(radiance[near] - even, 0.0)
    dome = radiance.copy()
    dome[near] -= excess
    return DiveSky(dome, Sun(toward, weight @ excess, SUN_HALF_ANGLE_RAD, 1.0))


def _scattered() -> Floats:
    """Return the colour (SKY_ROWS, 1, 3), of luminance 1, of light scattered once in clear air, row by row."""
    sine = np.maximum(np.abs(directions(2, SKY_ROWS)[:, 0, 1]), LOWEST_SINE)
    mass = np.array([air_mass(float(s)) for s in sine])[:, None]
    colour = 1.0 - np.exp(-clear_air_depth() * mass)
    return np.asarray(colour / luminance(colour)[:, None])[:, None]


def _scaled(radiance: Floats, below: Floats) -> Floats:
    """Return a map whose light just below the surface is `below` (3,)."""
    shape = np.broadcast_to(radiance, (*radiance.shape[:2], 3)).copy()
    return np.asarray(shape * (below / Dome(shape).irradiance_below(REFRACTIVE_INDEX_SEA)))
