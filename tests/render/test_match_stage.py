# SPDX-License-Identifier: Apache-2.0
"""The plate's look on bodies, from the scene to the frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw import open_video, render_frame
from mr360uw.cache import Cache
from mr360uw.color import decode
from mr360uw.composite.grading.plate_grade import PlateGrade
from mr360uw.render.first_pass import clip_facts
from mr360uw.render.loaded import load
from mr360uw.render.stages.match_stage import asked_look, clip_look
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from tests.composite import tolerances as tol
from tests.composite.test_grading import coded, texture
from tests.scenes import scene_with

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
    automatic, off = scene_of(tmp_path, whale), scene_of(tmp_path, whale, enabled=False)
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
        facts = [clip_facts(loaded, video, frames=span) for span in ((0, 3), (2, 3))]
        assert facts[0].look == facts[1].look == clip_look(loaded, video)
        frame = next(iter(video.frames()))
    assert facts[0].look is not None
    assert facts[0].look.softness_px == pytest.approx(1.2, rel=tol.BLUR_FOUND)
    layer = render_frame(linear(picture(1.2)), scene, backend="reference").layer
    alone = asked_look(loaded, None, frame, layer, Cache())
    assert alone.softness_px == pytest.approx(facts[0].look.softness_px, rel=tol.BLUR_FOUND)
    of_clip = asked_look(loaded, facts[0].look, frame, layer, Cache())
    assert of_clip.softness_px == facts[0].look.softness_px
    draft = load(scene.model_copy(update={"plate": scene.plate.model_copy(update={"scale": 0.5})}), 128, 64)
    assert asked_look(draft, facts[0].look, frame, layer, Cache()).softness_px == 0.5 * of_clip.softness_px
    empty = replace(layer, tiles=())
    assert asked_look(loaded, facts[0].look, frame, empty, Cache()) == PlateGrade()


def test_the_plan_says_whether_bodies_are_matched(tmp_path: Path, whale: Path) -> None:
    plain = dict.fromkeys(("white", "gamma", "contrast", "saturation"), 1.0) | {"black": 0.0, "softness": 0.0}
    for match, runs in (({}, True), ({"enabled": False}, False), (plain, False), (plain | {"sharpening": 1}, True)):
        assert load(scene_of(tmp_path, whale, **match), *SIZE).plan.match.runs == runs
    given = load(scene_of(tmp_path, whale, **(plain | {"softness": 1.0, "black": 0.05})), *SIZE)
    assert given.plan.match.why == "the grade as set: black 0.050, softness 1"
