# SPDX-License-Identifier: Apache-2.0
"""Light about the sun: the map that the veil is multiplied by, and a plate's open water beside it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mr360uw.base.sphere import directions
from mr360uw.medium import Medium, Water
from mr360uw.medium.models import FieldModel
from mr360uw.medium.open_water import COLUMNS, ROWS, OpenWater, row_up
from mr360uw.medium.scattered_light import AZIMUTHS, _over_mean, around_sun, placed, typical_level
from tests.medium.tolerances import AROUND_ALL_BANDS, GROWTH_AROUND_SUN, HARMONIC

DEPTH = 4.0
AROUND_ROUGHLY, LEVEL_ROUGHLY = 0.02, 0.001
"""Relative error of drafts: root mean square over the sphere, and of typical light at the horizon. A code is 1 %."""


def lit(sun_up: float = 0.85, water: str = "IB") -> Medium:
    return Medium(Water.jerlov(water), sky=("sun", sun_up, 0.75), camera_depth_m=DEPTH)


def test_between_azimuths_the_ratio_is_a_cubic_spline(rng: np.random.Generator) -> None:
    """That of SciPy, level towards the sun and away from it, and its mean over the circle is that of the spline."""
    values = rng.uniform(0.5, 2.0, (ROWS, len(AZIMUTHS), 3))
    level = directions(COLUMNS, 2)[0]
    azimuth = np.arccos(level[:, 0] / np.hypot(level[:, 0], level[:, 2]))
    splines = CubicSpline(AZIMUTHS, values, axis=1, bc_type="clamped")
    np.testing.assert_allclose(placed(values, np.array([1.0, 0.5, 0.0])), splines(azimuth), rtol=1e-12)
    mean = splines.integrate(0.0, np.pi)[:, None] / np.pi
    np.testing.assert_allclose(_over_mean(values), values / mean, rtol=1e-12)


def test_the_map_is_the_solved_light_about_the_sun() -> None:
    medium, towards = lit(), np.array([0.4, 0.85, -0.3])
    ratio = around_sun(medium)
    assert ratio is not None
    around = placed(ratio, towards)
    np.testing.assert_allclose(around.mean(axis=1), 1.0, rtol=1e-6)  # each height keeps its light
    d = directions(COLUMNS, ROWS)
    for row, column in ((63, 10), (64, 200), (90, 128), (110, 60), (20, 77)):
        v = d[row, column]
        angle = np.arctan2(v[0] * towards[2] - v[2] * towards[0], v[0] * towards[0] + v[2] * towards[2])
        model = FieldModel(medium.model.field.at_azimuth(angle), medium.model.part)
        for s, tolerance in ((np.inf, AROUND_ALL_BANDS), (3.0, GROWTH_AROUND_SUN)):
            end = min(s, DEPTH / max(v[1], 1e-9))
            seen = model.inscatter(end, DEPTH, v[1]) @ medium.bands.lobes
            mean = medium.model.inscatter(end, DEPTH, v[1]) @ medium.bands.lobes
            np.testing.assert_allclose(around[row, column] * mean, seen, rtol=tolerance)
    assert around.max() > 2.0 > 0.5 > around.min()


def test_no_sun_no_map_and_a_sun_overhead_has_none_to_show() -> None:
    assert around_sun(Medium(Water.jerlov("IB"))) is None
    assert around_sun(Medium(Water.jerlov("IB"), mode="kd", sky=("sun", 0.9, 1.0))) is None
    overhead = around_sun(lit(1.0))
    assert overhead is not None
    np.testing.assert_allclose(overhead, 1.0, rtol=1e-6)


def test_it_changes_steadily_with_the_depth() -> None:
    medium = lit()
    one, step, other = (around_sun(medium.at_depth(4.0 * (1.0 + x))) for x in (-1e-6, 0.0, 1e-6))
    assert one is not None
    assert step is not None
    assert other is not None
    np.testing.assert_allclose(one, step, rtol=1e-4)
    np.testing.assert_allclose(other, step, rtol=1e-4)


@pytest.mark.parametrize("water", ["IB", "II", "7C"])
def test_that_of_drafts_is_about_the_same(water: str) -> None:
    medium = lit(water=water)
    exact, rough = around_sun(medium), around_sun(medium.for_drafts())
    assert exact is not None
    assert rough is not None
    assert np.sqrt(np.mean((rough / exact - 1.0) ** 2)) < AROUND_ROUGHLY
    towards = np.array([0.4, 0.85, -0.3])
    levels = [typical_level(placed(ratio, towards)) for ratio in (rough, exact)]
    np.testing.assert_allclose(*levels, rtol=LEVEL_ROUGHLY)


@pytest.mark.parametrize("seen", ["all", "half", "none"])
def test_a_plate_stands_where_it_shows_water_and_the_sun_decides_what_it_hides(seen: str) -> None:
    """The light of the plate varies about the sun as the solved one: with R what it hides is found again."""
    ratio = around_sun(lit())
    assert ratio is not None
    around = placed(ratio, np.array([0.5, 0.8, 0.0]))
    around = around / typical_level(around)
    weight = np.zeros((ROWS, COLUMNS))
    columns = {"all": COLUMNS, "half": COLUMNS // 2, "none": 0}[seen]
    weight[(np.abs(row_up(ROWS)) < 0.3)[:, None] & (np.arange(COLUMNS) < columns)] = 1.0
    shown = 1.3 * around * np.array([1.0, 0.9, 1.1])
    found = OpenWater(np.log(shown), weight, np.full(3, 1e-9), np.log(around)).ratio(np.ones(3))
    expected = around if seen == "none" else shown
    np.testing.assert_allclose(found, expected, rtol=HARMONIC)
    # where the plate shows its water, R is of no weight
    without = OpenWater(np.log(shown), weight, np.full(3, 1e-9)).ratio(np.ones(3))
    if seen != "none":
        inner = (np.abs(row_up(ROWS)) < 0.25)[:, None] & (np.abs(np.arange(COLUMNS) - COLUMNS // 4) < COLUMNS // 5)
        np.testing.assert_allclose(without[inner], found[inner], rtol=HARMONIC)
