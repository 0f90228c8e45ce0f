# SPDX-License-Identifier: Apache-2.0
"""Seas whose wind changes: waves grow and fade where they are, none of them jumps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.caustics.gerstner import GerstnerSea, share_of_directions, share_of_lengths
from mr360uw.caustics.sea import mean_square_slope
from mr360uw.caustics.settings import Sea
from mr360uw.errors import SceneError
from mr360uw.scene.resolved import scene_at
from tests.scenes import scene_with

TIMES = np.arange(100.0, 102.0, 1.0 / 12.0)
"""Frames far from time 0, where a wave whose frequency or speed changes has gone far astray."""
NEAR = 1.2
"""Most that a sea that changes moves from frame to frame, over the larger of what the seas at its ends move. Its waves
grow besides; measured 0.6 to 1.09 here. Seas that are made anew for each frame have 1.7 to 4.5 times that."""


def seas(folder: Path, sea: dict[str, Any], name: str, values: list[float]) -> list[Sea]:
    """Return the seas of the frames between two keys."""
    entry = {"parameter": f"sea.{name}", "time_s": [TIMES[0], TIMES[-1]], "value": values}
    scene = scene_with(folder, None, sea=sea, keys=[entry])
    return [scene_at(scene, float(t)).sea for t in TIMES]


def largest_changes(every: list[Sea]) -> np.ndarray:
    """Return the largest change of height [m] and slope from one frame to the next."""
    surfaces = [sea.grid_surface(24, float(t)) for sea, t in zip(every, TIMES, strict=True)]
    height = np.array([surface.position[..., 1] for surface in surfaces])
    slope = np.array([surface.normal[..., ::2] / surface.normal[..., 1:2] for surface in surfaces])
    return np.array([np.abs(np.diff(height, axis=0)).max(), np.abs(np.diff(slope, axis=0)).max()])


@pytest.mark.parametrize("name", ["wind_speed", "wind_direction_deg"])
@pytest.mark.parametrize(
    "sea",
    [
        {"model": "gerstner", "tile_m": 30.0},
        {"model": "gerstner", "loop_s": 8.0, "detail_kind": "ripples"},
        {"model": "spectral", "tile_m": 30.0, "resolution": 64},
        {"model": "spectral", "spectrum": "phillips", "resolution": 64},
    ],
    ids=lambda sea: f"{sea['model']} {len(sea)}",
)
def test_no_wave_jumps(tmp_path: Path, sea: dict[str, Any], name: str) -> None:
    values = [2.0, 6.0] if name == "wind_speed" else [340.0, 70.0]
    keyed = seas(tmp_path, sea, name, values)
    ends = [largest_changes([end] * len(TIMES)) for end in (keyed[0], keyed[-1])]
    assert np.all(largest_changes(keyed) < NEAR * np.max(ends, axis=0))


@pytest.mark.parametrize(("name", "values"), [("wind_speed", [2.0, 6.0]), ("wind_direction_deg", [340.0, 70.0])])
def test_without_kept_waves_they_would_jump(tmp_path: Path, name: str, values: list[float]) -> None:
    """The measure above tells the two apart."""
    keyed = seas(tmp_path, {"tile_m": 30.0}, name, values)
    anew = [sea.model_copy(update={"waves_of_wind_speed": None, "waves_of_wind_deg": None}) for sea in keyed]
    assert np.all(largest_changes(anew) > 1.5 * largest_changes(keyed))


def test_the_waves_of_a_keyed_sea_stay_and_their_slope_is_the_winds(tmp_path: Path) -> None:
    """Slope variance as in an unkeyed sea of the same wind, wave vectors as in that of the strongest wind."""
    keyed = seas(tmp_path, {"tile_m": 30.0, "wave_count": 48}, "wind_speed", [2.0, 6.0])
    strongest = keyed[-1].model_copy(update={"waves_of_wind_speed": None})
    for sea in keyed[::6]:
        alone = sea.model_copy(update={"waves_of_wind_speed": None})
        assert isinstance(sea, GerstnerSea)
        assert isinstance(alone, GerstnerSea)
        np.testing.assert_array_equal(sea.waves.wave_vector, strongest.waves.wave_vector)
        np.testing.assert_array_equal(sea.waves.phase_rad, strongest.waves.phase_rad)
        assert slope_variance(sea) == pytest.approx(slope_variance(alone), rel=1e-12)
    np.testing.assert_array_equal(keyed[-1].waves.amplitude_m, strongest.waves.amplitude_m)


def slope_variance(sea: GerstnerSea) -> float:
    waves = sea.waves
    return float(np.sum((waves.amplitude_m * np.linalg.norm(waves.wave_vector, axis=1)) ** 2) / 2.0)


@pytest.mark.parametrize("model", ["gerstner", "spectral"])
@pytest.mark.parametrize(("name", "values"), [("wind_speed", [2.0, 6.0]), ("wind_direction_deg", [340.0, 70.0])])
def test_the_mean_square_slope_is_that_of_cox_and_munk(
    tmp_path: Path, model: str, name: str, values: list[float]
) -> None:
    for sea in seas(tmp_path, {"model": model}, name, values)[::8]:
        whole = sea.own_mean_square_slope + sea.detail_rms_slope**2
        assert whole == pytest.approx(mean_square_slope(sea.wind_speed), rel=1e-12)
        assert 0.2 < sea.own_mean_square_slope / whole < 1.0


def test_waves_head_where_the_wind_blows_at_each_time(tmp_path: Path) -> None:
    """Mean direction of the slope variance. About 300 of the waves count: to three standard errors, 12 degrees."""
    for sea in seas(tmp_path, {"wave_count": 512, "tile_m": 30.0}, "wind_direction_deg", [0.0, 120.0])[::8]:
        assert isinstance(sea, GerstnerSea)
        waves = sea.waves
        variance = (waves.amplitude_m * np.linalg.norm(waves.wave_vector, axis=1)) ** 2
        mean = variance @ (waves.wave_vector / np.linalg.norm(waves.wave_vector, axis=1)[:, None])
        azimuth = np.degrees(np.arctan2(mean[0], -mean[1]))
        assert azimuth == pytest.approx(sea.wind_direction_deg, abs=12.0)
        # the length of the mean of directions with a standard deviation of 55 degrees is exp(-sigma^2/2) = 0.63
        assert np.linalg.norm(mean) / variance.sum() == pytest.approx(0.63, abs=0.1)


def test_waves_longer_than_the_wind_makes_fade_over_an_octave() -> None:
    wavelength = np.array([8.0, 4.0, np.sqrt(8.0), 2.0, 1.0, 0.5, 0.25, 0.2, 0.15, 0.1])
    np.testing.assert_allclose(share_of_lengths(wavelength, 2.0), [0, 0, 0.25, *[1] * 7], atol=1e-15)
    # the six shortest stay
    np.testing.assert_allclose(share_of_lengths(wavelength, 0.1)[2:5], [0.0, 0.0, 1.0], atol=1e-15)


def test_weighted_directions_have_the_density_of_the_present_wind() -> None:
    """Moments of 200 000 weighted directions, to four standard errors of about 0.003."""
    random, spread, turn, present = np.random.default_rng(1), 0.8, 1.5, 0.4
    angle = spread * random.standard_normal(200_000) + turn * random.uniform(size=200_000)
    weight = share_of_directions(angle, present, turn, spread)
    mean = np.average(angle - present, weights=weight)
    assert mean == pytest.approx(0.0, abs=0.012)
    assert np.average((angle - present) ** 2, weights=weight) == pytest.approx(spread**2, abs=0.012)


def test_a_wind_that_turns_too_far_for_its_waves_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"keys\[0\].*turns too far .*got 120 degrees.*sea.spread_deg to 40.*spectral"):
        seas(tmp_path, {"spread_deg": 30.0}, "wind_direction_deg", [10.0, 130.0])
    assert seas(tmp_path, {"model": "spectral"}, "wind_direction_deg", [10.0, 130.0])
