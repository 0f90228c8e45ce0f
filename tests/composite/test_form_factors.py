# SPDX-License-Identifier: Apache-2.0
"""The closed forms that occlusion is held to agree with other closed forms and with directions drawn at random."""

from __future__ import annotations

import numpy as np
import pytest

from tests.composite.form_factors import box_form_factor, polygon_form_factor, sphere_form_factor

UP = np.array([0.0, 1.0, 0.0])
ORIGIN = np.zeros(3)


def rectangle(a: float, b: float, height: float) -> np.ndarray:
    """Return a horizontal rectangle with one corner above the origin."""
    return np.array([[0, height, 0], [a, height, 0], [a, height, b], [0, height, b]], float)


@pytest.mark.parametrize(("a", "b", "height"), [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7), (5.0, 0.1, 0.02)])
def test_a_rectangle_above_its_corner(a: float, b: float, height: float) -> None:
    """Hamilton & Morgan 1952, a rectangle parallel to a small surface below one of its corners."""
    x, y = a / height, b / height
    p, q = np.hypot(1.0, x), np.hypot(1.0, y)
    expected = (x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2.0 * np.pi)
    for corners in (rectangle(a, b, height), rectangle(a, b, height)[::-1]):
        assert polygon_form_factor(ORIGIN, UP, corners) == pytest.approx(expected, rel=1e-12)


def test_a_polygon_of_many_sides_is_the_disc_and_the_sphere_behind_it() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    disc = np.stack([0.6 * np.cos(angle), np.full_like(angle, 0.8), 0.6 * np.sin(angle)], axis=-1)
    # R^2/(R^2 + h^2) with R = 0.6, h = 0.8; the polygon's area is short of the disc's by 4e-7
    assert polygon_form_factor(ORIGIN, UP, disc) == pytest.approx(0.36, rel=1e-6)
    # the sphere that touches the same cone: its sine is R/D = 0.6
    sphere = sphere_form_factor(ORIGIN[None], UP, np.array([0.0, 1.0, 0.0]), 0.6)
    assert sphere[0] == pytest.approx(0.36, rel=1e-12)


def test_what_is_below_the_horizon_is_cut_off() -> None:
    wall = np.array([[1e-7, -1e3, -1e3], [1e-7, 1e3, -1e3], [1e-7, 1e3, 1e3], [1e-7, -1e3, 1e3]])
    assert polygon_form_factor(ORIGIN, UP, wall) == pytest.approx(0.5, abs=1e-3)  # the wall ends at 1e3: 1e-3 of it
    assert polygon_form_factor(ORIGIN, UP, rectangle(1.0, 1.0, -1.0)) == 0.0


def test_a_box_by_random_directions() -> None:
    rng = np.random.default_rng(12)
    u, turn = rng.uniform(size=400_000), rng.uniform(0.0, 2.0 * np.pi, 400_000)
    rays = np.stack([np.sqrt(u) * np.cos(turn), np.sqrt(1.0 - u), np.sqrt(u) * np.sin(turn)], axis=-1)
    low, high = np.array([0.2, 0.1, -0.5]), np.array([0.9, 0.6, 0.7])
    with np.errstate(divide="ignore"):
        ends = np.sort([low / rays, high / rays], axis=0)
    hit = ends[0].max(axis=-1) < ends[1].min(axis=-1)
    # five standard deviations of the mean of 4e5 draws
    tolerance = 5.0 * np.sqrt(hit.mean() * (1.0 - hit.mean()) / len(hit))
    assert box_form_factor(ORIGIN, UP, low, high) == pytest.approx(hit.mean(), abs=tolerance)


def test_a_box_right_above_a_point_takes_all_its_light() -> None:
    low, high = np.array([-1.0, 1e-6, -1.0]), np.array([1.0, 1.0, 1.0])
    assert box_form_factor(ORIGIN, UP, low, high) == pytest.approx(1.0, abs=1e-5)
