# SPDX-License-Identifier: Apache-2.0
"""Patches of known colour that are seen through water, from the picture to the grade."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw import open_video
from mr360uw.base.color import encode
from mr360uw.base.sphere import direction_from_angles, directions
from mr360uw.cli import main
from mr360uw.composite.grading.colour_grade import ColourGrade
from mr360uw.composite.grading.settings import PlateGrade
from mr360uw.errors import ParameterError
from mr360uw.medium import WaterSettings
from mr360uw.preview.live import LivePreview
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.loaded import load
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from tests.composite import tolerances as tol
from tests.scenes import scene_with

SIZE = 256, 128
DEPTH_M = 6.0
WATER: dict[str, Any] = {"type": "IB", "bands": 15}
GAIN = 3.0, 4.0, 3.5
BENT = ColourGrade((0.07, 0.05, 0.06), (0.9, 0.9, 0.9))
"""A grade that lifts black, of each channel on its own, and pulls white down."""
REFLECTED = {"black": 0.0, "grey": 0.18, "white": 0.9}
Seen = tuple[str, float]
"""What a patch is, and its distance [m]."""


def plate(path: Path, grade: ColourGrade, seen: list[Seen]) -> tuple[Floats, list[dict[str, Any]]]:
    """Write a graded plate of open water and flat patches in it; return its light before the grade, and the patches.

    The light is the water's own, by its spectral solution and not by the tables that frames are drawn with.
    """
    medium = WaterSettings(**WATER).medium(DEPTH_M)
    assert medium is not None
    medium = medium.scaled(GAIN)
    way = directions(*SIZE)
    light = np.broadcast_to(medium.gain * medium.level_radiance(way[:, :1, 1].ravel())[:, None], way.shape).copy()
    patches = []
    for k, (kind, distance_m) in enumerate(seen):
        azimuth, elevation = 40.0 * k - 30.0, -12.0 + 8.0 * k
        middle = direction_from_angles(np.radians(azimuth), np.radians(elevation))
        there, up = way @ middle > np.cos(np.radians(5.0)), float(middle[1])
        of_white = medium.irradiance(DEPTH_M - distance_m * up) / np.pi
        shown = REFLECTED[kind] * of_white * medium.transmittance(distance_m, DEPTH_M, up)
        light[there] = shown + medium.veil(distance_m, DEPTH_M, up)
        place = {"azimuth_deg": azimuth, "elevation_deg": elevation, "size_deg": 6.0, "distance_m": distance_m}
        patches.append(place | {"is": kind})
    codes = np.clip(grade.graded(encode(light, "srgb")), 0.0, 1.0)
    cv2.imwrite(str(path), np.rint(255.0 * codes).astype(np.uint8)[..., ::-1])
    return light, patches


def scene_of(folder: Path, whale: Path, patches: list[dict[str, Any]], **tables: Any) -> Scene:
    """Return a scene of a plate in `WATER`, with a grade that patches tell."""
    water = WATER | tables.pop("water", {})
    match = {"softness": 0.0, "patch": patches} | tables.pop("match", {})
    return scene_with(
        folder, whale, match=match, water=water, light={"sun": "none"}, camera={"depth_m": DEPTH_M}, **tables
    )


def grade_of(folder: Path, scene: Scene) -> PlateGrade:
    with open_video(folder / "plate.png") as video:
        grade = clip_analysis(load(scene, *SIZE), video).grade
    assert grade is not None
    return grade


def assert_ungraded(folder: Path, colour: ColourGrade, light: Floats) -> None:
    """Assert that the plate without a grade's colour shows a light, where it is not clipped."""
    codes = cv2.imread(str(folder / "plate.png"))[..., ::-1] / 255.0
    inside = np.all(codes < 1.0, axis=-1)
    assert inside.mean() > 0.7
    np.testing.assert_allclose(colour.ungraded(codes)[inside], encode(light, "srgb")[inside], atol=tol.PATCH_CODES)


@pytest.mark.parametrize(("black", "white"), [(2.0, 2.0), (1.0, 4.0), (3.0, 1.5)])
def test_a_black_and_a_white_patch_in_the_water_give_the_plate_without_its_grade(
    tmp_path: Path, whale: Path, black: float, white: float
) -> None:
    light, patches = plate(tmp_path / "plate.png", BENT, [("black", black), ("white", white)])
    grade = grade_of(tmp_path, scene_of(tmp_path, whale, patches, match={"white": 0.9}))
    assert grade.found[0].startswith("2 patches: black 0.0")
    nearer = re.search(r"; were all a tenth nearer, black would be 0\.0\d+ (0\.\d+) (0\.\d+)", grade.found[0])
    assert nearer is not None
    assert grade.colour.black[1] < float(nearer[1]) < grade.colour.black[1] + 2.5 * tol.PATCH_BLACK
    np.testing.assert_allclose(grade.colour.black, BENT.black, atol=tol.PATCH_BLACK)
    assert_ungraded(tmp_path, grade.colour, light)
    near = [{name: one[name] for name in one if name != "distance_m"} for one in patches]
    as_if_near = grade_of(tmp_path, scene_of(tmp_path, whale, near, match={"white": 0.9})).colour
    lifted = np.array(as_if_near.black) - BENT.black
    assert lifted.max() > 2.5 * tol.PATCH_BLACK  # the water before it, most in blue


