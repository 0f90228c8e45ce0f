# SPDX-License-Identifier: Apache-2.0
"""The light of the sample dive: its picture sends down what its floor and its truth are told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mr360uw.caustics import GerstnerSea
from mr360uw.caustics.sea.gerstner import GerstnerWave
from mr360uw.color import luminance
from mr360uw.composite import read_camera_track
from mr360uw.errors import ParameterError
from mr360uw.medium import LightField, Water, bands
from mr360uw.medium.jerlov import JerlovType
from mr360uw.medium.spectral.sensor import named_sensor
from mr360uw.optics import refract_to_water
from mr360uw.sample import sample_dive
from mr360uw.sample.dive_light import SENSOR, SKY_COLOR, SUN_SHARE, DiveLight
from mr360uw.sample.dive_plate import DivePlate
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.sand import sand_albedo
from mr360uw.scene.model import load_scene
from mr360uw.sphere import directions, row_solid_angle
from tests.tolerances import DIVE_FLOOR, DIVE_SAND, DIVE_SUN_SHARE, DIVE_WHITE, FLOAT32_LOOKUP

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


@pytest.mark.parametrize("water", ["IB", "II", "1C", "3C"])
def test_the_floor_gets_all_of_the_solved_light(water: JerlovType) -> None:
    settings = CalmDive(water=water, camera_depth_m=4.0, floor_depth_m=9.0)
    sun_up = float(refract_to_water(settings.sun_in_air)[1])
    of, observed = Water.jerlov(water), bands(61, named_sensor(SENSOR))
    nm = observed.wavelength_nm
    sky, sun = (
        LightField(of.absorption(nm), of.scattering(nm), of.moments(nm, 65), sky=kind)
        for kind in ("uniform", ("sun", sun_up, 1.0))
    )
    expected = (SKY_COLOR * (sky.irradiance(9.0, 1.0) @ observed.lobes)
                + (1.0 - SKY_COLOR) * (sun.irradiance(9.0, 1.0) @ observed.lobes))  # fmt: skip
    plate = DivePlate(settings, 256, 128)
    np.testing.assert_allclose(plate.floor_irradiance, expected, rtol=DIVE_FLOOR)
    # without waves the pattern is 1, and the picture holds albedo, irradiance, water and veil
    straight_down = plate.radiance(0.0)[-1].mean(axis=0)
    light = DiveLight(water, 4.0, sun_up)
    under = np.array(5.0), np.array(-1.0)
    sand = sand_albedo(settings.seed).mean(axis=(0, 1)) / np.pi * expected
    exposure = plate.level_radiance / light.veil(np.array(1e6), np.array(0.0))
    seen = exposure * (light.veil(*under) + light.transmittance(*under) * sand)
    np.testing.assert_allclose(straight_down, seen, rtol=DIVE_SAND)


def test_a_camera_that_swims_sees_what_lies_ahead() -> None:
    settings = replace(DiveSettings(), speed_m_s=2.0)
    at_rest = DivePlate(DiveSettings(), 256, 128)
    moved, still = DivePlate(settings, 256, 128).radiance(8.0), at_rest.radiance(8.0)
    np.testing.assert_array_equal(settings.camera_at(8.0), [0.0, 0.0, -16.0])
    # the sea repeats after 16 m, the sand after 6 m
    np.testing.assert_allclose(moved[:64], still[:64], atol=FLOAT32_LOOKUP)
    assert np.abs(moved[64:] - still[64:]).max() > 100.0 * FLOAT32_LOOKUP
    assert np.abs(DivePlate(settings, 256, 128).radiance(1.0)[:64] - at_rest.radiance(1.0)[:64]).max() > 0.01


def test_a_dive_of_other_water_and_sun_is_its_own_scene(tmp_path: Path) -> None:
    settings = DiveSettings.in_degrees("1C", 5.0, None, 30.0, -90.0, 5.0, 0.5, 3)
    made = sample_dive(tmp_path, settings, width=64, frames=3)
    scene = load_scene(made.scene)
    assert (scene.water.type, scene.camera.depth_m, scene.receiver.height_m) == ("1C", 5.0, -3.5)
    path = read_camera_track(scene.camera.track)
    np.testing.assert_allclose(path.position[:, 2], [0.0, -0.5 / 24.0, -1.0 / 24.0], atol=1e-12)
    truth = json.loads(made.truth.read_text())
    assert np.arcsin(truth["sun_direction_in_water"][1]) == pytest.approx(
        np.radians(scene.water.sun_elevation_deg), abs=1e-4
    )
    for wrong in (("XX", 5.0, None, 30.0), ("IB", 0.0, None, 30.0), ("IB", 5.0, 4.0, 30.0), ("IB", 5.0, None, 1.0)):
        with pytest.raises(ParameterError, match="got"):
            DiveSettings.in_degrees(*wrong, 0.0, 3.0, 0.0, 1)
