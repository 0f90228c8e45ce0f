# SPDX-License-Identifier: Apache-2.0
"""Light of the sky that a clipped plate lost under water, restored from the solved field.

    A' + S' = g E(d)        A' = A + sum over clipped pixels of (f - 1) w L

A, S: horizontal irradiance at the camera of ambient light and of the sun; g: gain of the veil, which open water at the
horizon tells without clipping; E: solved irradiance at the camera's depth for g = 1 and the sun's height; L: radiance
of a pixel of the environment, w: how far it is at display white. One factor f for each channel, 1 or more: what did not
clip stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import MINIMUM_SUN_UP
from mr360uw.ibl.cosine import cosine_beam, cosine_filter
from mr360uw.ibl.glossy import glossy_levels
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.sun.detect import DISPLAY_WHITE
from mr360uw.ibl.sun.split import with_sun
from mr360uw.medium import Medium
from mr360uw.medium.fit.level_light import irradiance_from_level
from mr360uw.render.lights import CLEAR_SKY_DIRECT
from mr360uw.sphere import directions
from mr360uw.types import Environment, Floats, Sun, YuvImage

Array = NDArray[np.float64]

_FROM, _TO = 0.8, 0.95
"""Radiance of a pixel of the environment, a mean over hundreds of the plate's, from which it counts as partly and as
wholly clipped. A sky that is as bright without clipping is raised too, as far as the whole light is too weak."""
_MOST = 2.0
"""Greatest ratio of restored to shown light: one stop. A type of water that is not the plate's misleads by no more."""
_LEAST_SHARE = 0.02
"""Fraction of the ambient light that clipped pixels must bring for them to be raised; wholly from twice as much on."""


def may_be_clipped(pixels: Floats | YuvImage, settings: LightSettings) -> bool:
    """Return whether a plate ends at display white, so that its light may be more than it shows."""
    if settings.operator != "closure":
        return False
    return isinstance(pixels, YuvImage) or float(pixels.max()) <= DISPLAY_WHITE


def restored(light: Environment, medium: Medium, up: Floats, *, keep_sun: bool) -> Environment:
    """Return the light of a clipped plate with what its clipped pixels lost.

    medium: of the camera, with the gain of the plate's veil; of mode "table", others have no solved irradiance and
    change nothing. up: (3,) of the world in the environment's axes. keep_sun: whether the sun's strength is known;
    otherwise it gets what the ambient light leaves of the whole.
    """
    if medium.mode != "table":
        return light
    sun_up = None if light.sun is None else max(float(light.sun.direction @ up), MINIMUM_SUN_UP)
    whole = irradiance_from_level(medium, sun_up, CLEAR_SKY_DIRECT)
    shown = np.maximum(environment_lookup(light.ambient, up), 1e-12)
    beam = np.zeros(3) if light.sun is None else light.sun.irradiance * max(float(light.sun.direction @ up), 0.0)
    wanted = whole - beam if keep_sun else shown * whole / (shown + beam)
    above = directions(*light.residual.shape[1::-1]) @ up > 0.0
    white = np.clip((light.residual - _FROM) / (_TO - _FROM), 0.0, 1.0) * light.residual * above[..., None]
    clipped = cosine_filter(1)(white)
    share = environment_lookup(clipped, up) / shown
    told = np.clip(share / _LEAST_SHARE - 1.0, 0.0, 1.0)
    if not np.any(told > 0.0):
        return light
    growth = told * (np.clip(wanted / shown, 1.0, _MOST) - 1.0)
    factor = growth / np.maximum(share, _LEAST_SHARE)
    of_sun = np.ones(3)
    if light.sun is not None and not keep_sun:
        left = np.clip((whole - shown * (1.0 + growth)) / np.maximum(beam, 1e-12), 1.0 / _MOST, _MOST)
        of_sun += told.max() * (left - 1.0)
    return _brighter(light, factor * white, factor * clipped, of_sun)


def _brighter(light: Environment, radiance: Floats, irradiance: Floats, of_sun: Array) -> Environment:
    """Return an environment with more radiance (32, 64, 3), whose cosine integral is given, and a stronger sun."""
    sun: Sun | None = None
    if light.sun is not None:
        sun = replace(light.sun, irradiance=(light.sun.irradiance * of_sun).astype(np.float32))
    residual = (light.residual + radiance).astype(np.float32)
    ambient = (light.ambient + irradiance).astype(np.float32)
    roughness = tuple(float(r) for r in light.glossy_roughness)
    return replace(
        light,
        radiance=residual if sun is None else with_sun(residual, sun),
        irradiance=ambient if sun is None else ambient + cosine_beam(sun.direction, sun.irradiance),
        sun=sun,
        residual=residual,
        ambient=ambient,
        glossy=light.glossy + glossy_levels(radiance, roughness) if len(light.glossy) else light.glossy,
    )
