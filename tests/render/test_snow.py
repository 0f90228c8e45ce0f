# SPDX-License-Identifier: Apache-2.0
"""Marine snow in frames: both renderers, frames alone and in a batch, motion blur, scenes without objects."""

from __future__ import annotations

import functools
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import Backend, Frame, composite_frame, make_backend
from mr360uw.render.loaded import Loaded, load
from mr360uw.video import VideoFrame
from tests.scenes import BACKENDS, gradient_plate, scene_with
from tests.tolerances import AGREEMENT_CODE, AGREEMENT_FRACTION

SNOW = {
    "amount": 0.3, "exponent": 2.5, "sizes_mm": [10.0, 40.0], "range_m": 5.0,
    "current_m_s": [0.4, 0.1, 0.2],
}  # fmt: skip
WIDTH = 128


def loaded_with(folder: Path, mesh: Path | None, **snow: Any) -> Loaded:
    scene = scene_with(
        folder, mesh, snow=SNOW | snow, receiver={"height_m": -1.5},
        draw={"samples": 5, "ambient_occlusion": False, "sun_samples": 4},
        caustics={"size": 64, "grid": 64, "planes": 2},
        **({} if mesh is not None else {"object": []}),
    )  # fmt: skip
    return load(scene, WIDTH, WIDTH // 2, clip=False)


@functools.cache
def plate(index: int) -> VideoFrame:
    return VideoFrame.of_linear(gradient_plate(WIDTH, WIDTH // 2), index, index / 24.0)


def frame(loaded: Loaded, backend: Backend, index: int, shutter_s: float = 0.02, cache: Cache | None = None) -> Frame:
    return composite_frame(loaded, ClipAnalysis(), backend, plate(index), shutter_s, cache=cache)


@pytest.mark.parametrize("name", BACKENDS)
def test_a_frame_is_the_same_alone_and_after_others(name: str, tmp_path: Path, whale: Path) -> None:
    loaded = loaded_with(tmp_path, whale)
    backend = make_backend(name)[0]
    batch = [frame(loaded, backend, index) for index in (0, 3)]
    alone = frame(loaded, make_backend(name)[0] if name == "reference" else backend, 3)
    np.testing.assert_array_equal(batch[-1].picture.image_linear, alone.picture.image_linear)
    assert np.any(batch[0].layer.alpha != batch[1].layer.alpha)


def test_the_renderers_agree_and_snow_is_before_and_behind_the_body(tmp_path: Path, whale: Path) -> None:
    loaded = loaded_with(tmp_path, whale)
    pictures = []
    for name in BACKENDS:
        backend = make_backend(name)[0]
        pictures.append(frame(loaded, backend, 2))
        bare = frame(replace(loaded, plan=replace(loaded.plan, snow=replace(loaded.plan.snow, runs=False))), backend, 2)
        body = bare.layer.alpha > 0.5
        assert 0.0 < np.mean(np.any(bare.layer.radiance != pictures[-1].layer.radiance, axis=-1)[body]) < 1.0
        np.testing.assert_array_equal(bare.layer.distance_m, pictures[-1].layer.distance_m)
        np.testing.assert_array_equal(bare.layer.ratio, pictures[-1].layer.ratio)
    one, other = (np.clip(f.picture.image_linear, 0.0, 1.0) ** (1.0 / 2.2) * 255.0 for f in pictures)
    assert np.mean(np.abs(one - other) < AGREEMENT_CODE) >= AGREEMENT_FRACTION


def test_kept_layers_follow_the_snow_s_settings(tmp_path: Path, whale: Path) -> None:
    backend, cache = make_backend("reference")[0], Cache()
    first = frame(loaded_with(tmp_path, whale), backend, 0, cache=cache)
    loaded = loaded_with(tmp_path, whale)
    frame(loaded, backend, 0, cache=cache)
    again = frame(loaded, backend, 0, cache=cache)
    np.testing.assert_array_equal(first.layer.alpha, again.layer.alpha)
    brighter = replace(
        loaded, scene=loaded.scene.model_copy(update={"snow": loaded.scene.snow.model_copy(update={"albedo": 1.0})})
    )
    bright = frame(brighter, backend, 0, cache=cache)
    assert bright.layer.radiance.sum() > first.layer.radiance.sum()


@pytest.mark.parametrize("name", BACKENDS)
def test_snow_alone_is_a_scene(name: str, tmp_path: Path) -> None:
    loaded = loaded_with(tmp_path, None)
    assert loaded.plan.snow.runs
    assert "in a cubic metre" in loaded.plan.snow.why
    assert frame(loaded, make_backend(name)[0], 0).layer.alpha.max() > 0.1


def test_the_shutter_draws_particles_out_without_changing_their_light(tmp_path: Path) -> None:
    loaded, backend = (
        loaded_with(tmp_path, None, amount=0.2, current_m_s=[8.0, 0.0, 0.0]),
        make_backend("reference")[0],
    )
    sharp, drawn_out = (frame(loaded, backend, 0, shutter_s).layer.alpha for shutter_s in (0.0, 0.04))
    assert drawn_out.max() < 0.8 * sharp.max()
    weight = np.cos(np.pi * (0.5 - (np.arange(WIDTH // 2) + 0.5) / (WIDTH // 2)))[:, None]
    whole = float(np.sum(sharp * weight))
    assert float(np.sum(drawn_out * weight)) == pytest.approx(whole, rel=0.05)  # particles overlap and cross the floor


@pytest.mark.parametrize(
    ("tables", "why"),
    [
        ({}, "amount is 0"),
        ({"snow": {"amount": 1.0}, "water": {"type": "none"}}, 'water is "none"'),
        ({"snow": {"amount": 1.0}, "water": {"type": "pure"}}, "no particles"),
    ],
)  # fmt: skip
def test_scenes_without_snow_say_why_and_pay_nothing(
    tables: dict[str, Any], why: str, tmp_path: Path, whale: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load(scene_with(tmp_path, whale, **tables), WIDTH, WIDTH // 2, clip=False)
    assert not loaded.plan.snow.runs
    assert why in loaded.plan.snow.why
    monkeypatch.setitem(sys.modules, "mr360uw.composite.snow", None)  # importing it would fail
    assert frame(loaded, make_backend("reference")[0], 0).layer.tiles


def test_snow_that_is_not_seen_or_takes_long_is_noted(tmp_path: Path) -> None:
    def notes(**snow: Any) -> str:
        return "; ".join(load(scene_with(tmp_path, None, snow={"amount": 1.0} | snow), 2048, 1024).notes)

    assert "shows none" in notes(amount=1e-6)
    assert "s a frame" in notes(amount=1000.0)
    assert "snow" not in notes()
