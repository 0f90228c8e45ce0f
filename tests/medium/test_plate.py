# SPDX-License-Identifier: Apache-2.0
"""What is read off a plate: the profile, the gain, the water."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import JERLOV_TYPES, Medium, PlateProfile, Sensor, Water, fit_gain, fit_water
from mr360uw.medium.lookup import veil_lookup
from mr360uw.medium.open_water import row_up
from tests.medium.tolerances import BALANCE, FEWER_BANDS, FLOAT64, GAIN, GAIN_STEP

DEPTH = 6.0
EXPOSURE = np.array([0.5, 0.4, 0.3])
NEARLY_NEUTRAL = np.array([0.42, 0.40, 0.38])


def water_map(
    name: str,
    rng: np.random.Generator,
    noise: float = 0.15,
    depth_m: float = DEPTH,
    exposure: np.ndarray = EXPOSURE,
    sensor: Sensor | None = None,
) -> np.ndarray:
    """A plate (32, 64, 3) of open water."""
    medium = Medium(Water.jerlov(name), sensor, camera_depth_m=depth_m)
    rows = medium.light.display(medium.model.radiance(depth_m, row_up(32)))
    return exposure * rows[:, None, :] * np.exp(rng.normal(0.0, noise, (32, 64, 1)))


def test_gain_is_found_again(rng: np.random.Generator) -> None:
    medium = Medium(Water.jerlov("II"), camera_depth_m=DEPTH)
    plate = water_map("II", rng)
    plate[10:22, 5:30] = [0.9, 0.1, 0.1]  # a red wall over a good third of the horizon
    gain, residual = fit_gain(medium, plate)
    np.testing.assert_allclose(gain, EXPOSURE, rtol=5 * GAIN)
    clean_gain, clean_residual = fit_gain(medium, water_map("II", rng))
    np.testing.assert_allclose(clean_gain, EXPOSURE, rtol=GAIN)
    assert clean_residual < 4 * GAIN
    assert residual < 5 * GAIN
    # another water cannot be scaled into this one's profile
    calm = water_map("II", rng, noise=0.0)
    other = Medium(Water.jerlov("9C"), camera_depth_m=DEPTH)
    assert fit_gain(other, calm)[1] > 2 * fit_gain(medium, calm)[1]
    scaled = medium.scaled(gain)
    level = veil_lookup(scaled.table, 1e6, 0.0)
    np.testing.assert_allclose(level, PlateProfile.from_map(plate)(0.0), rtol=5 * GAIN)


def test_profile_ignores_what_covers_less_than_half_of_a_row(rng: np.random.Generator) -> None:
    plate = water_map("IB", rng, noise=0.0)
    dirty = plate.copy()
    dirty[:, 10:38] = rng.uniform(0, 5, (32, 28, 3))
    # medians move by ranks, not by values: with equal pixels left and right not at all
    up = np.linspace(-0.9, 0.9, 50)
    np.testing.assert_allclose(PlateProfile.from_map(plate)(up), PlateProfile.from_map(dirty)(up), rtol=FLOAT64)


def test_a_body_that_swims_by_moves_the_gain_smoothly(rng: np.random.Generator) -> None:
    # the share of the horizon that it covers passes every threshold there could be
    medium = Medium(Water.jerlov("II"), camera_depth_m=DEPTH)
    water = water_map("II", rng)
    steps = 400
    gains = []
    for k in range(steps):
        covered = np.clip(40.0 * k / steps - np.arange(64.0), 0.0, 1.0)[None, :, None]  # a tenth of a column a step
        gains.append(np.log(fit_gain(medium, (1.0 - covered) * water + covered * [0.12, 0.1, 0.06])[0]))
    step = np.abs(np.diff(gains, axis=0))
    pixel = np.abs(np.log(np.array([0.12, 0.1, 0.06]) / water.mean(axis=(0, 1))))
    assert np.all(step.max(axis=0) < GAIN_STEP * pixel)


def test_a_channel_that_is_black_has_no_veil(rng: np.random.Generator) -> None:
    medium = Medium(Water.jerlov("II"), camera_depth_m=DEPTH)
    plate = water_map("II", rng)
    plate[..., 0] = 0.0
    gain, residual = fit_gain(medium, plate)
    assert gain[0] == 0.0
    np.testing.assert_allclose(gain[1:], EXPOSURE[1:], rtol=GAIN)
    assert residual < 4 * GAIN
    night, residual = fit_gain(medium, np.zeros((32, 64, 3)))
    np.testing.assert_array_equal(night, 0.0)
    assert residual == 0.0


@pytest.mark.parametrize("name", JERLOV_TYPES)
def test_the_water_is_found_again(name: str, rng: np.random.Generator) -> None:
    fit = fit_water(water_map(name, rng, depth_m=3.0, exposure=NEARLY_NEUTRAL), 3.0)
    assert fit.water_type == name
    assert 0.0 <= fit.confidence <= 1.0
    np.testing.assert_allclose(fit.gain, NEARLY_NEUTRAL, rtol=10 * GAIN)
    assert fit.gain[0] / fit.gain[2] == pytest.approx(NEARLY_NEUTRAL[0] / NEARLY_NEUTRAL[2], rel=BALANCE)
    light = Medium(Water.jerlov(name), camera_depth_m=3.0).irradiance([2.9, 3.1])
    np.testing.assert_allclose(fit.kd, np.log(light[0] / light[1]) / 0.2, rtol=FEWER_BANDS)
    assert fit.residual[name] < 4 * GAIN
    other = JERLOV_TYPES[-1] if name in JERLOV_TYPES[:5] else JERLOV_TYPES[0]
    assert fit.residual[other] > 2 * fit.residual[name]
    assert sum(fit.likelihood.values()) == pytest.approx(1.0)
    page = fit.html()
    assert page.startswith("<section")
    assert f"<b>{name}</b>" in page
    assert page.count("<circle") == 3 * len(fit.up)


def test_the_water_is_sought_with_the_sensor_that_filmed_it(rng: np.random.Generator) -> None:
    observer = Sensor.cie1931()
    plate = water_map("IB", rng, depth_m=8.0, exposure=NEARLY_NEUTRAL, sensor=observer)
    told = fit_water(plate, 8.0, observer)
    assert told.water_type == "IB"
    assert told.residual["IB"] < 4 * GAIN
    # the observer sees almost no red there, a camera does
    assert fit_water(plate, 8.0).residual["IB"] > 3 * told.residual["IB"]


def test_the_gain_belongs_to_depth_and_water_alone(rng: np.random.Generator) -> None:
    plate = water_map("II", rng)
    medium = Medium(Water.jerlov("II"), camera_depth_m=DEPTH)
    gain, residual = fit_gain(medium, plate)
    for same in (medium, medium.scaled([0.1, 2.0, 3.0]), medium.at_depth(2.0).at_depth(DEPTH)):
        again, left = fit_gain(same, plate)
        np.testing.assert_allclose(again, gain, rtol=FLOAT64)
        np.testing.assert_allclose(left, residual, rtol=FLOAT64)
    shallow = Medium(Water.jerlov("II"), camera_depth_m=2.0)
    np.testing.assert_allclose(fit_gain(medium.at_depth(2.0), plate)[0], fit_gain(shallow, plate)[0], rtol=FLOAT64)
    finer = np.repeat(plate, 2, axis=0)  # more rows about the horizon
    np.testing.assert_allclose(fit_gain(medium, finer)[0], gain, rtol=5 * GAIN)


def test_a_plate_of_no_water_has_no_confidence(rng: np.random.Generator) -> None:
    plate = rng.uniform(0.0, 1.0, (32, 1, 3)) ** 3 * np.ones((1, 64, 1))
    assert fit_water(plate, DEPTH).confidence < 0.25


def test_unusable_maps_are_refused() -> None:
    with pytest.raises(ParameterError, match="black about the horizon"):
        fit_water(np.zeros((32, 64, 3)), 5.0)
    for bad in (np.ones((32, 64)), np.full((32, 64, 3), np.nan), np.full((32, 64, 3), -1.0)):
        with pytest.raises(ParameterError, match="radiance_map"):
            PlateProfile.from_map(bad)
