# SPDX-License-Identifier: Apache-2.0
"""Up, floor, scale and heading of a solved scene."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mr360uw.track.camera_track import Measure, fit_floor, world_of

TILTED = Rotation.from_euler("zyx", [35.0, 50.0, -20.0], degrees=True).as_matrix()
"""Rotation from the solved scene's axes to the world's."""


def scene(rng: np.random.Generator, roll_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, rotations and points, in arbitrary axes and half the scale, of a camera 3 m over a floor."""
    floor = np.column_stack([rng.uniform(-6, 6, 400), -3.0 + rng.normal(0, 0.02, 400), rng.uniform(-6, 6, 400)])
    fish = rng.uniform([-3, -2.0, -3], [3, 2, 3], (80, 3))
    position = np.column_stack([np.zeros(9), np.zeros(9), -0.2 * np.arange(9)])
    rolls = Rotation.from_euler("z", roll_deg * np.linspace(-1, 1, 9)[:, None], degrees=True).as_matrix()
    place = 0.5 * np.concatenate([position, floor, fish]) @ TILTED + [7.0, 8.0, 9.0]
    return place[:9], TILTED.T @ rolls, place[9:]


@pytest.mark.parametrize("roll_deg", [0.0, 6.0])
def test_a_scene_is_put_upright_at_its_scale(rng: np.random.Generator, roll_deg: float) -> None:
    position, rotation, points = scene(rng, roll_deg)
    world = world_of(position, rotation, points, None, measure=Measure(height_m=3.0))
    placed = world.place(position)
    # ripples of 2 cm over 400 points 12 m wide tilt the fitted plane by 0.01 degree and lift it by 1 mm; ten times that
    np.testing.assert_allclose(np.linalg.norm(placed[-1]), 1.6, atol=0.01)
    np.testing.assert_allclose(world.rotation @ TILTED.T @ [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], atol=0.002)
    np.testing.assert_array_equal(placed[0], np.zeros(3))
    forward = -(world.rotation @ rotation[0])[:, 2]
    assert abs(forward[0]) < 1e-9
    assert forward[2] < 0.0
    assert world.floor is not None
    assert world.floor.height_m == pytest.approx(-3.0)
    assert world.floor.support > 0.8
    assert ("floor's normal" in world.up) == (roll_deg > 0.0)
    assert "as given" in world.scale_from


def test_gravity_goes_before_the_floor(rng: np.random.Generator) -> None:
    position, rotation, points = scene(rng)
    up = np.tile([np.sin(0.05), np.cos(0.05), 0.0], (9, 1))
    world = world_of(position, rotation, points, up, measure=Measure(height_m=3.0))
    np.testing.assert_allclose(world.rotation @ rotation[0] @ up[0], [0.0, 1.0, 0.0], atol=1e-12)
    assert world.floor is not None
    assert world.floor.tilt_deg == pytest.approx(np.degrees(0.05), abs=0.1)  # as above


def test_a_slope_of_rocks_with_more_points_than_the_floor_below_it_is_no_floor(rng: np.random.Generator) -> None:
    floor = np.column_stack([rng.uniform(-4.0, 4.0, 120), rng.normal(-2.0, 0.02, 120), rng.uniform(-4.0, 4.0, 120)])
    rocks = np.column_stack([rng.uniform(1.0, 4.0, 400), rng.normal(0.0, 0.05, 400), rng.uniform(-4.0, 4.0, 400)])
    rocks[:, 1] += 0.3 * rocks[:, 0] - 2.0
    found = fit_floor(np.concatenate([floor, rocks]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    assert found is not None
    # ripples of 2 cm over 120 points 8 m wide: 2 mm and .05 degree; the slope is tilted by 17
    assert -found[1] == pytest.approx(2.0, abs=0.01)
    assert found[0][1] > np.cos(np.radians(0.5))


def test_scattered_points_are_no_floor(rng: np.random.Generator) -> None:
    position, rotation, _ = scene(rng)
    points = rng.normal(size=(400, 3)) + position[0]
    assert fit_floor(points, position[0], rotation[0][:, 1]) is None
    world = world_of(position, rotation, points, None, measure=Measure(height_m=3.0))
    assert world.floor is None
    assert "no floor was found" in world.scale_from
