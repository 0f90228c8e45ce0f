# SPDX-License-Identifier: Apache-2.0
"""Pictures from above: geometry, water and reflections in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

import mr360uw as uw
from mr360uw.base.optics import fresnel, reflect, refract_to_water
from mr360uw.base.sphere import direction_from_angles, directions, unit
from mr360uw.caustics import caustic_map
from mr360uw.errors import ParameterError
from mr360uw.from_above import AerialScene, LoadedAerial
from mr360uw.from_above.aerial_picture import blend_of
from mr360uw.published import blended_albedo, thresholded_reflection
from mr360uw.surface.sky import CLEAR, OVERCAST, standard_sky, sun_below
from tests.from_above import tolerances as tol

N = 1.34
LEVEL: dict[str, Any] = {"wind_speed": 0.0, "resolution": 16, "detail_slope": 0.0}
WAVES: dict[str, Any] = {"wind_speed": 3.0, "resolution": 16, "tile_m": 8.0, "shortest_wavelength_m": 2.0}


def scene_of(**tables: dict[str, Any]) -> AerialScene:
    """Return a scene of small pictures over a level sea, in clear water, over even ground."""
    plain: dict[str, dict[str, Any]] = {
        "camera": {"width": 24, "height": 12, "exposure": 1.0}, "sea": LEVEL, "caustics": {"size": 64, "grid": 32},
        "water": {"type": "none"}, "floor": {"ground": "even"}, "film": {"samples": 1},
    }  # fmt: skip
    return AerialScene.model_validate(plain | {name: plain.get(name, {}) | table for name, table in tables.items()})


@pytest.fixture
def half_white(tmp_path: Path) -> str:
    """A picture of ground whose left half is bright."""
    codes = np.zeros((256, 256, 3), np.uint8)
    codes[:, :128] = 230
    cv2.imwrite(str(tmp_path / "ground.png"), codes)
    return str(tmp_path / "ground.png")


def edges_of(row: np.ndarray) -> np.ndarray:
    """Return the places, in pixels, where a row crosses the middle between its least and its greatest value."""
    middle = row - 0.5 * (row.min() + row.max())
    at = np.flatnonzero(middle[:-1] * middle[1:] < 0.0)
    return np.asarray(at + 0.5 + middle[at] / (middle[at] - middle[at + 1]))


def test_orthographic_pictures_have_the_scale_they_state(half_white: str) -> None:
    camera = {"projection": "orthographic", "pitch_deg": -90.0, "width_m": 8.0, "width": 1024, "height": 3}
    floor = {"ground": "picture", "picture": half_white, "tile_m": 2.0, "depth_m": 3.0}
    seen = uw.aerial(scene_of(camera=camera, floor=floor))
    x = (edges_of(seen.floor_radiance[1, :, 1]) / 1024.0 - 0.5) * 8.0
    np.testing.assert_allclose(x, np.round(x), atol=8.0 / 1024.0)
    assert len(x) == 7
    np.testing.assert_allclose(seen.in_water_m, 3.0, atol=tol.START_M)
    np.testing.assert_allclose(seen.distance_m, 12.0, atol=tol.START_M)


def test_the_floor_looks_nearer_than_it_is(half_white: str) -> None:
    depth, high, half = 3.0, 10.0, np.tan(np.radians(15.0))
    camera = {"position_m": (0.0, high, 0.0), "pitch_deg": -90.0, "fov_deg": 30.0, "width": 1024, "height": 1}
    floor = {"ground": "picture", "picture": half_white, "tile_m": 2.0, "depth_m": depth}
    row = uw.aerial(scene_of(camera=camera, floor=floor)).floor_radiance[0, :, 1]
    tangent = np.abs((2.0 * edges_of(row) / 1024.0 - 1.0) * half)
    tangent = tangent[tangent > 0.1]
    assert len(tangent) >= 4
    sine = tangent / np.hypot(1.0, tangent) / N
    wet = sine / np.sqrt(1.0 - sine**2)
    edge = np.round(high * tangent + depth * wet)
    np.testing.assert_allclose((edge - high * tangent) / wet / depth, 1.0, atol=tol.APPARENT_DEPTH)


def test_koschmieders_formula() -> None:
    beta, far = np.array([0.4, 0.1, 0.05]), np.array([0.01, 0.03, 0.06])
    water = {"type": "IB", "mode": "koschmieder", "attenuation_per_m": tuple(beta), "far_radiance": tuple(far)}
    scene = scene_of(water=water, camera={"pitch_deg": -50.0, "width": 24, "height": 12})
    loaded = LoadedAerial.of(scene)
    seen = loaded.picture()
    d = seen.view.directions(np.arange(24) + 0.5, np.arange(12)[:, None] + 0.5)
    below = loaded.sea.dome.irradiance_below(N) + sun_below(loaded.sea.sun, N)
    lost = np.exp(-beta * seen.in_water_m[..., None])
    in_water = seen.floor_radiance * lost + loaded.exposure * below * far * (1.0 - lost)
    passed = (1.0 - fresnel(-d[..., 1], N))[..., None] / N**2
    np.testing.assert_allclose(seen.image_linear, in_water * passed + seen.reflection, rtol=tol.FORMULA)


def test_koschmieders_own_constants() -> None:
    """Without numbers: the water's attenuation c, and the colour of deep water from above."""
    deep = LoadedAerial.of(scene_of(water={"type": "IB", "mode": "koschmieder"}, floor={"depth_m": 900.0}))
    light = deep.sea.light_in_water(900.0).sky
    assert light is not None
    model = light.medium.model
    np.testing.assert_array_equal(
        model.extinction, uw.medium.Water.jerlov("IB").attenuation(np.array([650.0, 550.0, 450.0]))
    )
    solved = LoadedAerial.of(scene_of(water={"type": "IB"}, floor={"depth_m": 900.0}))
    down = {"pitch_deg": -90.0, "fov_deg": 1.0, "width": 2, "height": 1}
    at = [LoadedAerial(scene_of(camera=down), one.sea, 1.0).picture().image_linear for one in (deep, solved)]
    # the sun's light comes up from deep water a little weaker than the sky's, which the formula does not tell apart
    np.testing.assert_allclose(at[0], at[1], rtol=0.3)


