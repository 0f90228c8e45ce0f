# SPDX-License-Identifier: Apache-2.0
"""The pattern of light that the water has turned by small angles."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.caustic_lookup import mip_levels, soft_caustic_lookup
from mr360uw.base.optics import refract_to_water
from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.sun_disc import gaussians, soft_light
from mr360uw.types import BeamSpread
from tests.caustics import tolerances as tol
from tests.caustics.seas import SEAS

SUN = direction_from_angles(np.pi / 2, np.radians(50.0))  # along +x
SPREAD = BeamSpread(
    0.3,
    np.array([0.01, 0.05, 0.2]),
    np.array([0.1, 2.0, 20.0]),
    np.array([[0.5, 0.4, 0.1], [0.2, 0.5, 0.3], [0, 0, 1]]),
)


@pytest.mark.parametrize("along_x", [True, False])
def test_a_wave_of_light_fades_by_the_sum_of_gaussians(along_x):
    """Along the sun's azimuth the light spreads wider by one over the y of its direction."""
    depth, tile_m, water = 4.0, 8.0, refract_to_water(SUN)
    wave = 1.0 + 0.5 * np.cos(2.0 * np.pi * 4.0 * np.arange(64) / 64.0)[None] * np.ones((64, 1))
    wave = wave if along_x else wave.T
    path = depth / water[1]
    sigma = SPREAD.angle_rad * path / (water[1] if along_x else 1.0)
    kept = SPREAD.weights(path) @ np.exp(-2.0 * (np.pi * sigma * 4.0 / tile_m) ** 2)
    got = soft_light(wave, gaussians(SPREAD, depth, water, 1e-6), tile_m)
    np.testing.assert_allclose(got, 1.0 + kept * (wave - 1.0), atol=tol.FLOAT64)


def test_a_stack_has_the_pattern_of_turned_light():
    s = CausticSettings(size=64, grid=48)
    stack = caustic_stack(SEAS["gerstner"], SUN, [1.0, 4.0], 0.0, s, spread=SPREAD)
    assert stack.soft is not None
    np.testing.assert_allclose(stack.soft.mean(axis=(1, 2)), 1.0, atol=tol.CAUSTICS_MEAN_REFERENCE)
    assert stack.soft[1].std() < 0.5 * stack.ratio[1].std()
    assert stack.soft.min() >= 0.0
    np.testing.assert_array_equal(stack.ratio, caustic_stack(SEAS["gerstner"], SUN, [1.0, 4.0], 0.0, s).ratio)
    clear = BeamSpread(1e-3, SPREAD.angle_rad, SPREAD.optical_depth, SPREAD.weight)
    assert caustic_stack(SEAS["gerstner"], SUN, [1.0, 4.0], 0.0, s, spread=clear).soft is None


def test_a_beam_is_its_sharp_and_its_soft_part():
    stack = caustic_stack(SEAS["gerstner"], SUN, [2.0], 0.0, CausticSettings(size=32, grid=32), spread=SPREAD)
    levels = mip_levels(stack.ratio), mip_levels(stack.soft)
    sharp, soft, half = (soft_caustic_lookup(stack, *levels, 1.3, 2.0, 0.4, 0.0, u) for u in (1.0, 0.0, 0.5))
    np.testing.assert_allclose(half, 0.5 * (sharp + soft), rtol=tol.FLOAT64)
    assert abs(sharp[0] - soft[0]) > 0.01
