# SPDX-License-Identifier: Apache-2.0
"""The plate's open water: what it shows is kept, what hides it is filled from around, over a clip it is steady."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.color import encode
from mr360uw.base.sphere import directions
from mr360uw.medium import Medium, Water
from mr360uw.medium.open_water import COLUMNS, FINER, ROWS, OpenWater, OpenWaterLooks, filled, open_water, row_up
from mr360uw.medium.veil_gain import fit_gain
from tests.medium.tolerances import FILLED, OPEN_WATER_CODES

DEPTH = 8.0
SIZE = FINER * ROWS, FINER * COLUMNS


@pytest.fixture(scope="module")
def medium() -> Medium:
    return Medium(Water.jerlov("II"), camera_depth_m=DEPTH)


def graded_water(medium: Medium) -> np.ndarray:
    """Water that is warmer and lighter on one side, as no solved field is: (h, w, 3)."""
    ray = directions(SIZE[1], SIZE[0])
    grade = np.exp(np.array([0.5, 0.3, 0.1]) * ray[..., :1]) * [1.6, 1.1, 0.8]
    return 5.0 * grade * medium.level_radiance(row_up(SIZE[0]))[:, None]


def far_light(medium: Medium, shown: np.ndarray) -> tuple[np.ndarray, OpenWater]:
    """Return the light (ROWS, COLUMNS, 3) of the veil of a long way, and what was found."""
    gain, _ = fit_gain(medium, shown)
    found = open_water(medium, gain, shown)
    used = np.maximum(gain, found.least_gain)
    return found.ratio(gain) * (used * medium.level_radiance(row_up(ROWS)))[:, None], found


def code_error(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return 255.0 * np.abs(encode(np.clip(one, 0.0, 1.0), "srgb") - encode(np.clip(other, 0.0, 1.0), "srgb")).max(-1)


def test_the_veil_of_long_ways_is_the_plate_s_and_no_diver_is_in_it(medium: Medium) -> None:
    water = graded_water(medium)
    truth = water.reshape(ROWS, FINER, COLUMNS, FINER, 3).mean(axis=(1, 3))
    shown = water.copy()
    rng = np.random.default_rng(4)
    shown[118:142, 200:236] = 0.002  # a suit
    shown[120:150, 300:340] = rng.uniform(0.02, 0.5, (30, 40, 3))  # a reef
    far, found = far_light(medium, shown)
    level = np.abs(row_up(ROWS)) < 0.1
    assert found.weight[level].max() > 0.99
    assert found.weight[59:71, 100:118].max() == 0.0
    assert code_error(far, truth)[level].max() < OPEN_WATER_CODES
    # another water shows the same, as it does at another depth
    for other in (Medium(Water.jerlov("5C"), camera_depth_m=DEPTH), medium.at_depth(3.0)):
        again, _ = far_light(other, shown)
        open_there = level[:, None] & (found.weight > 0.99)
        assert code_error(again, truth)[open_there].max() < OPEN_WATER_CODES


def test_where_no_open_water_is_seen_the_solved_field_stands(medium: Medium) -> None:
    rock = np.random.default_rng(5).uniform(0.0, 0.4, (*SIZE, 3)) ** 2
    found = open_water(medium, np.ones(3), rock)
    np.testing.assert_allclose(found.ratio(np.ones(3)), 1.0, rtol=1e-6)


def test_ground_that_is_near_is_no_water(medium: Medium) -> None:
    water = graded_water(medium)
    found = open_water(medium, fit_gain(medium, water)[0], water, 1.5)
    assert found.weight[row_up(ROWS) < -0.5].max() == 0.0
    assert found.weight[np.abs(row_up(ROWS)) < 0.05].min() > 0.99


def test_water_goes_on_where_the_ground_falls_away() -> None:
    """On one side the plate is as its ground makes it, on the other there is none: both veils are the plate's."""
    above = 1.3
    medium = Medium(Water.jerlov("IA"), camera_depth_m=DEPTH, floor_m=DEPTH + above)
    up, gain = row_up(SIZE[0]), np.full(3, 5.0)
    shown = np.repeat(gain * medium.level_radiance(up)[:, None], SIZE[1], axis=1)
    long = gain * medium.far_veil(row_up(ROWS)[ROWS // 2 :], gain, np.zeros(3))
    below = np.repeat(long, FINER, axis=0)
    shown[SIZE[0] // 2 :, 100:300] = below[:, None]
    found = open_water(medium, gain, shown, above)
    falls, stands = found.weight[ROWS // 2 :, 60:140], found.weight[ROWS // 2 :, 160:]
    ray = row_up(ROWS)[ROWS // 2 :]
    some_way = (ray < -0.07) & (ray > -0.3)
    assert falls[some_way].min() > 0.9
    assert stands[some_way].max() < 0.1
    veil = (found.ratio(gain)[ROWS // 2 :] * long[:, None])[some_way, 60:140]
    truth = np.broadcast_to(long[some_way, None], veil.shape)
    assert code_error(veil, truth).max() < OPEN_WATER_CODES


def test_a_bright_floor_lights_the_water_alike_about_the_sun() -> None:
    """Towards the sun the sky's part of the light is 2.7 times as bright as the mean, the floor's part is not."""
    above, gain = 2.0, np.full(3, 3.0)
    medium = Medium(Water.jerlov("1C"), camera_depth_m=5.0, floor_m=5.0 + above)
    azimuth = 2.0 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS
    uneven = np.exp(1.5 * np.cos(azimuth))
    around = np.broadcast_to((uneven / uneven.mean())[None, :, None], (ROWS, COLUMNS, 3))
    from_below = 0.12 * gain * medium.irradiance(5.0)
    light, of_floor = medium.far_light(row_up(ROWS), gain, medium.floor_seen(gain, from_below))
    truth = of_floor[:, None] + (1.0 - of_floor[:, None]) * around
    found = open_water(medium, gain, gain * light[:, None] * truth, above, around)
    # below: parts that the plate does not show, for the ground is near; the floor's own light is integrated from rows
    np.testing.assert_allclose(found.ratio(gain)[-40:], truth[-40:], rtol=0.03)


@pytest.mark.parametrize("rock_deg", [6.0, 9.0, 12.0, 18.0])
def test_rock_on_the_horizon_leaves_a_finite_ratio(rock_deg: float) -> None:
    """What tells the water of the horizon falls to 1e-20 and less with the rock's height, and is a weight still."""
    above = 1.3
    medium = Medium(Water.jerlov("IB"), camera_depth_m=DEPTH, floor_m=DEPTH + above)
    up, gain = row_up(SIZE[0]), np.full(3, 5.0)
    shown = np.repeat(gain * medium.level_radiance(up)[:, None], SIZE[1], axis=1)
    long = gain * medium.far_veil(row_up(ROWS)[ROWS // 2 :], gain, np.zeros(3))
    shown[SIZE[0] // 2 :] = np.repeat(long, FINER, axis=0)[:, None]
    rock = np.abs(up) < np.sin(np.radians(rock_deg))
    stones = (
        np.random.default_rng(6).uniform(0.0, 1.0, (SIZE[0] // 4, SIZE[1] // 4, 1)).repeat(4, axis=0).repeat(4, axis=1)
    )
    shown[rock] *= stones[rock]
    assert np.all(np.isfinite(open_water(medium, gain, shown, above).ratio(gain)))


def test_unknown_parts_are_harmonic_over_the_sphere() -> None:
    theta = np.pi * (np.arange(ROWS) + 0.5) / ROWS
    truth = np.broadcast_to(np.log(np.tan(0.5 * theta))[:, None, None], (ROWS, COLUMNS, 1))
    weight = np.zeros((ROWS, COLUMNS))
    weight[20:24], weight[-24:-20] = 1.0, 1.0
    found = filled(np.where(weight[..., None] > 0.0, truth, 7.0), weight)
    np.testing.assert_allclose(found[24:-24], truth[24:-24], atol=FILLED)
    np.testing.assert_allclose(found[:20], found[20:24].mean(), atol=0.1)  # a cap has the mean of its rim


def look(value: float, seen: float = 1.0) -> OpenWater:
    return OpenWater(np.full((ROWS, COLUMNS, 3), value), np.full((ROWS, COLUMNS), seen), np.full(3, 1e-9))


def test_a_shot_has_its_own_open_water_at_the_gain_of_every_frame() -> None:
    looks = OpenWaterLooks(10.0)
    gain = np.exp(np.linspace(0.0, 1.0, 100))[:, None] * np.ones(3)
    for index in range(100):
        if looks.due(index):
            looks.add(index, look(np.log(gain[index, 0]) + (0.2 if index < 50 else -0.3)))
    track = looks.track(gain, 0, np.array([50]))
    assert track is not None
    for index, level in ((0, 0.2), (17, 0.2), (49, 0.2), (50, -0.3), (99, -0.3)):
        found = track.ratio_at(index)
        assert found is not None
        np.testing.assert_allclose(found, np.exp(level), rtol=2e-3)  # half precision
    alone = OpenWaterLooks(10.0)
    assert alone.track(gain, 0, np.array([50])) is None
