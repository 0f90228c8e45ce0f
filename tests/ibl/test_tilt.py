# SPDX-License-Identifier: Apache-2.0
"""Plates that are not level give the light of level ones where the tilt is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.sphere import direction_from_angles, directions, frame_from_direction
from mr360uw.errors import ParameterError
from mr360uw.ibl.lighting import assemble, light_between, turned
from mr360uw.ibl.lookup import reduce_map
from mr360uw.ibl.plate import remap
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.tilt import frame_sines, level_matrix, upward
from mr360uw.render.lights import plate_map
from mr360uw.render.surroundings import load_surroundings
from mr360uw.sample import Dive, DiveSettings
from mr360uw.types import Environment, Sun
from tests.ibl.plates import angle_deg, planes, sky
from tests.ibl.tolerances import FLOAT64, SUN_CLIPPED_DEG, SUN_HDR_DEG, TILT_LIGHT, TILT_MAP
from tests.scenes import scene_with

ROLL_RAD, PITCH_RAD = -0.7, 0.1
TILT = level_matrix(ROLL_RAD, PITCH_RAD)


def tilted(image: np.ndarray, world_from_camera: np.ndarray) -> np.ndarray:
    """Return what a camera that is turned sees of an equirectangular world (H, W, 3)."""
    height, width = image.shape[:2]
    return remap(image, *frame_from_direction(directions(width, height) @ world_from_camera.T, width, height))


@pytest.fixture(scope="module")
def dive() -> np.ndarray:
    """One frame of a synthetic dive before it clips, (384, 768, 3); its sun stands 67 degrees high in the water.

    Ripples make the sun a patch of some pixels: one of a single pixel does not stay the same when the frame is turned.
    """
    settings = DiveSettings(detail_slope=0.05, relief=0.0, rocks=0.0, grass=0.0)
    return np.maximum(Dive(settings, 768, 384).radiance(0.3), 0.0).astype(np.float32)


def off(got: Environment, truth: Environment) -> float:
    """Return the largest error of irradiance and ambient light, as a share of their peaks."""
    pairs = ((got.irradiance, truth.irradiance), (got.ambient, truth.ambient))
    return max(float(np.abs(a - b).max() / b.max()) for a, b in pairs)


@pytest.mark.parametrize("source", ["linear", "planes"])
@pytest.mark.parametrize(
    ("operator", "region"), [("closure", "upper"), ("mr360", "upper"), ("landis", "snell"), ("none", "all")]
)
def test_a_tilted_dive_has_the_light_of_a_level_one(dive: np.ndarray, operator: str, region: str, source: str) -> None:
    chosen = LightSettings(operator=operator, region=region)

    def light(image: np.ndarray, up: np.ndarray | None) -> Environment:
        plate = np.minimum(image, 1.0)
        if source == "planes":
            return ibl.environment_from_yuv(planes(plate), chosen, underwater=True, up=up)
        return ibl.environment(plate, chosen, underwater=True, up=up)

    level, seen = light(dive, None), tilted(dive, TILT)
    got, ignored = turned(light(seen, TILT[1]), TILT), turned(light(seen, None), TILT)
    assert level.sun is not None
    assert got.sun is not None
    assert angle_deg(got.sun.direction, level.sun.direction) < SUN_CLIPPED_DEG
    assert off(got, level) < TILT_LIGHT
    assert off(ignored, level) > 2.0 * TILT_LIGHT  # the sun lies outside of the window that a level camera would have


def test_detail_is_turned_and_interpolated_as_the_map_is_that_is_its_mean() -> None:
    one, other = (assemble((1.0 + k * directions(256, 128)).astype(np.float32), None) for k in (0.1, 0.5))
    for light in (turned(one, TILT), light_between(one, other, 0.25, None)):
        assert light.detail is not None
        np.testing.assert_allclose(reduce_map(light.detail, 64, 32), light.residual, atol=TILT_LIGHT)


@pytest.mark.parametrize("camera", [{"roll_deg": np.degrees(ROLL_RAD), "pitch_deg": np.degrees(PITCH_RAD)}, "keys"])
def test_a_scene_knows_the_tilt_at_every_time(dive: np.ndarray, camera: dict | str, tmp_path: Path) -> None:
    keys = [[0.0, 0.0, 0.0], [2.0, float(np.degrees(ROLL_RAD)), float(np.degrees(PITCH_RAD))]]
    tables = {"tilt_keys": keys} if isinstance(camera, str) else camera
    reader = load_surroundings(scene_with(tmp_path, None, camera=tables)).light
    level = load_surroundings(scene_with(tmp_path, None)).light.of(np.minimum(dive, 1.0))
    found = reader.of(np.minimum(tilted(dive, TILT), 1.0), time_s=2.0)
    rotation = reader.world_from_camera(2.0)
    np.testing.assert_allclose(rotation, TILT, atol=FLOAT64)
    assert off(turned(found, rotation), level) < TILT_LIGHT
    assert level.sun is not None
    measured = ibl.measure_sun(found, 2.0, rotation).sun
    assert measured is not None
    assert angle_deg(measured.direction, level.sun.direction) < SUN_CLIPPED_DEG


@pytest.mark.parametrize("light", [{"sun": "given", "sun_azimuth_deg": 30.0, "sun_elevation_deg": 60.0}, {}])
def test_a_given_sun_stands_in_the_world(dive: np.ndarray, light: dict, tmp_path: Path) -> None:
    place = direction_from_angles(np.radians(30.0), np.radians(60.0))
    camera = {"tilt_keys": [[0.0, 0.0, 0.0], [2.0, float(np.degrees(ROLL_RAD)), float(np.degrees(PITCH_RAD))]]}
    reader = load_surroundings(scene_with(tmp_path, None, camera=camera, light=light)).light
    sun = "scene" if light else Sun(place, np.ones(3), 0.01, 1.0)  # of the scene, or of a track
    for time_s, rotation in ((0.0, np.eye(3)), (2.0, TILT)):
        found = reader.of(np.minimum(dive, 1.0), sun, time_s=time_s).sun
        assert found is not None
        np.testing.assert_allclose(rotation @ found.direction, place, atol=FLOAT64)


def test_the_library_reads_a_given_sun_in_level_axes() -> None:
    chosen = LightSettings(operator="none", sun="given", sun_azimuth_deg=30.0, sun_elevation_deg=60.0)
    sun = ibl.environment(sky(np.array([0.0, 1.0, 0.0])), chosen, up=TILT[1]).sun
    assert sun is not None
    np.testing.assert_allclose(
        TILT @ sun.direction, direction_from_angles(np.radians(30.0), np.radians(60.0)), atol=FLOAT64
    )


def test_detection_follows_the_horizon() -> None:
    below = TILT.T @ direction_from_angles(-1.5, -0.15)  # under the horizon, in the upper half of the frame
    above = TILT.T @ direction_from_angles(1.6, 0.3)
    assert below[1] > 0.0 > above[1]
    assert ibl.detect_sun(sky(below)) is not None
    assert ibl.detect_sun(sky(below), up=TILT[1]) is None
    sun = ibl.detect_sun(sky(above), up=TILT[1])
    assert sun is not None
    assert angle_deg(sun.direction, above) < SUN_HDR_DEG
    assert ibl.detect_sun(sky(above), underwater=True, up=TILT[1]) is None


@pytest.mark.parametrize("source", ["linear", "planes"])
def test_the_water_is_read_from_a_levelled_map(dive: np.ndarray, source: str) -> None:
    level, seen = np.minimum(dive, 1.0), np.minimum(tilted(dive, TILT), 1.0)
    a, b = (planes(p) if source == "planes" else p for p in (level, seen))
    truth = plate_map(a)
    assert np.mean(np.abs(plate_map(b, TILT[1]) - truth)) < TILT_MAP * truth.mean()
    assert np.mean(np.abs(plate_map(b) - truth)) > 4.0 * TILT_MAP * truth.mean()


def test_as_good_as_level_is_level() -> None:
    nearly = upward([1e-12, 1.0, 0.0])
    np.testing.assert_array_equal(nearly, [0.0, 1.0, 0.0])
    assert frame_sines(8, 4, nearly).shape == (4, 1)
    np.testing.assert_allclose(frame_sines(8, 4, TILT[1]), directions(8, 4) @ TILT[1], atol=FLOAT64)
    np.testing.assert_array_equal(upward([0.0, -2.0, 0.0]), [0.0, -1.0, 0.0])
    for wrong in ([0.0, 0.0, 0.0], [1.0, 2.0], np.eye(3)):
        with pytest.raises(ParameterError):
            ibl.detect_sun(sky(np.array([0.0, 1.0, 0.0]), width=64), up=wrong)
