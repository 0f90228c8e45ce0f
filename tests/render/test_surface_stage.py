# SPDX-License-Identifier: Apache-2.0
"""Bodies at the surface in frames: both renderers, frames alone and in a batch, scenes without any."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import Backend, Frame, composite_frame, make_backend
from mr360uw.render.loaded import Loaded, load
from mr360uw.video import VideoFrame
from tests.scenes import BACKENDS, gradient_plate, scene_with
from tests.tolerances import AGREEMENT_CODE, AGREEMENT_FRACTION

WIDTH = 64
AFLOAT = {"attach": "surface", "position_m": [0.5, 0.0, -3.0], "rotation_deg": [-60.0, 0.0, 0.0]}
BELOW = {"position_m": [-1.0, 1.4, -3.5], "rotation_deg": [70.0, 0.0, 0.0]}


def loaded_with(folder: Path, mesh: Path, *objects: dict[str, Any], **tables: Any) -> Loaded:
    quick = {
        "draw": {"samples": 5, "ambient_occlusion": False, "sun_samples": 4}, "camera": {"depth_m": 2.0},
        "caustics": {"enabled": False}, "shafts": {"mode": "off"},
        "sea": {"wave_count": 6, "shortest_wavelength_m": 1.0},
    }  # fmt: skip
    bodies = [{"mesh": str(mesh), **one} for one in objects]
    return load(scene_with(folder, None, object=bodies, **quick | tables), WIDTH, WIDTH // 2, clip=False)


@functools.cache
def plate(index: int) -> VideoFrame:
    return VideoFrame.of_linear(gradient_plate(WIDTH, WIDTH // 2), index, index / 24.0)


def frame(loaded: Loaded, backend: Backend, index: int) -> Frame:
    return composite_frame(loaded, ClipAnalysis(), backend, plate(index), 0.0)


def test_the_renderers_agree_and_frames_are_the_same_alone_and_after_others(tmp_path: Path, whale: Path) -> None:
    loaded = loaded_with(tmp_path, whale, AFLOAT, BELOW)
    assert loaded.plan.surface.runs
    pictures = []
    for name in BACKENDS:
        backend = make_backend(name)[0]
        first, later = frame(loaded, backend, 0), frame(loaded, backend, 3)
        assert np.any(first.layer.alpha != later.layer.alpha)
        alone = frame(loaded, make_backend(name)[0] if name == "reference" else backend, 3)
        np.testing.assert_array_equal(alone.layer.radiance, later.layer.radiance)
        pictures.append(255.0 * np.clip(later.picture.image_linear, 0.0, 1.0) ** (1.0 / 2.2))
    apart = np.abs(pictures[0] - pictures[1]).max(axis=-1)
    assert np.mean(apart <= AGREEMENT_CODE) >= AGREEMENT_FRACTION


@pytest.mark.parametrize(
    ("body", "tables", "why"),
    [
        ({**BELOW, "position_m": [0.0, -3.0, -3.0]}, {}, "no object comes within 3 m"),
        (BELOW, {"surface": {"objects": "none"}}, "switched off"),
        (BELOW, {"water": {"type": "none"}}, "water is"),
        (
            {**BELOW, "position_m": [0.0, -30.0, -3.0]},
            {"surface": {"objects": "all"}, "water": {"type": "9C"}},
            "leaves",
        ),
    ],
)
def test_a_scene_without_bodies_at_the_surface_skips_it_and_says_why(
    body: dict[str, Any], tables: dict[str, Any], why: str, tmp_path: Path, whale: Path
) -> None:
    stage = loaded_with(tmp_path, whale, body, **tables).plan.surface
    assert not stage.runs
    assert why in stage.why


def test_mirror_images_of_what_is_wholly_under_water_are_not_drawn_for_both_eyes(tmp_path: Path, whale: Path) -> None:
    under, plate = {**BELOW, "position_m": [-1.0, 0.5, -3.5]}, str(tmp_path / "plate.png")
    assert loaded_with(tmp_path, whale, under).plan.surface.runs
    stage = loaded_with(tmp_path, whale, under, plate={"path": plate, "eye": "both"}).plan.surface
    assert not stage.runs
    assert "both eyes" in stage.why


def test_a_body_that_is_not_near_leaves_the_frame_as_it_is(tmp_path: Path, whale: Path) -> None:
    rising = {**BELOW, "key": [{"time_s": 0.0, "position_m": [0.0, -4.0, -3.0]}, {"time_s": 9.0}]}
    backend = make_backend("reference")[0]
    runs, never = (loaded_with(tmp_path, whale, rising, surface={"objects": objects}) for objects in ("auto", "none"))
    assert runs.plan.surface.runs
    np.testing.assert_array_equal(
        frame(runs, backend, 0).picture.image_linear, frame(never, backend, 0).picture.image_linear
    )


def test_floating_objects_move_and_lamps_may_go_with_them(tmp_path: Path, whale: Path) -> None:
    loaded = loaded_with(tmp_path, whale, AFLOAT)
    floating = loaded.objects[0]
    assert loaded.moves
    assert floating.moves
    poses = [floating.at(t, 0, np.zeros(3), np.eye(3)).world_from_object for t in (0.0, 1.0)]
    assert np.any(poses[0] != poses[1])
    for pose in poses:
        assert abs(pose[1, 3] - 2.0) < 0.5  # at the mean surface, 2 m over the camera
    np.testing.assert_allclose(poses[0][:3, 3] - floating.lifted(poses[0][:3, 3], 0.0), AFLOAT["position_m"], atol=1e-9)
