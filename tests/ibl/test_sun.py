# SPDX-License-Identifier: Apache-2.0
"""The sun: found anywhere on the sphere, clipped or not, and nothing else taken for it."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mr360uw.ibl as ibl
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle, unit
from mr360uw.errors import ParameterError
from mr360uw.ibl.settings import LightSettings, Operator
from mr360uw.types import Sun
from tests.ibl import panoramas
from tests.ibl.panoramas import panorama
from tests.ibl.plates import angle_deg, clipped, sky
from tests.ibl.tolerances import (
    CLOSURE_RATIO,
    ENERGY_FLOAT32,
    SUN_CLIPPED_DEG,
    SUN_ENERGY,
    SUN_HDR_DEG,
    SUN_LOW_DEG,
)

SEAM, ZENITH = np.array([0.0, 0.6, 0.8]), np.array([0.0, 1.0, 0.0])


@settings(max_examples=8, deadline=None, derandomize=True)
@given(azimuth=st.floats(-np.pi, np.pi), elevation=st.floats(0.1, np.pi / 2))
def test_found_wherever_it_stands(azimuth: float, elevation: float) -> None:
    place = direction_from_angles(azimuth, elevation)
    image = sky(place, width=1024)
    sun = ibl.detect_sun(image)
    assert sun is not None
    assert angle_deg(sun.direction, place) < SUN_HDR_DEG
    assert sun.confidence > 0.5
    dim = ibl.detect_sun(clipped(image))
    assert dim is not None
    assert angle_deg(dim.direction, place) < SUN_CLIPPED_DEG
    assert dim.confidence > 0.5


@pytest.mark.parametrize("place", [SEAM, ZENITH, unit([0.5, 0.3, 0.1])])
def test_irradiance_of_the_sun_is_what_was_put_there(place: np.ndarray) -> None:
    image = sky(place)
    outside = sky(place, sun=0.0)
    put = ((image - outside) * row_solid_angle(512, 256)[:, None, None]).sum(axis=(0, 1))
    sun = ibl.detect_sun(image)
    assert sun is not None
    np.testing.assert_allclose(sun.irradiance, put, rtol=SUN_ENERGY)


@pytest.mark.parametrize("place", [SEAM, ZENITH])
@pytest.mark.parametrize("operator", get_args(Operator))
def test_beam_and_residual_add_up_to_the_map(place: np.ndarray, operator: str) -> None:
    light = ibl.environment(clipped(sky(place)), LightSettings(operator=operator))
    assert light.sun is not None
    omega = row_solid_angle(64, 32)[:, None, None]
    total = (light.radiance * omega).sum(axis=(0, 1))
    parts = (light.residual * omega).sum(axis=(0, 1)) + light.sun.irradiance
    np.testing.assert_allclose(parts, total, rtol=ENERGY_FLOAT32)
    assert np.all(light.residual >= 0.0)


def test_no_sun_below_the_horizon_nor_outside_the_window() -> None:
    assert ibl.environment(sky(np.array([0.3, -0.6, 0.2])), expansion="none").sun is None
    low = sky(direction_from_angles(1.0, np.radians(30.0)))
    assert ibl.environment(low, expansion="none").sun is not None
    assert ibl.environment(low, expansion="none", underwater=True).sun is None
    high = direction_from_angles(1.0, np.radians(60.0))
    sun = ibl.detect_sun(sky(high), underwater=True)
    assert sun is not None
    assert angle_deg(sun.direction, high) < SUN_HDR_DEG


def test_bright_sand_does_not_hide_the_sun(rng: np.random.Generator) -> None:
    place = direction_from_angles(-2.0, 0.9)
    image = sky(place, sun=300.0)
    floor = directions(512, 256)[..., 1] < -0.3
    image[floor & (rng.uniform(size=floor.shape) < 0.2)] = 500.0  # caustics brighter than the sun
    for plate in (image, clipped(image)):
        sun = ibl.detect_sun(plate)
        assert sun is not None
        assert angle_deg(sun.direction, place) < SUN_CLIPPED_DEG


def test_an_overcast_sky_has_no_sun(rng: np.random.Generator) -> None:
    up = directions(512, 256)[..., 1]
    overcast = np.where(up > 0.1, 1.6, 0.1)[..., None] * rng.uniform(0.9, 1.1, (256, 512, 1)) * np.ones(3)
    for plate in (clipped(overcast), overcast.astype(np.float32)):
        sun = ibl.detect_sun(plate)
        assert sun is None or sun.confidence < 0.5
    assert ibl.environment(clipped(overcast)).sun is None


def test_a_given_sun_replaces_the_one_in_the_plate() -> None:
    image = sky(SEAM)
    given_sun = Sun(unit([0.2, 0.9, 0.1]), np.array([3.0, 2.0, 1.0]), 0.01, 1.0)
    light = ibl.environment(image, expansion="none", sun=given_sun)
    assert light.sun is given_sun
    omega = row_solid_angle(64, 32)[:, None, None]
    gained = ((light.radiance - light.residual) * omega).sum(axis=(0, 1))
    np.testing.assert_allclose(gained, given_sun.irradiance, rtol=ENERGY_FLOAT32)
    measured = ibl.environment(image, expansion="none", sun=SEAM).sun
    assert measured is not None
    assert measured.irradiance.max() > 0.0
    assert ibl.environment(image, expansion="none", sun=None).sun is None


def test_settings_give_the_direction() -> None:
    chosen = LightSettings(operator="none", sun="given", sun_azimuth_deg=30.0, sun_elevation_deg=50.0)
    light = ibl.environment(sky(SEAM), chosen)
    assert light.sun is not None
    np.testing.assert_allclose(light.sun.direction, direction_from_angles(np.radians(30.0), np.radians(50.0)))
    assert ibl.environment(sky(SEAM), LightSettings(operator="none", sun="none")).sun is None
    dated = LightSettings(sun="date", sun_time="2026-06-21T12:00:00Z", place_deg=(30.0, 0.0))
    with pytest.raises(ParameterError, match="refract"):
        ibl.environment(sky(SEAM), dated, underwater=True)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 4.0])
def test_the_closure_meets_the_ratio(ratio: float) -> None:
    light = ibl.environment(clipped(sky(unit([0.4, 0.6, 0.2]))), LightSettings(direct_to_diffuse=ratio))
    assert light.sun is not None
    up = np.maximum(directions(64, 32)[..., 1], 0.0) * row_solid_angle(64, 32)[:, None]
    diffuse = (light.residual * up[..., None]).sum(axis=(0, 1)) @ [0.2126, 0.7152, 0.0722]
    direct = light.sun.irradiance @ [0.2126, 0.7152, 0.0722] * light.sun.direction[1]
    assert direct / diffuse == pytest.approx(ratio, rel=CLOSURE_RATIO)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((64, 128, 3)), np.ones((64, 128, 3)), np.full((64, 128, 3), -1.0), np.full((1, 1, 3), 0.3),
        np.full((8, 16, 3), 0.2),
    ],
)  # fmt: skip
def test_odd_plates_give_finite_light(image: np.ndarray) -> None:
    light = ibl.environment(image, glossy=True)
    assert light.sun is None
    for field in (light.radiance, light.irradiance, light.residual, light.ambient, light.glossy):
        assert np.all(np.isfinite(field))


@pytest.mark.parametrize(
    "image", [np.full((8, 16, 3), np.nan), np.zeros((8, 16)), np.zeros((0, 0, 3)), np.zeros((8, 16, 3), np.uint8)]
)
def test_what_is_no_plate_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ParameterError, match="plate"):
        ibl.environment(image)


def test_two_suns_and_a_hot_pixel_stay_finite() -> None:
    two = np.maximum(sky(SEAM), sky(unit([1.0, 0.5, -0.4])))
    hot = np.full((256, 512, 3), 0.2, np.float32)
    hot[40, 7] = 1e4
    for image in (two, hot):
        light = ibl.environment(image, expansion="none")
        assert np.all(np.isfinite(light.irradiance))


def test_a_low_sun_in_a_clipped_noisy_picture() -> None:
    sun = ibl.detect_sun(panorama("low sun"))
    assert sun is not None
    assert sun.confidence > 0.5
    assert angle_deg(sun.direction, panoramas.SUN) < SUN_LOW_DEG


@pytest.mark.parametrize("name", panoramas.SKIES)
def test_skies_without_a_sun(name: str) -> None:
    plate = panorama(name)
    sun = ibl.detect_sun(plate)
    assert sun is None or sun.confidence < 0.5
    assert ibl.environment(plate).sun is None
