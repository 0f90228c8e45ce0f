# SPDX-License-Identifier: Apache-2.0
"""A camera that rises and sinks sees the water of its own depth."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup, veil_lookup
from mr360uw.medium.medium import MediumAtDepths
from mr360uw.medium.scattered_light import irradiance_from_level
from tests.medium.tolerances import FLOAT32, TABLE_BETWEEN_DEPTHS

START_M = 5.0


@pytest.fixture(scope="module")
def medium() -> Medium:
    return Medium(Water.jerlov("II"), camera_depth_m=START_M, band_count=31)


@pytest.mark.parametrize("depth_m", [0.7, 4.87, 12.3])
def test_tables_between_depths_are_those_of_the_depth(medium: Medium, depth_m: float) -> None:
    mixed = MediumAtDepths(medium).at(depth_m).table
    exact = medium.at_depth(depth_m).table
    assert mixed.camera_depth_m == depth_m
    distance, up = np.meshgrid([0.3, 2.0, 8.0, 40.0], [-0.9, -0.2, 0.0, 0.1, 0.5, 0.95])
    close = {"rtol": TABLE_BETWEEN_DEPTHS, "atol": TABLE_BETWEEN_DEPTHS * float(exact.veil.max())}
    np.testing.assert_allclose(veil_lookup(mixed, distance, up), veil_lookup(exact, distance, up), **close)
    seen = transmittance_lookup(mixed, distance, up), transmittance_lookup(exact, distance, up)
    np.testing.assert_allclose(*seen, rtol=TABLE_BETWEEN_DEPTHS)
    below = depth_m + np.array([0.5, 3.0, 10.0])
    np.testing.assert_allclose(ambient_ratio(mixed, below), ambient_ratio(exact, below), rtol=TABLE_BETWEEN_DEPTHS)
    np.testing.assert_allclose(beam_ratio(mixed, below, 0.8), beam_ratio(exact, below, 0.8), rtol=TABLE_BETWEEN_DEPTHS)


@pytest.mark.parametrize("floor_m", [None, 9.0])
def test_the_plates_light_between_depths_is_that_of_the_depth(floor_m: float | None) -> None:
    """Interpolated between depths 6 % apart, the light at the camera is within .1 % of what is solved at its own."""
    medium, below = Medium(Water.jerlov("IB"), camera_depth_m=4.0, floor_m=floor_m), np.array([0.004, 0.02, 0.03])
    waters = MediumAtDepths(medium)
    for depth_m in np.linspace(3.3, 5.1, 7):
        found, own = (
            irradiance_from_level(one, 0.8, 0.7, below) for one in (waters.at(depth_m), medium.at_depth(depth_m))
        )
        np.testing.assert_allclose(found, own, rtol=1e-3)


def test_a_node_is_exact_and_nothing_jumps_there(medium: Medium) -> None:
    waters = MediumAtDepths(medium)
    node = waters.at(1.0).table
    np.testing.assert_array_equal(node.veil, medium.at_depth(1.0).table.veil)
    beside = [waters.at(1.0 + side).table.veil for side in (-1e-9, 1e-9)]
    np.testing.assert_allclose(*beside, rtol=FLOAT32)


def test_another_depth_is_another_camera_in_the_same_water(medium: Medium) -> None:
    deeper = medium.at_depth(9.0)
    fresh = Medium(Water.jerlov("II"), camera_depth_m=9.0, band_count=31)
    np.testing.assert_allclose(deeper.veil(5.0, 9.0, -0.3), fresh.veil(5.0, 9.0, -0.3), rtol=FLOAT32)
    distance = np.array([1.0, 6.0, 30.0])
    np.testing.assert_allclose(
        veil_lookup(deeper.table, distance, 0.1), veil_lookup(fresh.table, distance, 0.1), rtol=TABLE_BETWEEN_DEPTHS
    )
    assert np.all(deeper.radiance(9.0, 0.0) < medium.radiance(START_M, 0.0))


def test_gain_and_map_go_with_it(medium: Medium) -> None:
    scaled = medium.scaled([0.5, 0.6, 0.7])
    np.testing.assert_allclose(
        MediumAtDepths(scaled).at(7.0).table.veil, MediumAtDepths(medium).at(7.0).table.veil * [0.5, 0.6, 0.7],
        rtol=FLOAT32,
    )  # fmt: skip
