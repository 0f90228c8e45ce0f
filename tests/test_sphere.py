# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.sphere import (
    direction_from_angles,
    direction_from_frame,
    directions,
    effective_half_angle,
    frame_from_direction,
    row_solid_angle,
    unit,
    yaw_matrix,
)
from mr360uw.errors import ParameterError
from tests.tolerances import FLOAT64


def test_the_centre_looks_along_minus_z_and_a_quarter_turn_to_the_right_is_plus_x() -> None:
    np.testing.assert_allclose(direction_from_frame(32, 16, 64, 32), [0, 0, -1], atol=FLOAT64)
    np.testing.assert_allclose(direction_from_frame(48, 16, 64, 32), [1, 0, 0], atol=FLOAT64)
    np.testing.assert_allclose(direction_from_frame(10, 0, 64, 32), [0, 1, 0], atol=FLOAT64)


def test_pixel_to_direction_and_back(rng: np.random.Generator) -> None:
    x, y = rng.uniform(0, 640, 1000), rng.uniform(0, 320, 1000)
    back = frame_from_direction(direction_from_frame(x, y, 640, 320), 640, 320)
    np.testing.assert_allclose(back, (x, y), atol=1e3 * FLOAT64)


@pytest.mark.parametrize(("width", "height"), [(64, 32), (1, 1), (33, 7), (4096, 2048)])
def test_solid_angles_fill_the_sphere(width: int, height: int) -> None:
    assert width * row_solid_angle(width, height).sum() == pytest.approx(4 * np.pi, rel=FLOAT64)


def test_directions_sum_to_zero_with_their_solid_angles() -> None:
    weighted = directions(128, 64) * row_solid_angle(128, 64)[:, None, None]
    np.testing.assert_allclose(weighted.sum((0, 1)), 0.0, atol=FLOAT64)


def test_yaw_turns_forward_to_the_right() -> None:
    np.testing.assert_allclose(yaw_matrix(np.pi / 2) @ [0, 0, -1], [1, 0, 0], atol=FLOAT64)
    np.testing.assert_allclose(yaw_matrix(0.7) @ direction_from_angles(0.1, 0.4), direction_from_angles(0.8, 0.4))


@pytest.mark.parametrize("bad", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
def test_unit_refuses_what_has_no_direction(bad: list[float]) -> None:
    with pytest.raises(ParameterError, match="direction"):
        unit(bad)


def test_a_spread_widens_a_disc_to_the_one_of_its_second_moment(rng: np.random.Generator) -> None:
    """Along one axis, points of a disc vary by a quarter of its radius squared; sampling leaves .3 %."""
    disc, spread = 0.02, 0.015
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, 400_000), disc * np.sqrt(rng.uniform(0.0, 1.0, 400_000))
    places = radius * np.cos(angle) + rng.normal(0.0, spread, len(radius))
    assert effective_half_angle(disc, spread) == pytest.approx(2.0 * places.std(), rel=0.01)
