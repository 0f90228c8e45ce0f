# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.optics import refract_clamped
from mr360uw.base.sphere import unit
from mr360uw.caustics import (
    fresnel_reflectance,
    fresnel_transmittance,
    refract_to_air,
    refract_to_water,
    sea_water_index,
)
from mr360uw.errors import ParameterError
from tests.caustics import tolerances as tol


def upward(rng: np.random.Generator, count: int = 500) -> np.ndarray:
    v = rng.standard_normal((count, 3))
    v[:, 1] = np.abs(v[:, 1]) + 1e-3
    return unit(v)


def test_into_water_and_back(rng):
    air = upward(rng)
    np.testing.assert_allclose(refract_to_air(refract_to_water(air)), air, atol=tol.SNELL_ROUND_TRIP)


def test_snell(rng):
    air = upward(rng)
    water = refract_to_water(air, 1.34)
    sine_air, sine_water = np.hypot(air[:, 0], air[:, 2]), np.hypot(water[:, 0], water[:, 2])
    np.testing.assert_allclose(sine_air, 1.34 * sine_water, atol=tol.FLOAT64)
    np.testing.assert_allclose(np.linalg.norm(water, axis=1), 1.0, atol=tol.FLOAT64)


def test_thirty_degrees_in_water_are_forty_two_in_air():
    direction = (np.sin(np.radians(30.0)), np.cos(np.radians(30.0)), 0.0)
    angle = np.degrees(np.arccos(refract_to_air(direction, 1.34)[1]))
    assert angle == pytest.approx(np.degrees(np.arcsin(1.34 * 0.5)), abs=tol.FLOAT64)


def test_outside_snells_window_is_the_horizon_below_the_azimuth():
    for sine in (1.0 / 1.34, 0.8, 1.0):
        got = refract_to_air((sine * 0.6, np.sqrt(1.0 - sine * sine), -sine * 0.8), 1.34)
        np.testing.assert_allclose(got, (0.6, 0.0, -0.8), atol=tol.SNELL_ROUND_TRIP)


def test_general_refraction_on_a_flat_surface_is_the_special_one(rng):
    air = upward(rng)
    travel = refract_clamped(-air, np.array([0.0, 1.0, 0.0]), 1.0 / 1.34)
    np.testing.assert_allclose(-travel, refract_to_water(air, 1.34), atol=tol.FLOAT64)


def test_fresnel_limits():
    assert fresnel_reflectance(1.0, 1.34) == pytest.approx((0.34 / 2.34) ** 2, abs=tol.FLOAT64)
    assert fresnel_reflectance(0.0, 1.34) == 1.0
    assert np.all(np.diff(fresnel_transmittance(np.linspace(0.0, 1.0, 100), 1.34)) >= 0.0)


def test_fresnel_is_the_textbook_form(rng):
    c1, n = rng.uniform(1e-3, 1.0, 1000), 1.34
    c2 = np.sqrt(1.0 - (1.0 - c1**2) / n**2)
    s = (c1 - n * c2) / (c1 + n * c2)
    p = (c2 - n * c1) / (c2 + n * c1)
    np.testing.assert_allclose(fresnel_reflectance(c1, n), 0.5 * (s * s + p * p), atol=tol.FLOAT64)


def test_reflectance_of_a_uniform_sky():
    c = (np.arange(4000) + 0.5) / 4000
    assert np.mean(2.0 * c * fresnel_reflectance(c, 1.34)) == pytest.approx(0.0675, abs=tol.SKY_REFLECTANCE)


def test_index_of_sea_water():
    np.testing.assert_allclose(
        sea_water_index([400.0, 450.0, 550.0, 650.0]), [1.3499, 1.3459, 1.3408, 1.3377], atol=tol.PRINTED_INDEX
    )


@pytest.mark.parametrize("bad", [(0.0, -1.0, 0.0), (0.0, 0.0, 0.0), (np.nan, 1.0, 0.0)])
def test_directions_that_are_none(bad):
    with pytest.raises(ParameterError):
        refract_to_water(bad)


@pytest.mark.parametrize("index", [1.0, 0.5, np.nan, 9.0])
def test_indices_that_are_none(index):
    with pytest.raises(ParameterError, match="refractive_index"):
        refract_to_air((0.0, 1.0, 0.0), index)
