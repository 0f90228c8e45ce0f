# SPDX-License-Identifier: Apache-2.0
"""Views of a frame show what its intermediate results hold, where they hold it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw.base.color import encode
from mr360uw.caustics import caustic_stack, refract_to_air
from mr360uw.depth.occlusion import PlateDepth
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.medium.lookup import veil_lookup
from mr360uw.medium.scattered_light import spread_of
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import Reference, composite_frame
from mr360uw.render.loaded import load
from mr360uw.tune.placing import Point, pixel_of_point, shown_at
from mr360uw.tune.situation import markers, receiver_edge
from mr360uw.tune.views import (
    CHARTS,
    DARK,
    LIGHT,
    VIEW_NAMES,
    VIEWS,
    ShownFrame,
    false_colour,
    round_length,
    text_width,
    write,
)
from mr360uw.types import View
from mr360uw.video import VideoFrame
from tests.depth.own_maps import write_own_maps
from tests.scenes import gradient_plate, scene_with

WIDTH, HEIGHT = 64, 32
OBJ = "v -1 -1 -1\nv 1 -1 -1\nv 1 -1 1\nv -1 1 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"
CODE = 1.0
"""Rounding of codes, twice."""


def shown_frame(folder: Path, **tables: object) -> ShownFrame:
    mesh = folder / "body.obj"
    mesh.write_text(OBJ, "utf-8")
    given = {
        "receiver": {"height_m": -2.5, "extent_m": 12.0},
        "light": {"sun": "given", "sun_azimuth_deg": 70.0, "sun_elevation_deg": 55.0},
        "caustics": {"size": 64, "grid": 64},
        "draw": {"samples": 1, "sun_samples": 1, "ambient_occlusion": False},
        "water": {"bands": 3, "mode": "kd"},
        "lamp": [{"position_m": [-2.0, 1.0, -2.0]}],
        "object": [{"mesh": str(mesh), "position_m": [0.5, -0.5, -4.0], "scale": 0.6,
                    "key": [{"time_s": 0.0}, {"time_s": 4.0, "position_m": [4.0, -0.5, -4.0]}]}],
    }  # fmt: skip
    loaded = load(scene_with(folder, mesh, **(given | tables)), WIDTH, HEIGHT)
    plate = VideoFrame.of_linear(gradient_plate(WIDTH, HEIGHT))
    renderer = Reference()
    frame = composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0)
    return ShownFrame(frame, loaded, renderer, 4.0)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> ShownFrame:
    return shown_frame(tmp_path_factory.mktemp("views"))


def test_every_view_has_a_name_for_people() -> None:
    assert list(VIEWS) == list(VIEW_NAMES)


@pytest.mark.parametrize("name", VIEWS)
def test_every_view_is_a_picture_of_codes_that_does_not_change_the_frame(shown: ShownFrame, name: str) -> None:
    before = shown.frame.layer.ratio.copy()
    picture = VIEWS[name](shown)
    assert picture.dtype == np.uint8
    assert picture.shape[2] == 3
    assert picture.flags.c_contiguous
    assert np.ptp(picture) > 60
    if name not in CHARTS:
        assert picture.shape[1] == 2 * picture.shape[0]
    np.testing.assert_array_equal(shown.frame.layer.ratio, before)


def test_the_composite_and_the_plate_are_their_codes(shown: ShownFrame) -> None:
    for name, frame in (("composite", shown.frame.picture), ("plate", shown.frame.plate)):
        codes = 255.0 * np.clip(encode(frame.image_linear, "srgb"), 0.0, 1.0)
        np.testing.assert_allclose(VIEWS[name](shown), codes, atol=CODE)


def test_the_difference_is_grey_where_nothing_changes_and_dark_in_the_shadow(shown: ShownFrame) -> None:
    picture, ratio = VIEWS["difference"](shown), shown.frame.layer.ratio
    assert np.all(picture[np.all(ratio == 1.0, axis=-1)] == 128)
    darkest = np.unravel_index(np.argmin(ratio[..., 1]), ratio.shape[:2])
    assert ratio[darkest][1] < 0.9
    assert picture[darkest][1] == pytest.approx(np.clip(127.5 + 510.0 * (ratio[darkest][1] - 1.0), 0, 255), abs=CODE)


def test_water_alone_is_the_veil_of_a_long_way(shown: ShownFrame) -> None:
    picture = VIEWS["water"](shown)
    view = View(512, 256)
    for row in (5, 150, 250):
        up = view.directions(0.5, row + 0.5)[1]
        code = 255.0 * encode(veil_lookup(shown.frame.medium, 1e5, up), "srgb")
        np.testing.assert_allclose(picture[row], np.broadcast_to(np.clip(code, 0, 255), (512, 3)), atol=CODE)


def test_distances_of_the_plate_stand_before_the_receiver_s(shown: ShownFrame, tmp_path: Path) -> None:
    metres = np.full(shown.frame.plate.image_linear.shape[:2], np.inf, np.float32)
    metres[-8:] = 1.3
    found = DepthMap(metres, np.isfinite(metres).astype(np.float32))
    write_own_maps(tmp_path, {shown.frame.plate.index: (found,)})
    loaded = replace(shown.loaded, plate_depth=PlateDepth(tmp_path))
    picture = VIEWS["depth"](replace(shown, loaded=loaded))
    wanted = false_colour(np.array([np.log(1.3 / 0.5) / np.log(100.0)]))[0]
    np.testing.assert_array_equal(picture[511, 900], wanted)
    np.testing.assert_array_equal(picture[256], VIEWS["depth"](shown)[256])


def test_distances_have_the_colours_of_the_legend(shown: ShownFrame) -> None:
    picture = VIEWS["depth"](shown)
    down = -View(1024, 512).directions(512.5, 500.5)[1]  # straight below nothing is in the way
    wanted = false_colour(np.array([np.log(2.5 / down / 0.5) / np.log(100.0)]))[0]
    np.testing.assert_array_equal(picture[500, 512], wanted)
    beyond = round(512 * (0.5 + np.arcsin(2.5 / 12.0) / np.pi)) - 2  # where the receiver's extent ends
    assert not picture[beyond, 900].any()
    assert picture[beyond + 4, 900].any()


def test_the_sun_and_lamps_are_marked_where_they_are(shown: ShownFrame) -> None:
    marks = {mark.name: mark for mark in markers(shown.loaded, 0.0, 0, shown.frame.light)}
    assert set(marks) == {"object.0", "lamp.0", "sun"}
    assert (marks["sun"].longitude, marks["sun"].latitude) == pytest.approx(np.radians([70.0, 55.0]), abs=1e-6)
    view = shown.loaded.view(0.0)
    lamp, _ = shown_at(view, np.array([-2.0, 1.0, -2.0]))
    assert (marks["lamp.0"].longitude, marks["lamp.0"].latitude) == pytest.approx((lamp.longitude, lamp.latitude))
    body, away_m = shown_at(view, np.array([0.5, -0.5, -4.0]))
    assert marks["object.0"].longitude == pytest.approx(body.longitude)
    assert marks["object.0"].radius == pytest.approx(np.arctan(0.6 * np.sqrt(3.0) / away_m))
    picture = VIEWS["lights"](shown).astype(int)
    x, y = pixel_of_point(Point(marks["sun"].longitude, marks["sun"].latitude), 1024, 512)
    around = picture[int(y) - 20 : int(y) + 21, int(x) - 20 : int(x) + 21]
    assert np.max(around[..., 0] - around[..., 2]) > 150  # its ring is red


def test_a_tile_of_caustics_has_the_map_that_the_renderer_makes(shown: ShownFrame) -> None:
    picture = VIEWS["caustics"](shown)
    assert picture.shape == (720, 720, 3)
    assert shown.ground_y == (-2.5, "receiver")
    scene, sun = shown.loaded.scene, shown.sun
    assert sun is not None
    in_air = refract_to_air(sun.direction, scene.water.refractive_index)
    settings = shown.loaded.caustic_depths.settings
    spread = spread_of(shown.loaded.surroundings.medium)
    depths = np.array([scene.camera.depth_m + 2.5])
    ratio = caustic_stack(scene.sea, in_air, depths, 0.0, settings, scene.water.refractive_index, spread).ratio[
        0, ..., 1
    ]
    small = cv2.resize(picture[..., 1], ratio.shape[::-1], interpolation=cv2.INTER_AREA)
    bare = slice(ratio.shape[0] // 8, -ratio.shape[0] // 8)  # below the words, above the bar
    likeness = np.corrcoef(small[bare].ravel(), encode(ratio[bare], "srgb").ravel())[0, 1]
    assert likeness > 0.98  # the picture is enlarged smoothly, and its brightest 2 in 1000 are white


def test_views_say_why_there_is_nothing(tmp_path: Path) -> None:
    bare = shown_frame(tmp_path, water={"type": "none"}, object=[], lamp=[], receiver={})
    for name in ("caustics", "water"):
        words = VIEWS[name](bare)
        assert words.shape[2] == 3
        assert 0.0 < np.mean(np.any(words != DARK.back, axis=-1)) < 0.1
    assert bare.frame.layer.tiles == ()
    assert np.all(VIEWS["difference"](bare) == 128)


def test_charts_suit_light_and_dark_pages(shown: ShownFrame) -> None:
    """Contrast of text to ground at least 4.5 : 1, of the rest at least 3 : 1 (WCAG 2.2, 1.4.3 and 1.4.11)."""
    for palette in (DARK, LIGHT):
        for color in (palette.text, palette.soft, palette.strong, palette.warm, *palette.series):
            assert contrast(color, palette.back) > 4.5, color
    plan = VIEWS["plan"](replace(shown, dark=False))
    assert tuple(plan[450, 5]) == LIGHT.back
    for color in (LIGHT.series[0], LIGHT.strong, LIGHT.warm):
        assert np.any(np.all(plan == color, axis=-1))


def contrast(one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
    from mr360uw.base.color import decode, luminance

    light, dark = sorted((float(luminance(decode(np.array(c) / 255.0, "srgb"))) for c in (one, other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_the_edge_of_a_plane_is_where_its_extent_ends(shown: ShownFrame) -> None:
    view, receiver = shown.loaded.view(0.0), shown.receiver
    assert receiver is not None
    (line,) = receiver_edge(view, receiver)
    assert all(point.latitude == pytest.approx(-np.arcsin(2.5 / 12.0)) for point in line)
    assert (line[0].longitude, line[-1].longitude) == pytest.approx((-np.pi, np.pi), abs=1e-9)
    assert receiver_edge(view, replace(receiver, extent_m=2.0)) == []


def test_the_edge_of_a_mesh_is_its_highest_direction(shown: ShownFrame) -> None:
    corners = np.array([[x, -2.0, z] for x, z in ((-3, -8), (3, -8), (3, -2), (-3, -2))], float)
    receiver = replace(shown.receiver, plane_y=None, mesh=corners[[[0, 1, 2], [0, 2, 3]]])
    lines = receiver_edge(shown.loaded.view(0.0), receiver)
    middle = min((point for line in lines for point in line), key=lambda point: abs(point.longitude))
    assert middle.latitude == pytest.approx(-np.arctan(2.0 / 8.0), abs=np.pi / 90)  # rows are 2 degrees apart
    assert all(abs(point.longitude) < 1.0 for line in lines for point in line)


def test_round_lengths() -> None:
    assert [round_length(v) for v in (0.19, 0.2, 0.99, 1.0, 4.9, 730.0)] == [0.1, 0.2, 0.5, 1.0, 2.0, 500.0]


def test_words_are_drawn_where_they_are_put() -> None:
    image = np.zeros((40, 200, 3), np.uint8)
    write(image, "abc", (100, 30), (255, 255, 255))
    rows, columns = np.nonzero(image[..., 0])
    assert 98 <= columns.min() <= 104
    assert columns.max() <= 100 + text_width("abc") + 1
    assert rows.max() <= 31
    assert cv2.countNonZero(image[..., 0]) > 20
