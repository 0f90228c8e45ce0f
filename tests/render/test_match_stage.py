# SPDX-License-Identifier: Apache-2.0
"""The plate's look on bodies, from the scene to the frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw import open_video, render_frame
from mr360uw.base.cache import Cache
from mr360uw.base.color import ColorSpec, decode, encode
from mr360uw.base.disk_cache import write_arrays
from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade, code_of
from mr360uw.composite.grading.settings import MatchSettings
from mr360uw.errors import VideoError
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.loaded import load
from mr360uw.render.match_stage import asked_grade, clip_grade
from mr360uw.runs.work_folder import arrays_of_analysis, load_analysis
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from mr360uw.video import VideoFrame
from tests.composite import tolerances as tol
from tests.composite.test_grading import coded, texture
from tests.scenes import gradient_plate, scene_with

SIZE = 256, 128


def picture(deviation_px: float) -> Floats:
    """Return a grey plate (H, W, 3) of 8-bit codes, blurred."""
    luma = texture(height=SIZE[1])
    soft = cv2.GaussianBlur(luma, (0, 0), deviation_px) if deviation_px else luma
    return np.repeat(coded(soft).astype(np.uint8)[..., None], 3, axis=-1)


def linear(codes: Floats) -> Floats:
    return decode(codes / 255.0, "srgb").astype(np.float32)


def scene_of(folder: Path, whale: Path, **match: Any) -> Scene:
    tables = {"light": {"sun": "none"}, "water": {"type": "none"}, "draw": {"samples": 5, "ambient_occlusion": False}}
    return scene_with(folder, whale, match=match, **tables)


def test_a_sharp_plate_changes_no_bit_and_a_soft_one_softens(tmp_path: Path, whale: Path, backend: str) -> None:
    automatic, off = scene_of(tmp_path, whale), scene_of(tmp_path, whale, softness=0.0)
    sharp, soft = linear(picture(0.0)), linear(picture(1.2))
    untouched, as_is = (render_frame(sharp, scene, backend=backend) for scene in (automatic, off))
    np.testing.assert_array_equal(untouched.image_linear, as_is.image_linear)
    np.testing.assert_array_equal(untouched.layer.alpha, as_is.layer.alpha)
    drawn, matched = (render_frame(soft, scene, backend=backend).layer for scene in (off, automatic))
    expected = cv2.GaussianBlur(drawn.alpha, (0, 0), 1.2)
    assert np.abs(matched.alpha - expected).max() < 0.3 * np.abs(drawn.alpha - expected).max()
    np.testing.assert_array_equal(drawn.ratio, matched.ratio)


def test_a_clip_has_one_look_in_every_range(tmp_path: Path, whale: Path) -> None:
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"soft_{k}.png"), picture(1.2))
    scene = scene_of(tmp_path, whale)
    loaded = load(scene, *SIZE)
    with open_video(tmp_path / "soft_%d.png") as video:
        analysis = [clip_analysis(loaded, video, frames=span) for span in ((0, 3), (2, 3))]
        assert analysis[0].grade == analysis[1].grade == clip_grade(loaded, video)
        frame = next(iter(video.frames()))
    assert analysis[0].grade is not None
    assert analysis[0].grade.softness_px == pytest.approx(1.2, rel=tol.BLUR_FOUND)
    alone = asked_grade(loaded, None, frame, Cache())
    assert alone.softness_px == pytest.approx(analysis[0].grade.softness_px, rel=tol.BLUR_FOUND)
    of_clip = asked_grade(loaded, analysis[0].grade, frame, Cache())
    assert of_clip.softness_px == analysis[0].grade.softness_px
    draft = load(scene.model_copy(update={"plate": scene.plate.model_copy(update={"scale": 0.5})}), 128, 64)
    assert asked_grade(draft, analysis[0].grade, frame, Cache()).softness_px == 0.5 * of_clip.softness_px


def test_the_plan_says_whether_bodies_are_matched(tmp_path: Path, whale: Path) -> None:
    plain = {"softness": 0.0}
    for match, runs in (({}, True), (plain, False), (plain | {"sharpening": 1}, True)):
        assert load(scene_of(tmp_path, whale, **match), *SIZE).plan.match.runs == runs
    given = load(scene_of(tmp_path, whale, **(plain | {"softness": 1.0, "black": 0.05})), *SIZE)
    assert given.plan.match.why == "the grade as set: black 0.050, softness 1"


def test_an_ungraded_plate_is_never_read_through_a_grade_that_nobody_gave(tmp_path: Path, whale: Path) -> None:
    """Codes that end away from black and white, as of a lit hall in HDR or a murky dive, are no grade by themselves."""
    faded = (0.38 + 0.3 * gradient_plate(96, 48, sun=None) / 2.0).astype(np.float32)
    faded[::7] = 0.38  # many pixels share the darkest code
    tables: dict[str, Any] = {"light": {"sun": "none"}, "draw": {"samples": 5}}
    off, default = (scene_with(tmp_path, whale, match=match, **tables) for match in ({"softness": 0.0}, {}))
    as_is, made = (render_frame(faded, scene, backend="reference") for scene in (off, default))
    np.testing.assert_array_equal(made.image_linear, as_is.image_linear)


def test_patches_must_be_read_and_lie_within_the_clip(tmp_path: Path, whale: Path) -> None:
    patch = {"azimuth_deg": 0.0, "elevation_deg": 0.0}
    numbers = dict.fromkeys(("white", "gamma", "contrast", "saturation"), 1.0) | {"black": 0.0}
    unread = load(scene_of(tmp_path, whale, patch=[patch], softness=1.0, **numbers), *SIZE)
    assert unread.plan.match.why == "the grade as set: softness 1; 1 patch not read, as every number is set"
    for number in range(2):
        cv2.imwrite(str(tmp_path / f"late_{number}.png"), np.full((*SIZE[::-1], 3), 90, np.uint8))
    late = load(scene_of(tmp_path, whale, patch=[patch, patch | {"time_s": 0.1}]), *SIZE)
    with (
        open_video(tmp_path / "late_%d.png") as video,
        pytest.raises(VideoError, match=r"match\.patch\[1\]\.time_s - is after the plate's end, 0\.07 s \(got 0\.1\)"),
    ):
        clip_analysis(late, video, frames=(0, 2))


GRADED = {"black": (0.06, 0.05, 0.04), "white": 0.92, "gamma": 0.9, "contrast": 1.2, "saturation": 1.3}


def test_a_composite_in_a_graded_plate_is_the_grade_of_the_composite(tmp_path: Path, whale: Path, backend: str) -> None:
    """Light from the plate, a body and its shadow on the floor; a plate of floats, so that nothing is rounded."""
    grade = MatchSettings(**GRADED).colour_over(NO_GRADE)
    plain = gradient_plate(96, 48, sun=None)
    graded = grade.lay_on(plain, VideoFrame.of_linear(plain).spec)
    tables: dict[str, Any] = {
        "light": {"sun": "none"}, "water": {"type": "none"}, "draw": {"samples": 5},
        "receiver": {"kind": "plane", "position_m": [0.0, -1.5, 0.0]},
    }  # fmt: skip
    off, given = (scene_with(tmp_path, whale, match=match, **tables) for match in ({"softness": 0.0}, GRADED))
    truth, made = (render_frame(*of, backend=backend) for of in ((plain, off), (graded, given)))
    changed = np.any(truth.image_linear != plain, axis=-1)
    assert changed.mean() > 0.01
    spec = ColorSpec("bt709", True, "srgb")
    wanted, found = (code_of(one, spec) for one in (grade.lay_on(truth.image_linear, spec), made.image_linear))
    np.testing.assert_allclose(found[changed], wanted[changed], atol=tol.GRADED_RENDER)
    np.testing.assert_array_equal(made.image_linear[~changed], graded[~changed])
    as_is = render_frame(graded, off, backend=backend)
    assert np.abs(code_of(as_is.image_linear, spec) - wanted)[changed].max() > 10.0 * tol.GRADED_RENDER


def test_patches_of_a_clip_are_solved_and_kept(tmp_path: Path, whale: Path) -> None:
    """A black one and three coloured cards in the first of two frames, which the second does not show."""
    grade, light = ColourGrade((0.06, 0.06, 0.06), gamma=0.85, saturation=1.3), np.array([0.25, 0.5, 0.6])
    reflected = [(0.0, 0.0, 0.0), (0.2, 0.2, 0.2), (0.9, 0.9, 0.9), (0.7, 0.15, 0.1), (0.1, 0.2, 0.7)]
    codes = np.full((*SIZE[::-1], 3), 0.4)
    patches: list[dict[str, Any]] = []
    for k, reflectance in enumerate(reflected):
        column = 128 + 16 * k
        codes[60:68, column - 4 : column + 4] = encode(light * np.array(reflectance), "srgb")
        place = {"azimuth_deg": 360.0 * column / SIZE[0] - 180.0, "elevation_deg": 0.0, "size_deg": 6.0}
        kind = "black" if k == 0 else "grey" if k < 3 else "colour"
        shown = {"reflectance": reflectance[0] if k < 3 else reflectance} if k else {}
        patches.append(place | {"is": kind} | shown)
    for number, of_frame in enumerate((codes, np.full_like(codes, 0.4))):
        picture = np.rint(255.0 * np.clip(grade.graded(of_frame), 0.0, 1.0)).astype(np.uint8)
        cv2.imwrite(str(tmp_path / f"card_{number}.png"), picture[..., ::-1])
    scene = scene_of(tmp_path, whale, patch=patches, softness=0.0, white=1.0)
    with open_video(tmp_path / "card_%d.png") as video:
        analysis = clip_analysis(load(scene, *SIZE), video, frames=(1, 2))
    assert analysis.grade is not None
    colour = analysis.grade.colour
    np.testing.assert_allclose(colour.black, grade.black, atol=tol.PATCH_BLACK)
    assert colour.gamma == pytest.approx(grade.gamma, abs=2.0 * tol.PATCH_NUMBER)  # codes are rounded to 8 bits
    assert colour.saturation == pytest.approx(grade.saturation, abs=2.0 * tol.PATCH_NUMBER)
    assert analysis.grade.found[0].startswith("5 patches: black 0.0")
    assert colour.contrast == pytest.approx(1.0, abs=2.0 * tol.PATCH_NUMBER)
    write_arrays(tmp_path / "analysis.npz", arrays_of_analysis(analysis))
    stored = load_analysis(tmp_path / "analysis.npz")
    assert stored is not None
    assert stored.grade == analysis.grade
