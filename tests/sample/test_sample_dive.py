# SPDX-License-Identifier: Apache-2.0
"""The light of the sample dive: its picture sends down what its floor and its truth are told."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.caustics import GerstnerSea
from mr360uw.caustics.sea.gerstner import GerstnerWave
from mr360uw.color import luminance
from mr360uw.sample.dive_plate import SUN_SHARE, DivePlate, DiveSettings
from mr360uw.sphere import directions, row_solid_angle
from tests.tolerances import DIVE_SUN_SHARE, DIVE_WHITE

WIDTH, HEIGHT = 512, 256


class CalmDive(DiveSettings):
    """A dive in a flat sea."""

    @property
    def sea(self) -> GerstnerSea:
        return GerstnerSea(explicit_waves=(GerstnerWave(wave_vector=(1.0, 0.0), amplitude_m=0.0),))


@pytest.fixture(scope="module")
def flux() -> np.ndarray:
    """What pixels (H, W, 3) bring from above, just under a flat sea; the sun is ahead."""
    settings = CalmDive(camera_depth_m=0.05, sun_azimuth_rad=0.0)
    image = DivePlate(settings, WIDTH, HEIGHT).radiance(0.0).astype(np.float64)
    return image * np.maximum(directions(WIDTH, HEIGHT)[..., 1:2], 0.0) * row_solid_angle(WIDTH, HEIGHT)[:, None, None]


def test_the_picture_holds_the_suns_share(flux: np.ndarray) -> None:
    down = flux.sum(axis=0)
    # the sky is as bright ahead as behind
    ahead = np.abs(np.arange(WIDTH) + 0.5 - WIDTH / 2) < WIDTH / 4
    total, behind = luminance(down.sum(axis=0)), luminance(down[~ahead].sum(axis=0))
    assert 1.0 - 2.0 * behind / total == pytest.approx(SUN_SHARE, abs=DIVE_SUN_SHARE)


def test_sun_and_sky_together_are_white(flux: np.ndarray) -> None:
    down = flux.sum(axis=(0, 1))
    np.testing.assert_allclose(down / luminance(down), 1.0, atol=DIVE_WHITE)
