# SPDX-License-Identifier: Apache-2.0
"""Legal scenes at the ends of their ranges render; those that cannot are refused by name before the first frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.caustics.irradiance import pass_indices
from mr360uw.errors import ParameterError
from mr360uw.medium.phase import PhaseTable
from mr360uw.medium.veil_gain import picture_change, steady_gain
from tests.scenes import BACKENDS, gradient_plate, scene_with

SIZE = (64, 32)
QUICK: dict[str, Any] = {
    "caustics": {"size": 64, "grid": 32},
    "draw": {"samples": 1, "sun_samples": 1, "ambient_occlusion": False},
    "shafts": {"mode": "off"},
}


@pytest.mark.parametrize("water", [{"bands": 2, "sensor": "CIE 1931"}, {"refractive_index": 1.01}])
def test_waters_at_the_ends_of_their_ranges_render(tmp_path: Path, whale: Path, water: dict[str, Any]) -> None:
    scene = scene_with(tmp_path, whale, **QUICK, water=water)
    image = uw.render_frame(gradient_plate(*SIZE), scene, backend="reference").image_linear
    assert np.all(np.isfinite(image))
    assert image.min() >= 0.0


@pytest.mark.parametrize("mode", ["kd", "rgb", "table", "plate"])
def test_water_too_deep_and_murky_for_any_light_is_dark(mode: str) -> None:
    water = uw.medium.Water.from_arrays([400.0, 700.0], [1.0, 1.0], [40.0, 40.0], diffuse_attenuation=[36.0, 36.0])
    table = uw.medium.Medium(water, mode=mode, camera_depth_m=33.0, band_count=3).unit_table
    assert np.all(np.isfinite(table.veil))
    assert table.veil.max() < 1e-30


@pytest.mark.parametrize("mode", ["kd", "rgb"])
def test_such_water_over_a_bright_plate_is_finite(mode: str) -> None:
    """The gain that gives its darkness the plate's light makes what is above it brighter than numbers go."""
    water = uw.medium.Water.from_arrays([400.0, 700.0], [2.0, 2.0], [0.1, 0.1], diffuse_attenuation=[3.2, 3.2])
    medium = uw.medium.Medium(water, mode=mode, camera_depth_m=145.0, band_count=3)
    gain, _ = uw.medium.fit_gain(medium, np.full((32, 64, 3), 0.5))
    veil = medium.scaled(gain).table.veil
    assert np.all(np.isfinite(veil))
    assert veil.max() > 1.0


def test_a_veil_that_is_brighter_near_by_is_finite() -> None:
    """Blue of yellow water for the CIE observer, in the model of image formation with two attenuations."""
    sensor = uw.medium.Sensor.cie1931()
    medium = uw.medium.Medium(
        uw.medium.Water.jerlov("7C"), sensor, mode="akkaynak-treibitz", camera_depth_m=3.2, refractive_index=1.577
    )
    assert np.all(np.isfinite(medium.table.veil))


def test_backward_scattering_is_finite_however_long_the_way() -> None:
    water = uw.medium.Water.from_arrays([400.0, 700.0], [0.03, 0.5], [30.0, 17.0], phase=("hg", -0.946))
    table = uw.medium.Medium(water, mode="table", camera_depth_m=19.9, band_count=3).unit_table
    assert np.all(np.isfinite(table.veil))


def steep_table(slope: float, first_deg: float) -> PhaseTable:
    angle = np.geomspace(first_deg, 180.0, 50)
    return PhaseTable.from_angles(angle, angle**slope)


@pytest.mark.parametrize("phase", [("hg", 0.99), steep_table(-2.5, 1.0)])
@pytest.mark.parametrize("index", [1.000001, 1.01, 1.1, 1.34, 2.0])
@pytest.mark.parametrize("absorption", [0.08, 1e-4])
def test_steep_phase_functions_are_solved_at_any_index(phase: Any, index: float, absorption: float) -> None:
    field = uw.medium.LightField([absorption], [1.06], phase=phase, refractive_index=index)
    added = field.inscatter(3.0, 5.0, np.linspace(-1.0, 1.0, 9))
    assert np.all(np.isfinite(added))
    assert added.min() >= 0.0


def test_colours_of_a_surface_that_hardly_bends_light_are_bent_as_little() -> None:
    """Dispersion goes with the index less 1: at 1.000001 red is not bent the other way."""
    red, green, blue = pass_indices(3, 1.000001)
    assert 1.0 < red < green < blue
    assert green == pytest.approx(1.000001, abs=1e-12)


def test_a_surface_that_hardly_bends_light_is_as_none() -> None:
    """An index of 1.000001 and a surface without one: the same light to 1e-4, which is far above their difference."""
    up = np.linspace(-1.0, 1.0, 9)
    flat = uw.medium.LightField([0.08], [1.06], phase="petzold", refractive_index=1.000001).inscatter(3.0, 5.0, up)
    none = uw.medium.LightField([0.08], [1.06], phase="petzold", surface="none").inscatter(3.0, 5.0, up)
    np.testing.assert_allclose(flat, none, rtol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_camera_that_sinks_close_to_the_floor_renders(tmp_path: Path, whale: Path, backend: str) -> None:
    camera = {"depth_m": 5.0, "depth_keys": [[0.0, 5.0], [1.0, 6.9]]}
    scene = scene_with(tmp_path, whale, **QUICK, camera=camera, receiver={"height_m": -2.0})
    image = uw.render_frame(gradient_plate(*SIZE), scene, time_s=1.0, backend=backend).image_linear
    assert np.all(np.isfinite(image))


def test_a_camera_below_the_floor_is_refused_by_its_key(tmp_path: Path, whale: Path) -> None:
    camera = {"depth_m": 5.0, "depth_keys": [[0.0, 5.0], [12.0, 9.0]]}
    scene = scene_with(tmp_path, whale, camera=camera, receiver={"height_m": -2.0})
    with pytest.raises(ParameterError, match=r"camera\.depth_keys - goes below the floor at 12 s .*below -4\.00"):
        uw.render_frame(gradient_plate(*SIZE), scene, backend="reference")


def test_the_same_below_a_floor_that_sinks_too_is_legal(tmp_path: Path, whale: Path) -> None:
    keys = [{"parameter": "receiver.height_m", "time_s": [0.0, 1.0], "value": [-2.0, -6.0]}]
    camera = {"depth_m": 5.0, "depth_keys": [[0.0, 5.0], [1.0, 9.0]]}
    scene = scene_with(tmp_path, whale, **QUICK, camera=camera, receiver={"height_m": -2.0}, keys=keys)
    image = uw.render_frame(gradient_plate(*SIZE), scene, time_s=1.0, backend="reference").image_linear
    assert np.all(np.isfinite(image))


def test_a_cut_from_black_is_a_cut() -> None:
    black, bright = np.zeros((4, 8, 3)), np.full((4, 8, 3), 0.3)
    gains = np.repeat([1.0, 1.0, 2.0, 2.0], 3).reshape(4, 3)
    picture = [0.0, 0.0, picture_change(black, bright), 0.0]
    np.testing.assert_allclose(steady_gain(gains, np.zeros(4), picture, 25.0), gains)