def test_depth_blended_albedo() -> None:
    water = {"type": "IB", "mode": "blended", "blend_per_m": (0.5, 0.2, 0.1), "blend_color": (0.0, 0.1, 0.2)}
    scene = scene_of(water=water, floor={"ground": "even", "albedo": 0.4, "depth_m": 3.0})
    floor = LoadedAerial.of(scene).sea.floor
    own = np.exp(-3.0 * np.array([0.5, 0.2, 0.1]))
    expected = 0.4 * own + np.array([0.0, 0.1, 0.2]) * (1.0 - own)
    np.testing.assert_allclose(floor.mean_albedo, expected, rtol=tol.SINGLE)
    per_m, color = blend_of(scene_of(water={"type": "II", "mode": "blended"}).water)
    assert np.all(per_m > 0.0)
    assert np.all((color > 0.0) & (color < 0.2))
    np.testing.assert_array_equal(blended_albedo(np.ones(3), 0.0, per_m, color), 1.0)


def test_the_thresholded_reflection_lies_where_mirrors_show_the_sun() -> None:
    look = {"sun": "thresholded", "threshold_deg": 6.0, "gain": 3.0}
    camera = {"pitch_deg": -60.0, "yaw_deg": 20.0, "width": 96, "height": 64, "fov_deg": 60.0}
    sun = {"elevation_deg": 60.0, "azimuth_deg": 20.0, "irradiance": (1.0, 0.5, 0.25)}
    with_it, without = (
        uw.aerial(scene_of(camera=camera, sun=sun, reflection=look | {"gain": gain})) for gain in (3.0, 0.0)
    )
    added = (with_it.image_linear - without.image_linear)[..., 0]
    d = with_it.view.directions(np.arange(96) + 0.5, np.arange(64)[:, None] + 0.5)
    towards = direction_from_angles(np.radians(20.0), np.radians(60.0))
    angle = np.degrees(np.arccos(np.clip(reflect(d, np.array([0.0, 1.0, 0.0])) @ towards, -1.0, 1.0)))
    pixel = np.degrees(with_it.view.pixel_rad)
    np.testing.assert_array_equal(added[angle > 6.0 + pixel], 0.0)
    inside = added[angle < 6.0 - pixel]
    assert inside.size > 50
    loaded = LoadedAerial.of(scene_of(camera=camera, sun=sun))
    np.testing.assert_allclose(inside, 3.0 * loaded.exposure, rtol=1e-5)
    np.testing.assert_allclose(with_it.reflection - without.reflection, added[..., None] * [1.0, 0.5, 0.25], atol=1e-5)
    # a pixel that the edge halves has half of it
    assert np.any((added > 0.0) & (added < 0.9 * inside.max()))
    none = thresholded_reflection(d, np.zeros(d.shape), loaded.sea.sun, 1.0)  # type: ignore[arg-type]
    np.testing.assert_array_equal(none, 0.0)


