# SPDX-License-Identifier: Apache-2.0
"""The light of the sample dive: its picture sends down what its floor and its truth are told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.caustics import GerstnerSea
from mr360uw.caustics.sea.gerstner import GerstnerWave
from mr360uw.color import luminance
from mr360uw.composite import read_camera_track
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.medium import LightField, Water, bands
from mr360uw.medium.jerlov import JerlovType
from mr360uw.medium.spectral.sensor import named_sensor
from mr360uw.optics import diffuse_reflectance_from_below, refract_to_water
from mr360uw.sample import sample_dive
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import SENSOR, Dive
from mr360uw.scene.model import load_scene
from mr360uw.sphere import directions, row_solid_angle
from tests.dives import LEVEL_SAND, over_sand
from tests.tolerances import DIVE_FLOOR, DIVE_SAND, DIVE_SUN_SHARE, DIVE_WHITE, FLOAT64

WIDTH, HEIGHT, SAMPLES = 128, 64, 6
GLOW_RAD = 0.1
"""Radius about the sun within which its light falls: its disc, spread by ripples that tilt by 0.02."""


class CalmDive(DiveSettings):
    """A dive in a flat sea, with ripples that spread the sun's image over several samples."""

    @property
    def sea(self) -> GerstnerSea:
        return GerstnerSea(explicit_waves=(GerstnerWave(wave_vector=(1.0, 0.0), amplitude_m=0.0),), detail_slope=0.02)


@pytest.fixture(scope="module")
def calm() -> Dive:
    """A camera just under a flat sea, over a black floor; the sun is ahead."""
    return Dive(
        CalmDive(**LEVEL_SAND, depth_m=0.05, floor_m=100.0, sun_azimuth_deg=0.0), WIDTH, HEIGHT, samples=SAMPLES
    )


@pytest.fixture(scope="module")
def flux(calm: Dive) -> np.ndarray:
    """What pixels (H, W, 3) bring from above."""
    image = calm.picture(0.0).radiance
    return image * np.maximum(directions(WIDTH, HEIGHT)[..., 1:2], 0.0) * row_solid_angle(WIDTH, HEIGHT)[:, None, None]


def test_the_picture_holds_the_suns_share(calm: Dive, flux: np.ndarray) -> None:
    cosine = directions(WIDTH, HEIGHT) @ calm.sun_in_water
    # the sky about the sun is a smooth glow: the ring of twice the radius has three times the area
    disc, ring = (cosine > np.cos(GLOW_RAD)), (cosine <= np.cos(GLOW_RAD)) & (cosine > np.cos(2.0 * GLOW_RAD))
    sun = luminance(flux[disc].sum(axis=0)) - luminance(flux[ring].mean(axis=0)) * np.count_nonzero(disc)
    share = sun / luminance(flux.sum(axis=(0, 1)))
    assert share == pytest.approx(calm.sky.sun_share, abs=DIVE_SUN_SHARE)


def test_sun_and_sky_together_are_white(flux: np.ndarray) -> None:
    down = flux.sum(axis=(0, 1))
    np.testing.assert_allclose(down / luminance(down), 1.0, atol=DIVE_WHITE)


@pytest.mark.parametrize("water", ["IB", "II", "1C", "3C"])
def test_the_floor_gets_all_of_the_solved_light(water: JerlovType) -> None:
    settings = CalmDive(**LEVEL_SAND, water=water, depth_m=4.0, floor_m=9.0)
    sun_up = float(refract_to_water(settings.sun_in_air)[1])
    of, observed = Water.jerlov(water), bands(61, named_sensor(SENSOR))
    nm = observed.wavelength_nm
    sky, sun = (
        LightField(of.absorption(nm), of.scattering(nm), of.moments(nm, 65), sky=kind)
        for kind in ("uniform", ("sun", sun_up, 1.0))
    )
    plate = Dive(settings, 128, 64)
    expected = (plate.sky.sky_below * (sky.irradiance(9.0, 1.0) @ observed.lobes)
                + plate.sky.sun_below * (sun.irradiance(9.0, 1.0) @ observed.lobes))  # fmt: skip
    # what the sand sends up comes back from the surface, again and again
    albedo, camera = plate.scene.floor.mean_albedo, plate.scene.water.seen_from(4.0)
    passed = plate.scene.water.along(np.array([9.0]), np.array([-1.0]), False)[0][0]
    expected /= 1.0 - albedo * diffuse_reflectance_from_below(REFRACTIVE_INDEX_SEA, -2.0 * np.log(passed))
    np.testing.assert_allclose(plate.floor_irradiance, expected, rtol=DIVE_FLOOR)
    # without waves the pattern is 1, and the picture holds albedo, irradiance, water and veil
    straight_down = plate.radiance(0.0)[-1].mean(axis=0)
    transmittance, veil = camera.along(np.array([5.0]), np.array([-1.0]), True)
    seen = plate.exposure * (veil + transmittance * albedo / np.pi * expected)[0]
    np.testing.assert_allclose(straight_down, seen, rtol=DIVE_SAND)


def test_a_camera_that_swims_sees_what_lies_ahead() -> None:
    moving, resting = (Dive(over_sand(speed_m_s=speed), 128, 64) for speed in (2.0, 0.0))
    moved, still = (dive.picture(8.0) for dive in (moving, resting))
    np.testing.assert_array_equal(moving.settings.camera_at(8.0)[0], [0.0, 0.0, -16.0])
    # the sea repeats after 16 m, the floor after 12 m
    np.testing.assert_allclose(moved.distance_m, still.distance_m, rtol=FLOAT64)
    np.testing.assert_allclose(moved.normal, still.normal, atol=FLOAT64)
    assert np.abs(moving.radiance(8.0)[32:] - resting.radiance(8.0)[32:]).max() > 0.01
    assert np.abs(moving.radiance(1.0)[:32] - resting.radiance(1.0)[:32]).max() > 0.01


def test_a_dive_of_other_water_and_sun_is_its_own_scene(tmp_path: Path) -> None:
    settings = DiveSettings(
        water="1C", depth_m=5.0, sun_elevation_deg=30.0, sun_azimuth_deg=-90.0, wind_m_s=5.0, speed_m_s=0.5, seed=3
    )
    made = sample_dive(tmp_path, settings, width=64, frames=3)
    scene = load_scene(made.scene)
    assert (scene.water.type, scene.camera.depth_m, scene.receiver.height_m) == ("1C", 5.0, -3.5)
    path = read_camera_track(scene.camera.track)
    np.testing.assert_allclose(path.position[:, 2], [0.0, -0.5 / 24.0, -1.0 / 24.0], atol=1e-12)
    truth = json.loads(made.truth.read_text())
    assert np.arcsin(truth["sun_direction_in_water"][1]) == pytest.approx(
        np.radians(scene.water.sun_elevation_deg), abs=1e-4
    )


@pytest.mark.parametrize(
    ("wrong", "lines"),
    [
        ({"water": "XX", "sun_elevation_deg": 1.0}, 2),
        ({"depth_m": 0.0}, 1),
        ({"floor_m": 4.0, "depth_m": 5.0}, 1),
        ({"preset": "reff", "noise": -1.0, "rocks": 2.0}, 3),
        ({"bob_m": 1.5, "depth_m": 1.0}, 1),
        ({"depths_m": 1.0}, 1),
    ],
)
def test_every_wrong_parameter_has_its_line(wrong: dict[str, Any], lines: int) -> None:
    with pytest.raises(ParameterError, match="got") as caught:
        DiveSettings.of(**wrong)
    assert len(str(caught.value).splitlines()) == lines
