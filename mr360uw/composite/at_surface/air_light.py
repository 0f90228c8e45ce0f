# SPDX-License-Identifier: Apache-2.0
"""Light of the air above an underwater plate, for what stands out of the water.

    symbol  meaning
    n       refractive index of the water
    t, R    transmittance and reflectance of a level surface for irradiance (Fresnel), at an angle in the air
    L_w     radiance just below the surface: the plate's, with what the water above the camera has taken

Radiance over the squared index is kept but for reflection, so the sky is L = (L_w - R D)/(n^2 t), seen in the refracted
direction, with D the water's light that the surface mirrors there. From below comes R L + t D/n^2. The sun's
beam has the power per level area that passes the surface, E cos = E_w cos_w/t.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.composite.lighting.sun import sun_of, sun_up
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.medium.lookup import ambient_ratio, beam_ratio
from mr360uw.optics import fresnel_transmittance, refract_to_air, refract_to_water
from mr360uw.sphere import directions
from mr360uw.types import Floats, Light, Sun

_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in the air below which it gives no light: nearly all of it is reflected."""
_LEAST_PASSED = 0.05
"""Least transmittance that the sky is divided by: at the horizon, where hardly any of its light is left."""


def in_air(shot: Shot) -> Shot:
    """Return a shot of the same bodies in the light of the air, without water and caustics.

    shot: of a camera in the water.
    """
    if shot.medium is None:
        return shot
    sun = _sun_in_air(shot)
    roughness = tuple(shot.environment.glossy_roughness.tolist()) if len(shot.environment.glossy) else ()
    light = assemble(_sky(shot), sun, roughness)
    lamps: tuple[Light, ...] = tuple(one for one in shot.lights if not isinstance(one, Sun))
    lights = lamps if sun is None else (sun, *lamps)
    return replace(shot, environment=light, lights=lights, medium=None, caustics=None, knots=None)


def _sky(shot: Shot) -> Floats:
    """Return the radiance (128, 256, 3) of all directions in the air, without the sun."""
    n, medium = shot.refractive_index, shot.medium
    assert medium is not None
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    up = towards * np.array([1.0, 0.0, 1.0]) + np.abs(towards) * np.array([0.0, 1.0, 0.0])
    passed = fresnel_transmittance(up[..., 1], n)[..., None]
    below = refract_to_water(up, n)
    at_surface = ambient_ratio(medium, 0.0)
    residual = shot.environment.residual
    deep = environment_lookup(residual, below * np.array([1.0, -1.0, 1.0])) * at_surface
    sent = environment_lookup(residual, below) * at_surface - (1.0 - passed) * deep
    sky = np.maximum(sent, 0.0) / (n * n * np.maximum(passed, _LEAST_PASSED))
    under = (1.0 - passed) * sky + passed * deep / (n * n)
    return np.where(towards[..., 1:2] > 0.0, sky, under).astype(np.float32)


def _sun_in_air(shot: Shot) -> Sun | None:
    sun, n = sun_of(shot), shot.refractive_index
    if sun is None or shot.medium is None:
        return None
    direction = refract_to_air(sun.direction, n)
    if direction[1] < _LOWEST_SUN:
        return None
    below = sun.irradiance * beam_ratio(shot.medium, 0.0, sun_up(sun)) * sun.direction[1]
    irradiance = below / (direction[1] * float(fresnel_transmittance(direction[1], n)))
    return Sun(direction, np.asarray(irradiance, np.float64), sun.half_angle_rad * n, sun.confidence)
