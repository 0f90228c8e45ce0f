# SPDX-License-Identifier: Apache-2.0
"""The spread of the beam by small angles, against its limits, its second moment and photons."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.medium import Medium, Water
from mr360uw.medium.phase import forward_peak
from mr360uw.medium.scattered_light import beam_spread, spread_factor, spread_of
from tests.medium import tolerances as tol

PHASES = ("petzold", ("hg", 0.924), ("fournier-forand", 1.1, 3.5835))


@pytest.mark.parametrize("phase", PHASES)
def test_limits_of_the_factor(phase) -> None:
    """No light is lost; the finest pattern is that of light that has not turned; wide ones fade by the variance."""
    tau, x = np.array([0.3, 2.0]), np.array([0.0, 0.02, 3e4])
    factor = spread_factor(*forward_peak(phase), tau, x)
    np.testing.assert_allclose(factor[:, 0], 1.0, atol=tol.FLOAT64)
    np.testing.assert_allclose(factor[:, 2], np.exp(-tau), atol=tol.FINEST_PATTERN)
    theta, share = forward_peak(phase)
    assert share.sum() == pytest.approx(1.0)
    variance = tau * np.sum(share * theta**2) / 3.0  # the integral of u^2 over the path
    np.testing.assert_allclose(-np.log(factor[:, 1]), (np.pi * 0.02) ** 2 * variance, rtol=tol.SECOND_MOMENT)


@pytest.mark.parametrize("phase", PHASES)
def test_the_factor_is_that_of_photons(rng: np.random.Generator, phase) -> None:
    """Photons turn at random places of the path: the mean of cos(2 pi x offset)."""
    tau, x, count = 1.2, np.array([1.0, 4.0, 16.0, 64.0]), 60_000
    theta, share = forward_peak(phase)
    offset, turns = np.zeros(count), rng.poisson(tau, count)
    for turn in range(int(turns.max())):
        angle = rng.choice(theta, count, p=share) * np.cos(rng.uniform(0.0, 2.0 * np.pi, count))
        offset += np.where(turns > turn, angle * rng.uniform(0.0, 1.0, count), 0.0)
    photons = np.mean(np.cos(2.0 * np.pi * x[:, None] * offset), axis=1)
    np.testing.assert_allclose(spread_factor(*forward_peak(phase), np.array([tau]), x)[0], photons, atol=tol.PHOTONS)


@pytest.mark.parametrize("phase", PHASES)
def test_gaussians_stand_for_the_factor(phase) -> None:
    spread, x = beam_spread(phase, 0.4), np.geomspace(0.1, 100.0, 30)
    for path_m in (0.5, 3.0, 8.0, 25.0):
        weights, left = spread.weights(path_m), spread.unturned(path_m)
        assert weights.min() >= 0.0
        assert weights.sum() == pytest.approx(1.0)
        turned = weights @ np.exp(-2.0 * (np.pi * spread.angle_rad[:, None] * x) ** 2)
        expected = spread_factor(*forward_peak(phase), np.array([0.4 * path_m]), x)[0]
        np.testing.assert_allclose(left + (1.0 - left) * turned, expected, atol=tol.SUM_OF_GAUSSIANS)


def test_waters_whose_beam_has_no_turned_light_have_no_spread() -> None:
    assert spread_of(Medium(Water.jerlov("1C"), mode="kd")) is None
    assert spread_of(Medium(Water.pure())) is None
    spread = spread_of(Medium(Water.jerlov("1C")))
    assert spread is not None
    assert 0.1 < spread.scattering < float(Water.jerlov("1C").scattering(550.0))
