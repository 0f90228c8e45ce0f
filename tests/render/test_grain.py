# SPDX-License-Identifier: Apache-2.0
"""The plate's grain on objects, from the scene to the frame."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw import composite_video, render_frame
from mr360uw.base.color import decode, encode
from mr360uw.render.check import explain_plan
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from tests import tolerances as tol
from tests.scenes import gradient_plate, scene_with

SIZE = (512, 256)
STD = 0.02


def noisy_plate(rng: np.random.Generator) -> Floats:
    """Return code values (H, W, 3) of a plate with grain of luma."""
    return encode(gradient_plate(*SIZE, sun=None), "srgb") + STD * rng.standard_normal((SIZE[1], SIZE[0], 1))


def scene_of(folder: Path, whale: Path, grain: float) -> Scene:
    near = [{"mesh": str(whale), "position_m": [0.2, -0.3, -2.5], "rotation_deg": [-70.0, 5.0, 0.0], "scale": 2.0}]
    tables = {"light": {"sun": "none"}, "water": {"type": "none"}, "object": near}
    return scene_with(folder, whale, draw={"grain": grain}, **tables)


def test_a_frame_gets_grain_where_objects_are(
    tmp_path: Path, whale: Path, backend: str, rng: np.random.Generator
) -> None:
    plate = decode(np.clip(noisy_plate(rng), 0.0, 1.0), "srgb").astype(np.float32)
    plain, half, full = (
        render_frame(plate, scene_of(tmp_path, whale, grain), backend=backend, index=4) for grain in (0.0, 0.5, 1.0)
    )
    alpha = full.layer.alpha
    assert np.array_equal(full.image_linear[alpha == 0.0], plate[alpha == 0.0])
    light = plain.image_linear.max(axis=-1)
    solid = (alpha == 1.0) & (light > 0.02) & (light < 0.9)
    assert solid.sum() > 1500
    change = [encode(f.image_linear, "srgb") - encode(plain.image_linear, "srgb") for f in (half, full)]
    spread = [float(c[solid][:, 1].std()) for c in change]
    expected = (encode(plate, "srgb") - cv2.GaussianBlur(encode(plate, "srgb"), (0, 0), 5.0))[40:200, :, 1].std()
    assert spread[1] == pytest.approx(expected, rel=tol.GRAIN_TEXTURED)
    assert spread[0] == pytest.approx(0.5 * spread[1], rel=tol.GRAIN_ADDED)


def test_a_frame_is_the_same_alone_and_in_a_range(tmp_path: Path, whale: Path, rng: np.random.Generator) -> None:
    for k in range(3):
        codes = np.round(255.0 * np.clip(noisy_plate(rng), 0.0, 1.0)).astype(np.uint8)
        cv2.imwrite(str(tmp_path / f"plate_{k}.png"), codes[..., ::-1])
    scene = scene_of(tmp_path, whale, 1.0)
    scene = scene.model_copy(update={"plate": scene.plate.model_copy(update={"path": tmp_path / "plate_%d.png"})})
    composite_video(scene, tmp_path / "all_%d.png", backend="reference")
    composite_video(scene, tmp_path / "one_%d.png", frames=(2, 3), backend="reference")
    last = [cv2.imread(str(tmp_path / name)) for name in ("all_2.png", "one_2.png")]
    assert last[0] is not None
    assert np.array_equal(*last)
    none = scene.model_copy(update={"draw": scene.draw.model_copy(update={"grain": 0.0})})
    composite_video(none, tmp_path / "none_%d.png", frames=(2, 3), backend="reference")
    plain = cv2.imread(str(tmp_path / "none_2.png"))
    assert np.mean(plain != last[0]) > 0.01


def test_the_plan_says_whether_grain_runs(tmp_path: Path, whale: Path) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), np.full((64, 128, 3), 90, np.uint8))
    assert "grain        runs     objects get 50 % of the plate's grain" in explain_plan(
        scene_of(tmp_path, whale, 0.5), "reference"
    )
    assert "skipped  draw.grain is 0" in explain_plan(scene_of(tmp_path, whale, 0.0), "reference")
    nothing = scene_with(tmp_path, None, draw={"grain": 1.0})
    assert "skipped  nothing to cover" in explain_plan(nothing, "reference")
