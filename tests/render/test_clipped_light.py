# SPDX-License-Identifier: Apache-2.0
"""Light of clipped plates under water, restored from the solved field."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.optics import critical_cosine
from mr360uw.base.sphere import directions
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.settings import LightSettings
from mr360uw.medium import Medium, Water
from mr360uw.medium.scattered_light import around_sun, irradiance_from_level, placed, typical_level
from mr360uw.render.lights import lit_as_its_ground, may_be_clipped, restored
from mr360uw.types import Environment, Sun

UP = np.array([0.0, 1.0, 0.0])
DEPTH_M = 5.0
LEVEL_LOSS = 0.06
"""Relative: a beam of 0.6 of the light where 0.75 is assumed; a uniform sky, a beam of 0, is off by a fifth."""
SKY_LOSS = 0.02
"""Relative: this medium's sky is as white as its sun, and bluer where the light is restored."""
TYPICAL = 2e-3
"""Relative: the middle of the azimuths is chosen for the sun alone, and sky added to it."""
MAP_LOSS = 0.01
"""Relative: an environment of 64 x 32 is read between pixels, straight up."""


def sunlit(share: float) -> Medium:
    return Medium(Water.jerlov("II"), camera_depth_m=DEPTH_M, sky=("sun", 0.95, share))


def typical_of(medium: Medium) -> np.ndarray:
    """Return what is typical (3,) of level light over the azimuths about the sun, over its mean."""
    ratio = around_sun(medium)
    assert ratio is not None
    return typical_level(placed(ratio, UP[[1, 0, 0]]))


def shown(window: float, sun: Sun | None = None) -> Environment:
    """Return a white window over dark water."""
    up = directions(256, 128)[..., 1:2]
    light = np.where(up > critical_cosine(1.34), window, 0.1) * np.ones(3)
    return assemble(light.astype(np.float32), sun)


def test_the_horizon_tells_the_irradiance_under_any_sun() -> None:
    """The horizon of a water under a sun, read by a medium that was solved for a uniform sky."""
    for share in (0.6, 0.85):
        true, model = sunlit(share), Medium(Water.jerlov("II"), camera_depth_m=DEPTH_M)
        level = np.zeros(1)
        typical = typical_of(true)
        fitted = model.scaled(true.level_radiance(level)[0] * typical / model.level_radiance(level)[0])
        found = irradiance_from_level(fitted, 0.95, 0.75, np.zeros(3))
        np.testing.assert_allclose(found, true.irradiance(DEPTH_M), rtol=LEVEL_LOSS)
        assert np.all(fitted.irradiance(DEPTH_M) < 0.9 * true.irradiance(DEPTH_M))  # a uniform sky would not do
        own = irradiance_from_level(true.scaled(typical), 0.95, share, np.zeros(3))
        np.testing.assert_allclose(own, true.irradiance(DEPTH_M), rtol=TYPICAL)


@pytest.mark.parametrize("lit", [False, True])
def test_clipped_light_is_restored_to_the_whole(lit: bool) -> None:
    sun = Sun(UP, np.full(3, 0.5, np.float32), 0.004, 1.0) if lit else None
    light, medium = shown(0.99, sun), sunlit(0.75)
    before = environment_lookup(light.irradiance, UP)
    medium = medium.scaled(1.5 * before * typical_of(medium) / medium.irradiance(DEPTH_M))
    for keep in (False, True):
        found = restored(light, medium, UP, keep_sun=keep)
        np.testing.assert_allclose(environment_lookup(found.irradiance, UP), 1.5 * before, rtol=SKY_LOSS)
        assert found.sun is None or np.all(found.sun.irradiance > 0.5) != keep
        np.testing.assert_array_equal(found.residual[20:], light.residual[20:])  # the dark water stays


def test_what_is_not_clipped_stays() -> None:
    bright = sunlit(0.75).scaled(100.0)
    for light in (shown(0.6), shown(0.01)):
        assert restored(light, bright, UP, keep_sun=False) is light
    light, dim = shown(0.99), sunlit(0.75).scaled(0.01)
    assert restored(light, dim, UP, keep_sun=False) is light
    most = environment_lookup(restored(light, bright, UP, keep_sun=False).ambient, UP)
    np.testing.assert_allclose(most, 2.0 * environment_lookup(light.ambient, UP), rtol=MAP_LOSS)
    assert restored(light, Medium(Water.jerlov("II"), mode="kd").scaled(100.0), UP, keep_sun=False) is light


def test_scene_radiance_is_not_clipped() -> None:
    pixels = np.ones((8, 16, 3), np.float32)
    assert may_be_clipped(pixels, LightSettings())
    assert not may_be_clipped(3.0 * pixels, LightSettings())
    assert not may_be_clipped(pixels, LightSettings(operator="none"))


@pytest.mark.parametrize("sun_up", [0.0, 0.3, 1.0])
def test_ground_has_the_light_that_it_sends_back(sun_up: float) -> None:
    """A sky without red over sand with red, as a white balance leaves it, and a sky that is darker than the sand.

    Without a sun, and with a sun whose elevation has a sine.
    """
    up = directions(256, 128)[..., 1:2]
    light = np.where(up > 0.0, np.array([0.0, 0.2, 0.8]), np.array([0.3, 0.4, 0.4]))
    sun = Sun(np.array([np.sqrt(1.0 - sun_up**2), sun_up, 0.0]), np.full(3, 1e-3, np.float32), 0.004, 1.0)
    plate = assemble(light.astype(np.float32), sun if sun_up else None)
    found = lit_as_its_ground(plate, UP)
    received = environment_lookup(found.irradiance, UP) / np.pi
    np.testing.assert_allclose(received, [0.3 / 0.6, 0.4 / 0.6, 0.8], rtol=2.0 * MAP_LOSS)
    np.testing.assert_allclose(found.residual[20:], plate.residual[20:], rtol=1e-6)  # the sand stays
    if found.sun is not None:
        red = (0.3 / 0.6 * np.pi - sun_up * 1e-3, environment_lookup(found.ambient, UP)[0])
        np.testing.assert_allclose(found.sun.irradiance[0] - 1e-3, red[0], rtol=2.0 * MAP_LOSS)
        np.testing.assert_allclose(red[1], (1.0 - sun_up) * red[0], rtol=2.0 * MAP_LOSS, atol=0.01)
    consistent = assemble(np.where(up > 0.0, 0.8, 0.4 * np.ones(3)).astype(np.float32), None)
    assert lit_as_its_ground(consistent, UP) is consistent
