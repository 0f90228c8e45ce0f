# SPDX-License-Identifier: Apache-2.0
"""The glare about a sun under water is taken out of the sky; see `ibl.sun.split`."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.sphere import unit
from mr360uw.ibl.plate import LinearPlate, coarse_directions, coarse_solid_angle
from mr360uw.ibl.sun.split import sky_irradiance, without_glare
from mr360uw.types import Floats, Sun
from tests.ibl.tolerances import FLOAT32_TWIN

SKY_LEFT = 0.02
"""Error of the sky's irradiance: of a glare half as bright as the sky, 3 % is under the soft edge or beyond it."""
GLARE = np.array([3.0, 2.5, 2.0])


def split_of(sun: Floats, up: Floats) -> tuple[Floats, Floats, Sun, LinearPlate]:
    """Return a sky that is brightest overhead, without and with a glare about the sun; the sun; and its plate."""
    d = coarse_directions()
    sky = np.where((d @ up)[..., None] > 0.66, 0.1 + 0.2 * (d @ up)[..., None], 0.01) * np.array([0.2, 0.8, 1.0])
    angle = np.arccos(np.clip(d @ sun, -1.0, 1.0))
    glare = np.where((d @ up) > 0.0, np.exp(-angle / np.radians(3.0)), 0.0)[..., None] * GLARE
    alone = Sun(sun, np.zeros(3, np.float32), 0.004, 1.0)
    images = sky.astype(np.float32), (sky + glare).astype(np.float32)
    return *images, alone, LinearPlate(images[1], up=up)


@pytest.mark.parametrize("height_deg", [45.0, 60.0, 82.0])
@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.3, 0.9, -0.2)])
def test_the_sky_is_that_without_the_sun(height_deg: float, up: tuple[float, float, float]) -> None:
    axis = unit(np.array(up))
    side = unit(np.cross(axis, [0.0, 0.0, 1.0]))
    sun = np.cos(np.radians(height_deg)) * side + np.sin(np.radians(height_deg)) * axis
    clean, glaring, alone, plate = split_of(sun, axis)
    wanted = sky_irradiance(clean, axis)
    assert np.all(sky_irradiance(glaring, axis) > (1.0 + 2.0 * SKY_LEFT) * wanted)
    cleared, lit = without_glare(glaring, alone, plate)
    np.testing.assert_allclose(sky_irradiance(cleared, axis), wanted, rtol=SKY_LEFT)
    # nothing is lost: the sun has what the sky has not
    taken = np.sum((glaring - cleared) * coarse_solid_angle()[..., None], axis=(0, 1))
    np.testing.assert_allclose(lit.irradiance, taken, rtol=10 * FLOAT32_TWIN)


def test_a_body_before_the_sky_stays() -> None:
    sun = unit(np.array([0.5, 0.9, 0.0]))
    _, glaring, alone, plate = split_of(sun, np.array([0.0, 1.0, 0.0]))
    body = coarse_directions() @ unit(np.array([0.35, 0.9, 0.2])) > np.cos(np.radians(3.0))
    glaring[body] *= 0.02
    cleared, _ = without_glare(glaring, alone, plate)
    np.testing.assert_array_equal(cleared[body], glaring[body])


def test_half_the_amount_takes_half() -> None:
    sun = unit(np.array([0.5, 0.9, 0.0]))
    _, glaring, alone, plate = split_of(sun, np.array([0.0, 1.0, 0.0]))
    whole, half = (without_glare(glaring, alone, plate, amount)[0] for amount in (1.0, 0.5))
    np.testing.assert_allclose(half, 0.5 * (whole + glaring), rtol=10 * FLOAT32_TWIN)
