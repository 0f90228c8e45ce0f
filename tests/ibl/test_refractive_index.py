# SPDX-License-Identifier: Apache-2.0
"""Snell's window is as wide as the water's refractive index makes it, wherever it is used."""

from __future__ import annotations

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.optics import snell_elevation
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.ibl.plate import region_weight
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.tilt import estimate_horizon
from tests.ibl.plates import clipped, planes, sky
from tests.ibl.tolerances import FLOAT64, WINDOW_EDGE, YUV_MEAN

INDICES = [1.2, REFRACTIVE_INDEX_SEA, 1.5]
WINDOW = LightSettings(operator="mr360", region="snell")
RAMP_DEG = 10.0  # half the width of the region's edge


@pytest.mark.parametrize("index", INDICES)
def test_the_edge_is_the_critical_angle(index: float) -> None:
    assert np.cos(snell_elevation(index)) == pytest.approx(1.0 / index, abs=FLOAT64)


@pytest.mark.parametrize("index", INDICES)
def test_the_plate_is_expanded_inside_its_window(index: float) -> None:
    plate = np.full((360, 4, 3), 0.9, np.float32)
    expanded = ibl.expand(plate, WINDOW, refractive_index=index)[:, 0, 0] > plate[0, 0, 0]
    elevation_deg = 90.0 - 0.5 * (np.arange(360) + 0.5)
    np.testing.assert_array_equal(expanded, elevation_deg > np.degrees(snell_elevation(index)) - RAMP_DEG)


@pytest.mark.parametrize("tilted", [False, True])
def test_floats_and_planes_take_the_same_window(tilted: bool) -> None:
    image = np.full((256, 512, 3), 0.8, np.float32)
    up = np.array([0.2, 0.9, -0.1]) if tilted else None
    dim = ibl.environment(image, LightSettings(operator="none"), sun=None).radiance
    omega = row_solid_angle(64, 32)[:, None, None]
    extra = []
    for index in INDICES:
        a = ibl.environment(image, WINDOW, sun=None, up=up, refractive_index=index)
        b = ibl.environment_from_yuv(planes(image), WINDOW, sun=None, up=up, refractive_index=index)
        assert np.abs(a.irradiance - b.irradiance).mean() < 3 * YUV_MEAN * a.irradiance.mean()
        extra.append(float(((a.radiance - dim) * omega).sum()))
    sine = np.linspace(-1.0, 1.0, 20_001)  # solid angle of the window over 2 pi, with its edge
    width = [np.trapezoid(region_weight(sine, WINDOW, index), sine) for index in INDICES]
    np.testing.assert_allclose(np.array(extra) / extra[1], np.array(width) / width[1], rtol=WINDOW_EDGE)


def test_a_sun_is_looked_for_inside_the_window() -> None:
    low = sky(direction_from_angles(1.0, np.radians(37.0)), width=1024)  # the edge: 41.7 degrees, of 1.2 33.6 degrees
    assert ibl.detect_sun(low, underwater=True) is None
    assert ibl.detect_sun(low, underwater=True, refractive_index=1.2) is not None
    settings = LightSettings(operator="none")
    assert ibl.environment(low, settings, underwater=True).sun is None
    assert ibl.environment(low, settings, underwater=True, refractive_index=1.2).sun is not None


@pytest.mark.parametrize("index", INDICES)
def test_the_disc_is_narrowed_by_the_index(index: float) -> None:
    plate = clipped(sky(direction_from_angles(1.0, 1.2), width=1024))
    for sun in ("detect", direction_from_angles(1.0, 1.2)):
        for light in (ibl.environment, ibl.environment_from_yuv):
            seen = planes(plate) if light is ibl.environment_from_yuv else plate
            found = light(seen, sun=sun, underwater=True, refractive_index=index).sun
            assert found is not None
            assert found.half_angle_rad == SUN_HALF_ANGLE_RAD / index


@pytest.mark.parametrize("index", [1.2, 1.5])
def test_the_horizon_is_that_of_the_window(index: float) -> None:
    """A window of another width is explained best by its own index."""
    elevation = np.arcsin(directions(64, 32)[..., 1])
    step = np.tanh((elevation - snell_elevation(index)) / np.radians(8.0))
    radiance = 0.1 * np.exp(step)[..., None] * np.array([0.5, 0.9, 1.0])
    explained = [estimate_horizon(radiance, other).explained for other in (index, REFRACTIVE_INDEX_SEA)]
    assert explained[0] > explained[1] + 0.05
