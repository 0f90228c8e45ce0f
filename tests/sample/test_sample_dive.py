# SPDX-License-Identifier: Apache-2.0
"""The light of the sample dive: its picture sends down what its floor and its truth are told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.color import luminance
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import fresnel_from_below, refract_to_water
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.caustics import GerstnerSea
from mr360uw.caustics.gerstner import GerstnerWave
from mr360uw.composite import read_camera_track
from mr360uw.errors import ParameterError
from mr360uw.medium import LightField, Water, bands
from mr360uw.medium.ray_field import LambertFloor
from mr360uw.medium.spectra import named_sensor
from mr360uw.medium.water import JerlovType
from mr360uw.sample import sample_dive
from mr360uw.sample.dive import with_noise
from mr360uw.sample.dive_settings import PRESETS, DiveSettings
from mr360uw.sample.rendered_dive import SENSOR, Dive, dive_sky, relief_shade, sea_bed
from mr360uw.scene.model import load_scene
from mr360uw.surface.sky import Dome, sun_below
from mr360uw.video import open_video, write_exr
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
    assert share == pytest.approx(calm.sun_share, abs=DIVE_SUN_SHARE)


def test_sun_and_sky_together_are_white(flux: np.ndarray) -> None:
    down = flux.sum(axis=(0, 1))
    np.testing.assert_allclose(down / luminance(down), 1.0, atol=DIVE_WHITE)


def _entered(field: LightField) -> np.ndarray:
    """Return the fraction (n,) of the irradiance just below the surface that comes from the air."""
    critical = np.sqrt(1.0 - 1.0 / REFRACTIVE_INDEX_SEA**2)
    node, weight = np.polynomial.legendre.leggauss(24)
    back = 0.0
    for low, high in ((0.0, critical), (critical, 1.0)):
        mu, w = low + 0.5 * (high - low) * (node + 1.0), 0.5 * (high - low) * weight
        back = back + (2.0 * np.pi * w * mu * fresnel_from_below(mu, REFRACTIVE_INDEX_SEA)) @ field.radiance(0.0, -mu)
    return np.asarray(1.0 - back)


@pytest.mark.parametrize("water", ["IB", "II", "1C", "3C"])
def test_the_floor_gets_all_of_the_solved_light(water: JerlovType) -> None:
    settings = CalmDive(**LEVEL_SAND, water=water, depth_m=4.0, floor_m=9.0)
    sun_up = float(refract_to_water(settings.sun_in_air)[1])
    of, observed = Water.jerlov(water), bands(61, named_sensor(SENSOR))
    nm = observed.wavelength_nm
    plate, expected = Dive(settings, 128, 64), np.zeros(3)
    albedo, camera = plate.scene.floor.mean_albedo, plate.water.seen_from(4.0)
    for kind, below in (("uniform", plate.sky_below), (("sun", sun_up, 1.0), plate.sun_below)):
        black, *of_channels = (
            LightField(of.absorption(nm), of.scattering(nm), of.moments(nm, 65), sky=kind,
                       floor=LambertFloor(9.0, (float(a),)))
            for a in (0.0, *albedo)
        )  # fmt: skip
        for channel, grey in enumerate(of_channels):
            # fields are per unit of light below the surface, of which it has sent back more over a grey floor
            lit = grey.irradiance(9.0, 1.0) * _entered(black) / _entered(grey)
            expected[channel] += below[channel] * (lit @ observed.lobes)[channel]
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


def test_presets_differ_and_can_be_dived() -> None:
    settings = [DiveSettings.of(name) for name in PRESETS]
    assert len({(s.water, s.sky, s.depth_m) for s in settings}) == len(PRESETS)
    assert DiveSettings.of("reef", rocks=0.5, wind_m_s=None).rocks == 0.5
    assert DiveSettings.of("reef").wind_m_s == PRESETS["reef"]["wind_m_s"]


def test_a_turning_camera_swims_where_it_looks() -> None:
    settings = DiveSettings(speed_m_s=2.0, yaw_deg_s=30.0, bob_m=0.2)
    step = 1e-5
    (before, _), (here, rotation), (after, _) = (settings.camera_at(1.0 + k * step) for k in (-1, 0, 1))
    velocity = (after - before) / (2.0 * step)
    np.testing.assert_allclose(velocity[[0, 2]], 2.0 * (rotation @ [0.0, 0.0, -1.0])[[0, 2]], atol=1e-6)
    assert abs(here[1]) <= 0.2


@pytest.mark.parametrize("elevation_deg", [5.0, 30.0, 70.0])
def test_a_clear_sky_and_its_sun_bring_daylight(elevation_deg: float) -> None:
    dome, sun = dive_sky(DiveSettings(sun_elevation_deg=elevation_deg))
    below = Dome(dome).irradiance_below(REFRACTIVE_INDEX_SEA)
    assert luminance(below + sun_below(sun, REFRACTIVE_INDEX_SEA)) == pytest.approx(1.0, abs=DIVE_WHITE)
    assert sun is not None
    assert np.all(np.diff(sun.irradiance / below) < 0.0)  # the sun is redder than its sky


def test_the_sun_of_a_picture_of_the_sky_is_found(tmp_path: Path) -> None:
    toward = direction_from_angles(np.radians(40.0), np.radians(35.0))
    view = directions(256, 128)
    image = np.full((128, 256, 3), 0.2, np.float32) * [0.7, 1.0, 1.4]
    image[np.arccos(np.clip(view @ toward, -1.0, 1.0)) < 0.025] += 3000.0
    write_exr(tmp_path / "sky.exr", image.astype(np.float32))
    dome, sun = dive_sky(DiveSettings(sky_map=tmp_path / "sky.exr"))
    assert sun is not None
    assert sun.direction @ toward > np.cos(0.01)
    below = Dome(dome).irradiance_below(REFRACTIVE_INDEX_SEA) + sun_below(sun, REFRACTIVE_INDEX_SEA)
    np.testing.assert_allclose(luminance(below), 1.0, atol=FLOAT64)
    np.testing.assert_allclose(dome / dome[0, 0], 1.0, rtol=1e-5)  # float32; the sun has left it


def test_relief_shades_and_keeps_level_ground() -> None:
    sun, beam = np.array([0.6, 0.8, 0.0]), np.full(3, 0.7)
    np.testing.assert_allclose(relief_shade(np.zeros((16, 16)), 12.0, sun, beam), 1.0, atol=1e-6)  # float32
    wall = np.zeros((64, 64))
    wall[:, 32:36] = 1.0
    shade = relief_shade(wall, 12.0, sun, beam)[32, :, 1]
    assert shade[31] < 0.7 * 0.3 + 0.3  # in its shadow, towards -x
    assert shade[42] > shade[31]
    np.testing.assert_allclose(shade[16], 1.0, atol=0.1)


def test_rocks_of_a_solid_floor_stand_out_of_it() -> None:
    """Where a level floor is met elsewhere, rays meet rocks before it; sand, nearly level, is as bright on average."""
    options: dict[str, Any] = {"sky": "overcast", "rocks": 0.2, "grass": 0.0, "floor_m": 6.0}
    solid, shaded = (Dive(DiveSettings(**options, solid=kind), 128, 64).picture(0.0) for kind in (True, False))
    below = np.broadcast_to(directions(128, 64)[..., 1] < -0.2, shaded.floor.shape)
    rise = (shaded.distance_m - solid.distance_m)[below] / shaded.distance_m[below]
    np.testing.assert_allclose(shaded.distance_m[below] * -directions(128, 64)[..., 1][below], 2.0)
    assert 0.2 < rise.max() < 0.8  # a boulder, between floor and camera
    assert 0.05 < np.mean(rise > 0.05) < 0.45  # a fifth of the floor, seen from aside
    bright = np.median(luminance(solid.radiance[below])) / np.median(luminance(shaded.radiance[below]))
    assert bright == pytest.approx(1.0, abs=0.1)


def test_boulders_cover_the_fraction_that_is_asked_for() -> None:
    bare = sea_bed(DiveSettings(rocks=0.0, grass=0.0))
    for fraction in (0.02, 0.3):
        rocky = sea_bed(DiveSettings(rocks=fraction, grass=0.0))
        covered = np.abs(rocky[1] - bare[1]).max(axis=-1) > 0.05
        assert covered.mean() == pytest.approx(fraction, rel=0.1)  # of edges that are soft
        assert np.mean(rocky[0][covered]) > np.mean(rocky[0][~covered]) + 0.1


def test_noise_is_that_of_photons_and_reading() -> None:
    even = np.full((128, 256, 3), 0.2, np.float32)
    noisy = with_noise(even, 4.0, 3, 5)
    np.testing.assert_array_equal(noisy, with_noise(even, 4.0, 3, 5))
    expected = np.sqrt(4.0 * (0.2 / 6000.0 + (3.0 / 6000.0) ** 2))
    np.testing.assert_allclose((noisy - even).std(), expected, rtol=0.02)  # of 1e5 numbers: 0.2 %
    assert with_noise(even, 0.0, 3, 5) is even


def test_the_truth_of_every_frame(tmp_path: Path) -> None:
    settings = DiveSettings(sky="overcast", bits=10, transfer="bt709", noise=1.0, yaw_deg_s=20.0, relief=0.0)
    made = sample_dive(tmp_path, settings, width=64, frames=2, truth=True)
    truth = json.loads(made.truth.read_text())
    assert truth["sun_direction_in_water"] is None
    dive = Dive(settings, 64, 32)
    with open_video(made.plate, transfer="bt709") as video, np.load(tmp_path / "truth" / "00001.npz") as maps:
        frame = list(video.frames())[1]
        assert frame.spec.bits == 10
        assert maps["floor"][20:].all()
        seen = maps["radiance"].astype(np.float64)
        np.testing.assert_allclose(seen, dive.radiance(truth["frames"][1]["time_s"]), rtol=1e-3, atol=1e-5)  # half
        np.testing.assert_allclose(
            luminance(frame.image_linear[20:].mean(axis=(0, 1))), luminance(seen[20:].mean(axis=(0, 1))), rtol=0.02
        )  # of a codec that is lossy
        np.testing.assert_allclose(maps["distance_m"][-1], 3.5, rtol=0.01)
    scene = load_scene(made.scene)
    assert (scene.plate.transfer, scene.light.sun) == ("bt709", "none")
