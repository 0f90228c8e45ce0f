# SPDX-License-Identifier: Apache-2.0
"""Refraction and reflection of rays and radiance, both ways, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base import optics
from mr360uw.base.sphere import unit
from mr360uw.errors import ParameterError
from tests.surface import tolerances as tol

N = 1.34
COSINE = np.linspace(1e-3, 1.0 - 1e-3, 1001)


def test_fresnel_is_that_of_sines_and_tangents() -> None:
    across, along = optics.fresnel_polarized(COSINE, N)
    a, b = np.arccos(COSINE), np.arcsin(np.sqrt(1.0 - COSINE**2) / N)
    np.testing.assert_allclose(across, (np.sin(a - b) / np.sin(a + b)) ** 2, atol=tol.PRINTED_FRESNEL)
    np.testing.assert_allclose(along, (np.tan(a - b) / np.tan(a + b)) ** 2, atol=tol.PRINTED_FRESNEL)


def test_nothing_polarised_along_the_plane_is_reflected_at_brewsters_angle() -> None:
    across, along = optics.fresnel_polarized(np.cos(np.arctan(N)), N)
    assert along < tol.FLOAT64 < across


def test_both_ways_reflect_alike_and_total_reflection_is_total() -> None:
    behind = optics.cosine_behind(COSINE, N)
    np.testing.assert_allclose(optics.fresnel(COSINE, N), optics.fresnel(behind, 1.0 / N), atol=tol.FLOAT64)
    np.testing.assert_array_equal(optics.fresnel(np.linspace(0.0, optics.critical_cosine(N) - 1e-9, 9), 1.0 / N), 1.0)


def test_radiance_there_and_back() -> None:
    """Reciprocity: the factor of the way back is that of the way there over n^4."""
    behind = optics.cosine_behind(COSINE, N)
    there, back = optics.radiance_factor(COSINE, N), optics.radiance_factor(behind, 1.0 / N)
    np.testing.assert_allclose(there / N**2, back * N**2, atol=tol.FLOAT64)


def test_energy_down_and_reflected_is_what_comes_in() -> None:
    x, w = np.polynomial.legendre.leggauss(200)
    u, du = 0.5 * (1.0 + x), 0.5 * w
    edge = optics.critical_cosine(N)
    window, share = edge + (1.0 - edge) * u**2, (1.0 - edge) * 2.0 * u * du
    down = np.sum(share * window * (1.0 - optics.fresnel_from_below(window, N)) * N**2)
    back = np.sum(u * du * optics.fresnel(u, N))
    assert abs((down + back) / 0.5 - 1.0) < tol.ENERGY
    up = np.sum(u * du * optics.radiance_factor(optics.cosine_behind(u, N), 1.0 / N))
    assert abs((up + 0.5 * optics.diffuse_reflectance_from_below(N)) / 0.5 - 1.0) < tol.ENERGY


def test_directions_there_and_back(rng: np.random.Generator) -> None:
    normal = unit(rng.standard_normal((1000, 3)))
    travel = unit(rng.standard_normal((1000, 3)))
    travel *= -np.sign(np.sum(travel * normal, axis=-1, keepdims=True))
    water = optics.refract_clamped(travel, normal, 1.0 / N)
    np.testing.assert_allclose(optics.refract_clamped(-water, -normal, N), -travel, atol=tol.FLOAT64 * 10.0)
    np.testing.assert_allclose(optics.reflect(optics.reflect(travel, normal), normal), travel, atol=tol.FLOAT64)


def test_water_dims_what_goes_up_and_down_again() -> None:
    r = optics.diffuse_reflectance_from_below(N, [0.0, 0.1, 1.0])
    assert r[0] == pytest.approx(optics.diffuse_reflectance_from_below(N))
    assert np.all(np.diff(r) < 0.0)


def test_an_index_that_is_none_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"relative_index - .*\(got -1"):
        optics.fresnel(0.5, -1.0)
