# SPDX-License-Identifier: Apache-2.0
"""The light of plate, water and bodies adds up: see `holding`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.cache import drop_shared
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import ambient_ratio
from mr360uw.medium.models import spectral_model
from mr360uw.medium.ray_field import LambertFloor, cosine_kernel
from mr360uw.medium.scattered_light import ambient_parts
from mr360uw.render.surroundings import load_surroundings
from mr360uw.sample.dive import dive_scene, record
from mr360uw.sample.rendered_dive import Dive
from mr360uw.scene import scene_from_dict
from mr360uw.video import open_video
from tests.dives import over_sand
from tests.render.holding import given_sun, held
from tests.tolerances import COLOUR_OF_FLOOR, HELD, HELD_DARK, WATER_ADDS_UP

SUN_UP = 0.8


@pytest.fixture(autouse=True)
def _a_dive_at_a_time() -> Iterator[None]:
    """What is kept of a dive takes a hundred megabytes, and no other test of this file asks for it."""
    yield
    drop_shared()


@pytest.mark.parametrize(
    ("water", "depth_m", "sun_deg", "width"),
    # in clear water under a high sun the glitter of a pixel clips, of small pixels less
    [("IA", 4.0, 80.0, 512), ("IB", 4.0, 80.0, 256), ("II", 4.0, 50.0, 256), ("3C", 12.0, 25.0, 256)],
)
def test_a_card_of_sand_on_the_sand_vanishes(
    tmp_path: Path, water: str, depth_m: float, sun_deg: float, width: int
) -> None:
    settings = over_sand(depth_m=depth_m - 2.0, floor_m=depth_m, water=water, sun_elevation_deg=sun_deg)
    found = held(tmp_path, settings, width=width, frames=4)
    assert np.all(found.error() <= np.where(found.rounding > 0.1, HELD_DARK, HELD)), found


@pytest.mark.parametrize(
    ("water", "camera_m", "sun_deg"),
    [("IA", 14.0, 25.0), ("II", 2.0, 25.0), ("1C", 6.0, 80.0)],
)
def test_the_light_read_from_a_dive_is_its_own(tmp_path: Path, water: str, camera_m: float, sun_deg: float) -> None:
    """Ambient light and beam, from 8-bit video; low suns and deep clear water have the most glare in the sky."""
    settings = over_sand(depth_m=camera_m, floor_m=camera_m + 2.0, water=water, sun_elevation_deg=sun_deg)
    plate = Dive(settings, 512, 256)
    record(tmp_path / "dive.mp4", [plate.radiance(0.0)], Fraction(24), settings.seed)
    light = {"light": given_sun(settings), "object": []}
    reader = load_surroundings(scene_from_dict(dive_scene(plate) | light, tmp_path)).light
    with open_video(tmp_path / "dive.mp4") as video:
        found = reader.of(next(iter(video.frames())).pixels)
    assert found.sun is not None
    ambient, beam = plate.irradiance(camera_m)
    read = environment_lookup(found.ambient, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(read, plate.exposure * ambient, rtol=HELD)
    np.testing.assert_allclose(found.sun.irradiance, plate.exposure * beam, rtol=HELD)


@pytest.mark.parametrize("floor_m", [None, 7.0])
@pytest.mark.parametrize("water", ["IB", "9C"])
def test_what_leaves_the_beam_becomes_ambient(water: str, floor_m: float | None) -> None:
    """Ambient light and beam that are those of a solved field at the camera are its own at every depth and normal."""
    share, camera, albedo = 0.7, 4.0, 0.3
    medium = Medium(Water.jerlov(water), camera_depth_m=camera, floor_m=floor_m)
    nm, bands = medium.bands.wavelength_nm, medium.bands
    floor = None if floor_m is None else LambertFloor(floor_m, (albedo,))
    field = spectral_model(medium.water, nm, "table", sky=("sun", SUN_UP, share), floor=floor)
    depth, normal = np.array([0.5, 3.0, 4.0, 4.001, 6.0, 12.0]), np.array([-1.0, -0.5, 0.0, 0.5, 1.0])

    def ambient(depth_m: np.ndarray, normal_up: np.ndarray) -> np.ndarray:
        beam = field.level_beam * np.exp(-field.extinction / SUN_UP * np.minimum(depth_m, floor_m or np.inf)[..., None])
        facing = cosine_kernel(np.array(SUN_UP), normal_up)[..., None] / (2.0 * np.pi * SUN_UP)
        return bands.rgb(field.irradiance(depth_m, normal_up) - beam * facing)

    whole = np.array([1.0, 2.0, 3.0])
    at = np.array(camera)
    down, up = (whole * ambient(at, np.array(n)) for n in (1.0, -1.0))
    sun = whole * bands.rgb(field.level_beam * np.exp(-field.extinction * camera / SUN_UP)) / SUN_UP
    diffuse, shining = ambient_parts(medium, down, up, sun, SUN_UP)
    table = replace(medium.table, diffuse=diffuse)
    tolerance = WATER_ADDS_UP if floor_m is None else COLOUR_OF_FLOOR
    for height in normal:
        expected = ambient(depth, np.full(len(depth), height)) / ambient(at, np.array(height))
        np.testing.assert_allclose(ambient_ratio(table, depth, height), expected, rtol=tolerance)
    if floor_m is None:
        np.testing.assert_array_equal(shining, 0.0)
    else:
        lit = albedo / np.pi * bands.rgb(field.irradiance(np.array(floor_m), 1.0))
        np.testing.assert_allclose(shining, whole * lit, rtol=tolerance)
    # without a sun all light is ambient
    deep = Medium(Water.jerlov(water), camera_depth_m=camera)
    alone, _ = ambient_parts(deep, whole, 0.1 * whole, np.zeros(3), SUN_UP)
    plain = Medium(Water.jerlov(water), camera_depth_m=camera).table.diffuse
    np.testing.assert_allclose(alone, plain, rtol=WATER_ADDS_UP)
