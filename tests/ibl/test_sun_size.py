# SPDX-License-Identifier: Apache-2.0
"""How large the sun is that casts the shadows, and what is taken out of the sky for it."""

from __future__ import annotations

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle, unit
from mr360uw.ibl.settings import LightSettings
from mr360uw.types import Sun
from tests.ibl.plates import clipped, planes, sky
from tests.ibl.tolerances import ENERGY_FLOAT32, SUN_LEFT, SUN_POLE_ENERGY, SUN_RADIUS, TILT_LIGHT

TOWARDS = unit([0.3, 0.8, 0.2])


def glaring() -> np.ndarray:
    """Return a plate whose sun is clipped over a radius of 4 degrees."""
    towards = directions(1024, 512) @ TOWARDS
    glare = 6.0 / (1.0 + (np.arccos(np.clip(towards, -1.0, 1.0)) / np.radians(2.0)) ** 2)
    return clipped(sky(TOWARDS, width=1024) + glare[..., None].astype(np.float32))


@pytest.mark.parametrize("underwater", [False, True])
def test_a_clipped_sun_has_the_size_of_the_sun(underwater: bool) -> None:
    wanted = SUN_HALF_ANGLE_RAD / (REFRACTIVE_INDEX_SEA if underwater else 1.0)
    for plate in (clipped(sky(TOWARDS, width=1024)), glaring()):
        found = ibl.detect_sun(plate, underwater=underwater)
        given = ibl.environment(plate, sun=TOWARDS, underwater=underwater).sun
        for sun in (found, ibl.environment(plate, underwater=underwater).sun, given):
            assert sun is not None
            assert sun.half_angle_rad == wanted


@pytest.mark.parametrize("half_angle_rad", [0.006, 0.008, 0.011])
def test_a_disc_that_is_resolved_keeps_its_size(half_angle_rad: float) -> None:
    sun = ibl.detect_sun(sky(TOWARDS, width=2048, half_angle_rad=half_angle_rad))
    assert sun is not None
    assert sun.half_angle_rad == pytest.approx(half_angle_rad, abs=SUN_RADIUS * 2.0 * np.pi / 2048)


@pytest.mark.parametrize("source", ["linear", "planes"])
def test_the_glare_leaves_the_sky_however_the_sun_is_known(source: str) -> None:
    """What is taken out is the bright spot, not the disc: else the beam would come on top of the glare."""
    plate = planes(glaring()) if source == "planes" else glaring()
    light = ibl.environment_from_yuv if source == "planes" else ibl.environment
    alone = light(plate, sun=None).residual
    found = light(plate)
    assert found.sun is not None
    removed = alone - found.residual
    assert removed.max() > 0.2 * alone.max()
    smoothed = Sun(TOWARDS, np.ones(3, np.float32), SUN_HALF_ANGLE_RAD, 1.0)
    for known in (smoothed, TOWARDS):
        again = alone - light(plate, sun=known).residual
        assert np.abs(again - removed).sum() < 3.0 * TILT_LIGHT * removed.sum()


def test_the_size_moves_no_light() -> None:
    """The beam is the light that was taken out of the sky, whatever disc it comes from."""
    settings, omega = LightSettings(operator="none"), row_solid_angle(64, 32)[:, None, None]
    for plate in (glaring(), sky(TOWARDS, width=1024)):
        whole = (ibl.environment(plate, settings, sun=None).radiance * omega).sum(axis=(0, 1))
        for sun in ("detect", TOWARDS):
            light = ibl.environment(plate, settings, sun=sun)
            assert light.sun is not None
            parts = (light.residual * omega).sum(axis=(0, 1)) + light.sun.irradiance
            np.testing.assert_allclose(parts, whole, rtol=ENERGY_FLOAT32)


def test_a_hidden_sun_takes_no_light_from_elsewhere() -> None:
    plate, hidden = glaring(), unit([-0.6, 0.5, -0.3])
    alone = ibl.environment(plate, sun=None).residual
    for sun in (Sun(hidden, np.ones(3, np.float32), SUN_HALF_ANGLE_RAD, 1.0), hidden):
        removed = alone - ibl.environment(plate, sun=sun).residual
        assert np.all(removed[directions(64, 32) @ hidden < np.cos(np.radians(8.0))] == 0.0)
        assert removed.sum() < TILT_LIGHT * alone.sum()


@pytest.mark.parametrize("from_pole_deg", [0.0, 0.4, 1.5, 3.0])
def test_slivers_about_the_pole_give_all_their_light(from_pole_deg: float) -> None:
    """Pixels of the map are narrower there than the samples that look at them; none keeps its part of the sun."""
    place = direction_from_angles(0.3, np.radians(90.0 - from_pole_deg))
    image, without = sky(place, width=1024), sky(place, width=1024, sun=0.0)
    put = ((image - without) * row_solid_angle(1024, 512)[:, None, None]).sum(axis=(0, 1))
    light = ibl.environment(image, LightSettings(operator="none"))
    assert light.sun is not None
    np.testing.assert_allclose(light.sun.irradiance, put, rtol=SUN_POLE_ENERGY)
    assert light.residual.max() < SUN_LEFT * image.max()
