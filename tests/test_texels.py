# SPDX-License-Identifier: Apache-2.0
"""Curves through points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from mr360uw.texels import curve_through


@pytest.mark.parametrize("count", [2, 3, 7])
def test_a_smooth_curve_is_the_monotone_cubic_of_scipy(rng: np.random.Generator, count: int) -> None:
    places = np.cumsum(0.1 + rng.random(count))
    for values in (rng.normal(size=(count, 3)), np.round(rng.normal(size=count)), np.cumsum(rng.random(count))):
        curve, cubic = curve_through(places, values, smooth=True), PchipInterpolator(places, values, axis=0)
        for place in [*places, *rng.uniform(places[0], places[-1], 20)]:
            np.testing.assert_allclose(curve(place), cubic(place), rtol=0.0, atol=1e-13)


def test_a_straight_curve_is_that_of_numpy_and_keeps_equal_values(rng: np.random.Generator) -> None:
    places, values = np.cumsum(0.1 + rng.random(5)), rng.normal(size=5)
    curve = curve_through(places, values, smooth=False)
    for place in [*places, *rng.uniform(places[0], places[-1], 20)]:
        np.testing.assert_allclose(curve(place), np.interp(place, places, values), rtol=0.0, atol=1e-13)
    assert curve_through([0.0, 3.0], [0.1, 0.1], smooth=False)(0.7) == 0.1
