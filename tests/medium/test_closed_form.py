# SPDX-License-Identifier: Apache-2.0
"""The closed form: reference values, every limit, its shader twin."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import Water, multiple_scattering
from mr360uw.medium.closed_form import closed_form, path_integral, ray_in_water
from mr360uw.medium.models import gershun_factor
from mr360uw.medium.ray_field import sum_modes
from tests.medium.tolerances import DEEP_REFLECTANCE, FLOAT64, SERIES
from tests.reference import reference_rows


def test_reference_values() -> None:
    rows = [list(row.values())[1:] for row in reference_rows("closed_form.csv")]
    b, c, k, y, mu, s, expected = np.array(rows, float).T
    np.testing.assert_allclose(closed_form(b, c, k, s, y, mu), expected, rtol=FLOAT64, atol=0.0)


def test_a_million_random_cases_are_finite(rng: np.random.Generator) -> None:
    n = 1_000_000
    b, a = 10.0 ** rng.uniform(-4, 1, n), 10.0 ** rng.uniform(-4, 1, n)
    k = a * rng.uniform(1.0, 4.0, n)
    y, s = 10.0 ** rng.uniform(-6, 4, n), 10.0 ** rng.uniform(-9, 9, n)
    mu = rng.uniform(-1.0, 1.0, n)
    s[: n // 10], y[n // 10 : n // 5], mu[n // 5 : n // 4] = np.inf, 0.0, rng.choice([-1.0, 0.0, 1.0], n // 4 - n // 5)
    k[n // 4 : n // 3] = (a + b)[n // 4 : n // 3] / np.maximum(mu[n // 4 : n // 3], 0.1)
    radiance = closed_form(b, a + b, k, s, y, mu)
    assert np.all(np.isfinite(radiance))
    assert np.all(radiance >= 0.0)
    # no ray scatters more than all the light there is along it
    assert np.all(radiance <= b / (4 * np.pi) * ray_in_water(s, y, mu) * (1.0 + FLOAT64))


def test_limits() -> None:
    b, c, k, y = 0.3, 0.5, 0.2, 5.0
    short = closed_form(b, c, k, 0.01 / c, y, 0.3)
    np.testing.assert_allclose(short, b / (4 * np.pi) * np.exp(-k * y) * 0.01 / c, rtol=SERIES)
    np.testing.assert_allclose(
        closed_form(b, c, k, np.inf, y, -0.4), b / (4 * np.pi) * np.exp(-k * y) / (c + 0.4 * k), rtol=FLOAT64
    )
    singular = closed_form(b, c, c / 0.5, 1.0, y, 0.5)
    np.testing.assert_allclose(singular, b / (4 * np.pi) * np.exp(-c / 0.5 * y), rtol=FLOAT64)
    assert closed_form(0.0, c, k, 10.0, y, 0.1) == 0.0
    assert closed_form(b, c, k, 0.0, y, 0.1) == 0.0
    assert closed_form(0.0, 0.0, 0.0, np.inf, y, -1.0) == 0.0
    # beyond the surface there is nothing
    assert closed_form(b, c, k, 1e3, y, 1.0) == closed_form(b, c, k, y, y, 1.0)


def test_path_integral_is_an_integral(rng: np.random.Generator) -> None:
    x, w = np.polynomial.legendre.leggauss(40)
    c, k, y = rng.uniform(0.05, 1, 50), rng.uniform(0.02, 1, 50), rng.uniform(1, 9, 50)
    mu = rng.uniform(-1, 1, 50)
    s = ray_in_water(rng.uniform(0.1, 5, 50), y, mu)
    t = 0.5 * s[:, None] * (x + 1.0)
    integral = np.sum(
        0.5 * s[:, None] * w * np.exp(-c[:, None] * t - k[:, None] * (y[:, None] - t * mu[:, None])), axis=1
    )
    np.testing.assert_allclose(path_integral(c, k, s, y, mu), integral, rtol=FLOAT64)


def test_a_compiled_sum_of_path_integrals_is_the_sum(rng: np.random.Generator) -> None:
    """Modes that fade downwards and upwards, some of which underflow by the depth and overflow by the way."""
    rate, origin = np.array([[0.02, 0.3, 60.0, -0.3, -60.0, 0.5]]), np.array([0.0, 0.0, 0.0, 9.0, 9.0, 0.0])
    extinction, mu, which = np.array([0.5]), np.array([-0.4, 0.0, 1.0]), rng.integers(0, 3, 60)
    depth = rng.uniform(1.0, 8.0, 60)
    way = np.minimum(ray_in_water(rng.uniform(0.0, 90.0, 60), depth, mu[which]), (9.0 - depth) / 0.4)
    source = rng.uniform(0.1, 1.0, (3, 1, 6))
    for modes in (np.array([0]), np.arange(5), np.arange(6)):  # one by one, and four at a time
        chosen = source[..., modes].copy(), rate[:, modes].copy(), origin[modes]
        found = sum_modes(*chosen, extinction, mu, which, depth, way)
        start, s, up = (depth[:, None] - origin[modes]), way[:, None], mu[which][:, None]
        one_by_one = chosen[0][which, 0] * path_integral(extinction, chosen[1], s, start, up)
        np.testing.assert_allclose(found[:, 0], one_by_one.sum(axis=1), rtol=FLOAT64)


def test_public_call() -> None:
    water = Water.jerlov("IB")
    w = np.array([450.0, 550.0, 650.0])
    radiance = multiple_scattering(water, w, np.full((4, 5), 3.0), 5.0, 0.2, surface_irradiance=[1.0, 2.0, 3.0])
    assert radiance.shape == (4, 5, 3)
    single = closed_form(
        water.scattering(550.0), water.attenuation(550.0), water.diffuse_attenuation(550.0), 3.0, 5.0, 0.2
    )
    np.testing.assert_allclose(radiance[2, 3, 1], 2.0 * single, rtol=FLOAT64)
    for bad in ((-1.0, 5.0, 0.0), (1.0, -5.0, 0.0), (1.0, 5.0, 1.5), (1.0, np.inf, 0.0), (np.nan, 5.0, 0.0)):
        with pytest.raises(ParameterError, match=" - "):
            multiple_scattering(water, w, *bad)


@pytest.mark.parametrize("omega", [0.3, 0.6, 0.9, 0.98])
def test_light_deep_down_has_the_reflectance_of_a_deep_medium(omega: float) -> None:
    """1 - R of isotropic scattering is 2 sqrt(1 - w) times the first moment of Chandrasekhar's H (1960, sec. 38)."""
    x, weight = np.polynomial.legendre.leggauss(64)
    mu, weight = 0.5 * (x + 1.0), 0.5 * weight
    h = np.ones(64)
    for _ in range(400):  # 1/H = sqrt(1 - w) + w/2 int mu' H(mu')/(mu + mu') dmu'
        h = 1.0 / (np.sqrt(1.0 - omega) + 0.5 * omega * np.sum(weight * mu * h / (mu[:, None] + mu), axis=1))
    kept = 2.0 * np.sqrt(1.0 - omega) * np.sum(weight * mu * h)
    assert gershun_factor(1.0 - omega, omega, 1.0, 0.0) * (1.0 - omega) == pytest.approx(kept, abs=DEEP_REFLECTANCE)
