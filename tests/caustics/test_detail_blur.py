# SPDX-License-Identifier: Apache-2.0
"""The blur by short waves: against refracted rays, random slopes and a surface that has those waves."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import GerstnerSea, caustic_map
from mr360uw.caustics.irradiance import ray_slope
from mr360uw.caustics.sun_disc import blur, detail_footprint, gaussian_transform
from tests.caustics import tolerances as tol

FLAT = GerstnerSea(wind_speed=0.0, detail_slope=0.05)


@pytest.mark.parametrize("elevation_deg", [90.0, 50.0, 8.0])
def test_the_footprint_is_that_of_rays_through_random_slopes(elevation_deg):
    sun = direction_from_angles(0.7, np.radians(elevation_deg))
    slopes = np.random.default_rng(1).normal(0.0, 0.01 / np.sqrt(2.0), (40_000, 2))
    normal = np.stack([-slopes[:, 0], np.ones(len(slopes)), -slopes[:, 1]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    expected = np.cov(3.0 * ray_slope(normal, sun, 1.34).T)
    matrix = detail_footprint(sun, 1.34, 0.01, 3.0)
    np.testing.assert_allclose(matrix @ matrix.T, expected, rtol=tol.RANDOM_SLOPES, atol=1e-2 * expected.max())


@pytest.mark.parametrize("sigma", [0.7, 2.0, 9.0])
def test_a_gaussian_blurs_a_wave_by_its_transform(sigma):
    """exp(-2 pi^2 sigma^2 f^2) of a sine of frequency f, here of eight pixels and more."""
    wave = 1.0 + 0.5 * np.cos(2.0 * np.pi * np.arange(64) / 16.0) * np.ones((64, 1))
    matrix = sigma * np.eye(2)
    got = blur(wave, np.zeros((2, 2)), 64.0, gaussian_transform(matrix, 64, 64.0))
    expected = 1.0 + (wave - 1.0) * np.exp(-2.0 * (np.pi * sigma / 16.0) ** 2)
    np.testing.assert_allclose(got, expected, atol=tol.ROUNDED_GAUSSIAN)
    assert gaussian_transform(0.4 * np.eye(2), 64, 64.0) is None


def test_below_their_focus_short_waves_blur():
    """Waves of 0.5 to 3 m, with short ones on a fine grid and with their blur alone, seen 12 cm wide."""
    rng = np.random.default_rng(4)
    swell, high, phase = 2.0 * np.pi / 4.0 * np.array([[1, 1], [0, 3], [4, -3], [6, 5]]), [0.02, 0.02, 0.01, 0.006], 0.3
    turn, length = rng.uniform(0.0, 2.0 * np.pi, 40), 2.0 * np.pi / rng.uniform(0.06, 0.12, 40)
    short = length[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rms = 0.08
    amplitude = rms * np.sqrt(2.0 / 40.0) / length
    drawn = GerstnerSea.from_waves(
        [*swell, *short], [*high, *amplitude], 0.0, [*[phase] * 4, *rng.uniform(0.0, 6.28, 40)], tile_m=4.0
    )
    blurred = GerstnerSea.from_waves(swell, high, 0.0, phase, tile_m=4.0, detail_slope=rms)
    sharp = GerstnerSea.from_waves(swell, high, 0.0, phase, tile_m=4.0)
    sun = direction_from_angles(0.4, np.radians(60.0))
    maps = [caustic_map(sea, sun, 6.0, 0.0, 64, grid) for sea, grid in ((drawn, 384), (blurred, 64), (sharp, 64))]
    seen = [m.reshape(32, 2, 32, 2).mean(axis=(1, 3)) for m in maps]
    errors = [float(np.sqrt(np.mean((m - seen[0]) ** 2)) / seen[0].std()) for m in seen[1:]]
    assert errors[0] < tol.BLURRED_WAVES
    assert errors[1] > 3.0 * errors[0]
    assert maps[1].mean() == pytest.approx(1.0, abs=tol.CAUSTICS_MEAN_REFERENCE)


def test_a_flat_sea_stays_even():
    np.testing.assert_allclose(
        caustic_map(FLAT, (0.3, 1.0, 0.0), 5.0, 0.0, 32, 16), 1.0, atol=tol.CAUSTICS_MEAN_REFERENCE
    )
