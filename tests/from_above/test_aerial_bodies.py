# SPDX-License-Identifier: Apache-2.0
"""Bodies in pictures from above, and laid into plates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from mr360uw.base.optics import refract_to_water
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.errors import VideoError
from mr360uw.from_above import AerialScene, LoadedAerial, aerial_film
from mr360uw.from_above.aerial_bodies import light_below
from mr360uw.from_above.aerial_picture import plate_gain
from mr360uw.surface.sky import sun_below
from mr360uw.video import open_video, read_spherical
from tests.from_above import tolerances as tol
from tests.from_above.test_aerial_picture import scene_of

SQUARE = "v -0.5 0 0.5\nv 0.5 0 0.5\nv 0.5 0 -0.5\nv -0.5 0 -0.5\nf 1 2 3 4\n"
"""A level square of one metre, whose face is up."""
DOWN = {"pitch_deg": -90.0, "fov_deg": 20.0, "width": 48, "height": 32, "position_m": (0.0, 8.0, 0.0)}


@pytest.fixture
def square(tmp_path: Path) -> dict[str, Any]:
    """An object: the square, 2 m deep, off the middle, white and matt."""
    (tmp_path / "square.obj").write_text(SQUARE)
    return {
        "mesh": str(tmp_path / "square.obj"), "position_m": (0.7, -2.0, 0.0), "base_color": (0.5, 0.5, 0.5),
        "roughness": 1.0, "metallic": 0.0, "refractive_index": 1.34,
    }  # fmt: skip


def with_objects(scene: AerialScene, *objects: dict[str, Any], **more: Any) -> AerialScene:
    return AerialScene.model_validate(scene.model_dump(by_alias=True, exclude_unset=True) | {"object": objects} | more)


def test_a_body_lies_where_snells_law_puts_it(square: dict[str, Any]) -> None:
    seen = LoadedAerial.of(with_objects(scene_of(camera=DOWN), square)).picture()
    scale = 48.0 / (2.0 * np.tan(np.radians(10.0)))
    # near the axis a depth of 2 m looks like 2/n
    edges = (np.array([0.2, 1.2]) / (8.0 + 2.0 / 1.34)) * scale + 24.0
    columns = np.flatnonzero(seen.body_alpha[16] > 0.5)
    assert abs(columns[0] - edges[0]) < 1.0
    assert abs(columns[-1] + 1 - edges[1]) < 1.0
    bare = LoadedAerial.of(scene_of(camera=DOWN)).picture()
    outside = seen.body_alpha == 0.0
    assert np.all(seen.image_linear[outside] <= bare.image_linear[outside])  # its shadow takes light away
    # a body of albedo 0.5 over a floor of 0.35, in clear water under the same light
    inside = seen.body_alpha > 0.97  # the picture keeps what the surface reflects
    assert inside.sum() > 50
    ratio = (seen.image_linear - bare.reflection)[inside] / (bare.image_linear - bare.reflection)[inside]
    assert np.all(ratio > 1.0)
    assert np.all(ratio < 1.5)


def test_the_shadow_of_a_body_lies_behind_it(square: dict[str, Any]) -> None:
    """Sun in the plane of the picture, clear water: the floor keeps all light but the sun's; it lies along the beam."""
    sun = {"elevation_deg": 60.0, "azimuth_deg": 90.0}
    camera = DOWN | {"fov_deg": 40.0}
    bare, seen = (
        LoadedAerial.of(with_objects(scene_of(camera=camera, sun=sun), *some)).picture()
        for some in ((), (square | {"position_m": (1.2, -2.0, 0.0)},))
    )
    lost = ((bare.image_linear - seen.image_linear) * (seen.body_alpha == 0.0)[..., None])[16]
    wet = refract_to_water(direction_from_angles(np.radians(90.0), np.radians(60.0)))
    middle = 1.2 - 2.0 * wet[0] / wet[1]  # 2 m below the body; depth 4 m looks like 4/n
    scale = 48.0 / (2.0 * np.tan(np.radians(20.0))) / (8.0 + 4.0 / 1.34)
    dark = np.flatnonzero(lost[:, 1] > 0.5 * lost[:, 1].max())
    assert abs(0.5 * (dark[0] + dark[-1] + 1) - (24.0 + middle * scale)) < 1.0
    assert abs(len(dark) - scale) < 1.5
    column = dark[len(dark) // 2]
    sea = LoadedAerial.of(scene_of(camera=camera, sun=sun)).sea
    both = sea.light_in_water(4.0).down(4.0)
    share = lost[column] / (bare.image_linear - bare.reflection)[16, column]
    np.testing.assert_allclose(share, sun_below(sea.sun, 1.34) / both, rtol=tol.FORMULA)


def test_the_light_of_bodies_is_that_of_the_water() -> None:
    """The map brings the field's irradiance down through a level plane."""
    sea = LoadedAerial.of(scene_of(water={"type": "IB"}, floor={"depth_m": 500.0, "albedo": 0.0})).sea
    radiance = light_below(sea, 500.0)
    up_, solid = directions(256, 128)[..., 1], row_solid_angle(256, 128)[:, None]
    down = np.einsum("hwc,hw->c", radiance, np.maximum(up_, 0.0) * solid)
    # the sky's own light, and what the surface sends back of that from below
    expected = sea.dome.irradiance_below(1.34)
    assert np.all(down > expected)
    np.testing.assert_allclose(down, expected, rtol=0.1)


def test_floating_bodies_are_cut_at_the_waterline(square: dict[str, Any]) -> None:
    boat = square | {"attach": "surface", "position_m": (0.0, 0.3, 0.0)}
    seen = LoadedAerial.of(with_objects(scene_of(camera=DOWN), boat)).picture()
    wide = 0.5 / 7.7 * 48.0 / (2.0 * np.tan(np.radians(10.0)))
    assert abs(np.sum(seen.body_alpha[16]) - 2.0 * wide) < 1.0
    assert float(seen.image_linear[16, 24].mean()) > 0.35  # half of a card that is lit in the air


def test_plates_take_bodies(square: dict[str, Any], tmp_path: Path) -> None:
    base = scene_of(camera=DOWN)
    plate = LoadedAerial.of(base).picture(size=(48, 32)).image_linear * [0.5, 0.4, 0.3]
    codes = np.clip(255.0 * plate ** (1.0 / 2.2), 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "drone.png"), codes[..., ::-1])
    scene = with_objects(base, square, plate={"path": str(tmp_path / "drone.png")})
    report = aerial_film(scene, tmp_path / "out.png")
    assert report.frames == 1
    out = cv2.imread(str(tmp_path / "out.png"))[..., ::-1]
    layer = LoadedAerial.of(scene).layer(0.0, (48, 32))
    alpha, shaded = layer.alpha, np.any(layer.ratio != 1.0, axis=-1)
    untouched = (alpha == 0.0) & ~shaded
    np.testing.assert_array_equal(out[untouched], codes[untouched])
    assert np.all(out[shaded & (alpha == 0.0)].astype(int) < codes[shaded & (alpha == 0.0)])
    inside = alpha > 0.97  # the plate keeps what the surface reflects
    assert np.mean(out[inside]) > np.mean(codes[inside])
    gain = plate_gain(LoadedAerial.of(scene), plate.astype(np.float32))
    np.testing.assert_allclose(gain, [0.5, 0.4, 0.3], rtol=0.01)  # pictures of other sizes
    with pytest.raises(VideoError, match="already there"):
        aerial_film(scene, tmp_path / "out.png")