def test_light_on_the_floor_is_the_caustic_map_of_the_same_sea() -> None:
    """Sun overhead, no sky, black ground: nothing but the map, whose pixels the floor's light is read at."""
    scene = scene_of(
        sea=WAVES, sun={"elevation_deg": 90.0}, sky={"irradiance": 0.0}, floor={"ground": "even", "albedo": 0.0}
    )
    loaded = LoadedAerial.of(scene)
    stage = loaded.sea.stage(loaded.view(0.7), 0.7, 1)
    at = (np.arange(64) + 0.5) * 8.0 / 64
    x, z = (a.ravel() for a in np.meshgrid(at, at))
    light = stage.floor_light.irradiance(x, z, np.zeros(x.size))
    expected = caustic_map(
        loaded.sea.sea, [0.0, 1.0, 0.0], scene.floor.depth_m, 0.7, 64, 32, N, scene.sun.half_angle_rad
    )
    assert expected.std() > 0.1
    np.testing.assert_allclose(light, expected.reshape(-1, 1) * sun_below(loaded.sea.sun, N), rtol=tol.ZENITH)


def test_floors_have_relief(tmp_path: Path) -> None:
    heights = np.zeros((64, 64), np.uint8)
    heights[:, 16:48] = 255
    cv2.imwrite(str(tmp_path / "relief.png"), heights)
    floor = {"relief": str(tmp_path / "relief.png"), "relief_m": 1.5, "relief_tile_m": 8.0}
    camera = {"projection": "orthographic", "pitch_deg": -90.0, "width_m": 8.0, "width": 64, "height": 2}
    seen = uw.aerial(scene_of(camera=camera, floor=floor))
    # the picture's columns 16 to 48 are x = 2 to 6, the second half of the repeat that begins at -4
    np.testing.assert_allclose(seen.in_water_m[0, [2, 8, 24, 40, 52]], [2.5, 2.5, 4.0, 4.0, 2.5], atol=tol.START_M)
    with pytest.raises(ValidationError, match="reaches the surface"):
        scene_of(floor=floor | {"depth_m": 1.0})


def test_waves_feel_the_floor_unless_told_otherwise() -> None:
    assert LoadedAerial.of(scene_of(floor={"depth_m": 2.5})).sea.sea.water_depth_m == 2.5
    assert LoadedAerial.of(scene_of(sea=LEVEL | {"water_depth_m": 50.0})).sea.sea.water_depth_m == 50.0


def test_parts_add_up_over_a_level_sea() -> None:
    seen = uw.aerial(scene_of(camera={"pitch_deg": -20.0, "fov_deg": 70.0, "width": 24, "height": 24}))
    d = seen.view.directions(np.arange(24) + 0.5, np.arange(24)[:, None] + 0.5)
    sky = np.isinf(seen.distance_m)
    np.testing.assert_array_equal(sky, d[..., 1] > 0.0)
    for part in (seen.floor_radiance, seen.reflection, seen.normal, seen.in_water_m[..., None]):
        np.testing.assert_array_equal(part[sky], 0.0)
    passed = (1.0 - fresnel(np.abs(d[..., 1]), N))[..., None] / N**2
    both = seen.floor_radiance * passed + seen.reflection
    np.testing.assert_allclose(seen.image_linear[~sky], both[~sky], rtol=tol.FORMULA)
    np.testing.assert_array_equal(seen.normal[~sky], np.broadcast_to([0.0, 1.0, 0.0], (np.sum(~sky), 3)))
    wet = refract_to_water(-d[~sky])[:, 1]
    np.testing.assert_allclose(seen.in_water_m[~sky], 4.0 / wet, atol=tol.START_M * 10.0)


