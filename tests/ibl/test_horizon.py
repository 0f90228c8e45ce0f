# SPDX-License-Identifier: Apache-2.0
"""Levelling by Snell's window."""

from __future__ import annotations

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.sphere import directions
from mr360uw.errors import ParameterError
from mr360uw.ibl.lookup import reduce_map
from mr360uw.ibl.tilt import HorizonEstimate, clip_horizon, estimate_horizon, level_matrix
from mr360uw.preview.pages import level_section
from tests.ibl.panoramas import SKIES, panorama
from tests.ibl.plates import angle_deg, clipped, sky
from tests.ibl.tolerances import FLOAT64, HORIZON_DEG

TILTS = [(0.0, 0.0), (0.15, -0.2), (-0.3, 0.25)]


def window(roll: float, pitch: float, *, side: float = 0.0, step: float = 0.6) -> np.ndarray:
    """Return a map (128, 256, 3) of a window over dark water, one side brighter by e^2side, seen by a tilted camera."""
    d = directions(256, 128) @ level_matrix(roll, pitch).T
    elevation = np.arcsin(np.clip(d[..., 1], -1.0, 1.0))
    value = 1.2 * d[..., 1] + side * d[..., 0] + step * np.tanh((elevation - np.radians(41.7)) / 0.08)
    return 0.1 * np.exp(value)[..., None] * np.array([0.5, 0.9, 1.0])


def off_deg(found: tuple[float, float], roll: float, pitch: float) -> float:
    return angle_deg(level_matrix(*found)[1], level_matrix(roll, pitch)[1])


@pytest.mark.parametrize(("roll", "pitch"), TILTS)
@pytest.mark.parametrize("side", [0.0, 0.5])
def test_the_window_is_found_though_one_side_is_brighter(
    roll: float, pitch: float, side: float, rng: np.random.Generator
) -> None:
    image = window(roll, pitch, side=side) * np.exp(rng.normal(0.0, 0.2, (128, 256, 1)))
    found = estimate_horizon(reduce_map(image, 64, 32))
    assert found.reliable
    assert off_deg((found.roll_rad, found.pitch_rad), roll, pitch) < HORIZON_DEG


@pytest.mark.parametrize("side", [0.0, 0.3])
def test_water_without_a_window_tells_nothing(side: float) -> None:
    assert not estimate_horizon(reduce_map(window(0.2, 0.1, side=side, step=0.0), 64, 32)).reliable


def test_a_dive_is_levelled_by_its_clip() -> None:
    from mr360uw.sample import Dive
    from tests.dives import over_sand

    plate = Dive(over_sand(depth_m=8.0, floor_m=20.0, water="IB"), 256, 128)
    lights = [ibl.environment(np.clip(plate.radiance(t), 0.0, 1.0).astype(np.float32)) for t in (0.0, 2.1, 4.7)]
    found = [estimate_horizon(light.residual) for light in lights]
    clip = clip_horizon(found)
    assert clip is not None
    assert off_deg(clip[:2], 0.0, 0.0) < HORIZON_DEG
    assert sum(one.reliable for one in found) >= 2


def test_few_sights_of_the_window_are_none() -> None:
    good, bad = HorizonEstimate(0.1, 0.0, 0.9, 3.0), HorizonEstimate(-0.4, 0.3, 0.2, 1.1)
    found = clip_horizon([good, good, bad])
    assert found is not None
    np.testing.assert_allclose(found[:2], (0.1, 0.0), atol=FLOAT64**0.5)
    assert clip_horizon([good, bad, bad]) is None
    assert clip_horizon([]) is None


def test_the_page_says_what_to_write() -> None:
    up = np.array([0.0, 1.0, 0.0])
    good, turned = HorizonEstimate(0.1, -0.05, 0.9, 3.0), HorizonEstimate(-0.2, 0.1, 0.9, 3.0)
    assert "roll_deg = 5.7\npitch_deg = -2.9" in level_section([good, good], up)
    assert "tilt_keys" in level_section([good, turned], up)
    assert "is level" in level_section([HorizonEstimate(-0.01, 0.02, 0.9, 3.0)], up)
    assert "gravity" in level_section([HorizonEstimate(0.0, 0.0, 0.1, 1.0)], up)


def test_odd_maps_are_not_level() -> None:
    for image in (np.zeros((32, 64, 3)), np.ones((32, 64, 3)), sky(np.array([0.0, 1.0, 0.0]), width=64)):
        assert not estimate_horizon(image).reliable
    with pytest.raises(ParameterError, match="radiance"):
        estimate_horizon(np.zeros((32, 64)))


@pytest.mark.parametrize("name", ["low sun", *SKIES])
def test_pictures_above_the_water_show_no_window(name: str) -> None:
    assert not estimate_horizon(ibl.environment(panorama(name)).residual).reliable


def test_a_clipped_sky_is_no_window() -> None:
    assert not estimate_horizon(ibl.environment(clipped(sky(np.array([0.3, 0.8, 0.1])), 4.0)).residual).reliable