def test_videos_of_drones_stay_flat(square: dict[str, Any], tmp_path: Path) -> None:
    base = scene_of(camera=DOWN, film={"duration_s": 0.05, "samples": 1})
    small = with_objects(base, square)
    aerial_film(replace_camera(small, width=16, height=8), tmp_path / "drone.mp4", frames=(0, 1))
    scene = with_objects(base, square, plate={"path": str(tmp_path / "drone.mp4")})
    assert aerial_film(scene, tmp_path / "out.mp4").frames == 1
    assert read_spherical(tmp_path / "out.mp4") is None
    with open_video(tmp_path / "out.mp4", equirectangular=False) as video:
        assert (video.width, video.height) == (16, 8)


def replace_camera(scene: AerialScene, **keys: Any) -> AerialScene:
    return scene.model_copy(update={"camera": scene.camera.model_copy(update=keys)})


def test_what_cannot_be_shown_is_refused(square: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="parallel rays show no objects"):
        with_objects(scene_of(camera={"projection": "orthographic"}), square)
    with pytest.raises(ValidationError, match="nothing is put into it"):
        scene_of(plate={"path": str(tmp_path / "drone.png")})


def test_a_scene_without_bodies_has_an_empty_layer() -> None:
    loaded = LoadedAerial.of(scene_of())
    assert loaded.layer(0.0, (8, 4)).tiles == ()
    assert replace(loaded, bodies=None).picture(0.0, (8, 4)).body_alpha.sum() == 0.0