def test_standard_skies() -> None:
    sun = direction_from_angles(0.5, np.radians(40.0))
    up = np.radians(90.0 - 180.0 * (np.arange(32) + 0.5) / 64.0)
    overcast = standard_sky(OVERCAST, sun)
    np.testing.assert_allclose(
        overcast[:32], np.broadcast_to((1.0 + 4.0 * np.exp(-0.7 / np.sin(up)))[:, None], (32, 128))
    )
    np.testing.assert_array_equal(overcast[32:], overcast[31::-1])
    clear = standard_sky(CLEAR, sun)[:32]
    brightest = directions(128, 64)[np.unravel_index(np.argmax(clear), clear.shape)]
    # the horizon's gain draws the brightest place a little down from the sun
    assert np.degrees(np.arccos(brightest @ sun)) < 5.0
    for kind, share in (("clear", 0.2), ("overcast", 0.5)):
        loaded = LoadedAerial.of(scene_of(sky={"kind": kind}))
        assert float(np.mean(loaded.sea.dome.irradiance)) == pytest.approx(share, rel=tol.SKY_SUM)
        assert (loaded.sea.sun is None) == (kind == "overcast")


def test_maps_of_the_sky(tmp_path: Path) -> None:
    codes = np.zeros((32, 64, 3), np.float32)
    codes[4, 40] = 50.0
    cv2.imwrite(str(tmp_path / "sky.hdr"), codes)
    sky = {"kind": "map", "map": str(tmp_path / "sky.hdr")}
    plain, turned = (LoadedAerial.of(scene_of(sky=sky | {"turn_deg": turn})).sea.dome.radiance for turn in (0.0, 90.0))
    np.testing.assert_allclose(plain, codes, rtol=0.01)  # the file's eight bits
    np.testing.assert_array_equal(np.roll(plain, 16, axis=1), turned)
    scaled = LoadedAerial.of(scene_of(sky=sky | {"irradiance": 0.7})).sea
    assert float(np.mean(scaled.dome.irradiance)) == pytest.approx(0.7, rel=tol.SKY_SUM)
    assert scaled.sun is None


def test_the_camera_moves() -> None:
    camera = {"position_m": (1.0, 9.0, 2.0), "velocity_m_s": (0.5, 0.0, -2.0), "yaw_deg": 10.0, "turn_deg_s": 40.0}
    loaded = LoadedAerial.of(scene_of(camera=camera | {"pitch_deg": 0.0, "roll_deg": 30.0}))
    view = loaded.view(2.0, (40, 20))
    np.testing.assert_allclose(view.position, [2.0, 9.0, -2.0])
    np.testing.assert_allclose(
        view.directions(20.0, 10.0), unit(direction_from_angles(np.radians(90.0), 0.0)), atol=1e-12
    )
    right = view.directions(40.0, 10.0) - view.directions(0.0, 10.0)
    assert right[1] < 0.0  # the right side is down
    assert (view.width, view.height) == (40, 20)
    with pytest.raises(ParameterError, match="size"):
        loaded.view(0.0, (0, 5))


def test_a_picture_is_the_same_alone_and_within_a_film() -> None:
    water = {"type": "IB", "mode": "koschmieder", "far_radiance": (0.01, 0.02, 0.03)}
    camera = {"width": 16, "height": 8, "velocity_m_s": (1.0, 0.0, 0.0)}
    scene = scene_of(sea=WAVES, camera=camera, water=water)
    film = LoadedAerial.of(scene)
    for time_s in (0.0, 0.4):
        film.picture(time_s)
    np.testing.assert_array_equal(film.picture(0.2).image_linear, uw.aerial(scene, time_s=0.2).image_linear)


def test_a_scene_without_light_is_refused() -> None:
    with pytest.raises(ParameterError, match="give no light"):
        uw.aerial(scene_of(sky={"irradiance": 0.0}, sun={"irradiance": (0.0, 0.0, 0.0)}))