def test_patches_in_water_of_a_known_light_tell_black_and_white(tmp_path: Path, whale: Path) -> None:
    light, patches = plate(tmp_path / "plate.png", BENT, [("black", 1.0), ("black", 10.0)])
    curve = dict.fromkeys(("gamma", "contrast", "saturation"), 1.0)
    scene = scene_of(tmp_path, whale, patches, water={"gain": GAIN}, match=curve)
    colour = grade_of(tmp_path, scene).colour
    np.testing.assert_allclose(colour.black, BENT.black, atol=tol.PATCH_BLACK)
    np.testing.assert_allclose(colour.white, BENT.white, atol=tol.PATCH_NUMBER)
    assert_ungraded(tmp_path, colour, light)


def test_a_black_that_the_water_hides_in_a_channel_tells_one_black_of_all_channels(
    tmp_path: Path, whale: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(WATER, "type", "1C")
    even = ColourGrade((0.06, 0.06, 0.06))
    _, patches = plate(tmp_path / "plate.png", even, [("black", 4.0)])
    black = grade_of(tmp_path, scene_of(tmp_path, whale, patches)).colour.black
    np.testing.assert_allclose(black, even.black, atol=tol.PATCH_BLACK)
    assert len(set(black)) == 1


def test_patches_near_and_far_are_mixed_and_air_has_no_distance(tmp_path: Path, whale: Path) -> None:
    _, patches = plate(tmp_path / "plate.png", BENT, [("black", 0.02), ("black", 4.0), ("grey", 0.02), ("white", 4.0)])
    near = [{name: one[name] for name in one if name != "distance_m"} for one in patches]
    mixed = [near[0], patches[1], near[2], patches[3]]
    black = grade_of(tmp_path, scene_of(tmp_path, whale, mixed)).colour.black
    np.testing.assert_allclose(black, BENT.black, atol=tol.PATCH_BLACK)
    air = {"type": "none"}
    dry, plain = (grade_of(tmp_path, scene_of(tmp_path, whale, of, water=air)).colour for of in (patches, near))
    assert dry == plain


def test_a_preview_reads_a_patch_in_the_frame_that_shows_it(tmp_path: Path, whale: Path) -> None:
    """The second frame shows no patch; the whale is in both."""
    _, patches = plate(tmp_path / "shown_0.png", BENT, [("black", 2.0)])
    plate(tmp_path / "shown_1.png", BENT, [])
    scene = scene_of(tmp_path, whale, patches, draw={"samples": 1, "ambient_occlusion": False})
    plates = scene.plate.model_copy(update={"path": tmp_path / "shown_%d.png"})
    with LivePreview("reference") as live:
        grades = [live.frame(scene.model_copy(update={"plate": plates}), index).plate.grade for index in (0, 1)]
    for grade in grades:
        assert isinstance(grade, ColourGrade)
        np.testing.assert_allclose(grade.black, BENT.black, atol=tol.PATCH_BLACK)


@pytest.mark.parametrize(
    ("distance_m", "elevation_deg", "words"),
    [
        (30.0, 0.0, r"is so far that only water is seen: .* beyond 5\.\d m there \(got 30\) - mark something nearer"),
        (20.0, 30.0, r"is above the water, whose surface is 12 m away there \(got 20\) - give the distance"),
    ],
)
def test_a_patch_that_shows_only_water_is_refused(
    tmp_path: Path, whale: Path, distance_m: float, elevation_deg: float, words: str
) -> None:
    plate(tmp_path / "plate.png", BENT, [])
    patch = {"azimuth_deg": 0.0, "elevation_deg": elevation_deg, "is": "black", "distance_m": distance_m}
    with pytest.raises(ParameterError, match=rf"match\.patch\[0\]\.distance_m - {words}"):
        grade_of(tmp_path, scene_of(tmp_path, whale, [patch], water={"type": "7C"}))


@pytest.mark.parametrize("command", [["check"], ["composite", "--backend", "reference"]])
def test_commands_refuse_it_with_a_message(
    tmp_path: Path, whale: Path, command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plate(tmp_path / "plate.png", BENT, [])
    (tmp_path / "scene.toml").write_text(
        f'''plate = "plate.png"
[camera]
depth_m = {DEPTH_M}
[water]
type = "7C"
bands = 15
[[object]]
mesh = "{whale}"
position_m = [0.0, 0.0, -3.0]
[[match.patch]]
azimuth_deg = 0.0
elevation_deg = 0.0
is = "black"
distance_m = 30.0
'''
    )
    out = [str(tmp_path / "out.png")] if command[0] == "composite" else []
    monkeypatch.setattr("sys.argv", ["mr360uw", command[0], str(tmp_path / "scene.toml"), *out, *command[1:]])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert "match.patch[0].distance_m - is so far that only water is seen" in capsys.readouterr().err
    assert not (tmp_path / "out.png").exists()
