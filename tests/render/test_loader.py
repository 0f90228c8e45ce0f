# SPDX-License-Identifier: Apache-2.0
"""A scene that is changed and loaded again: what is made anew, and that it is what a fresh load gives."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import Loaded, Loader, load
from mr360uw.video import VideoFrame
from tests.scenes import gradient_plate, scene_with

SIZE = (128, 64)
DRAW = {"samples": 1, "sun_samples": 1, "ambient_occlusion": False}


def tables(mesh: Path, **changed: Any) -> dict[str, Any]:
    return {
        "object": [{"mesh": str(mesh), "position_m": [0.3, -0.4, -3.0]}, {"mesh": str(mesh), "scale": 0.3}],
        "receiver": {"height_m": -1.6},
        "draw": DRAW,
        "caustics": {"size": 64, "grid": 32, "planes": 2},
    } | changed


def picture(loaded: Loaded) -> np.ndarray:
    plate = VideoFrame.of_linear(gradient_plate(*SIZE), 0, 0.0)
    backend, _ = make_backend("reference")
    return np.asarray(composite_frame(loaded, ClipAnalysis(), backend, plate, 0.0).picture.image_linear)


def test_a_changed_scene_is_what_a_fresh_load_gives(tmp_path: Path, whale: Path, subtests: pytest.Subtests) -> None:
    loader = Loader(*SIZE, clip=False)
    for changed in (
        {}, {"sea": {"wind_speed": 7.0}}, {"draw": DRAW | {"grain": 0.5}}, {"light": {"peak": 9.0}},
        {"water": {"type": "II"}}, {"camera": {"depth_m": 3.0}}, {"receiver": {"height_m": -1.2}},
        {"lamp": [{"attach": "camera"}]},
    ):  # fmt: skip
        scene = scene_with(tmp_path, None, rough=True, **tables(whale, **changed))
        with subtests.test(str(changed)):
            np.testing.assert_array_equal(picture(loader.load(scene)), picture(load(scene, *SIZE, clip=False)))


def test_an_object_that_is_moved_keeps_its_mesh(tmp_path: Path, whale: Path) -> None:
    loader = Loader(*SIZE, clip=False)
    first, second = loader.load(scene_with(tmp_path, None, rough=True, **tables(whale))).objects
    moved = [{"mesh": str(whale), "position_m": [1.0, 0.0, -3.0]}, {"mesh": str(whale), "scale": 0.3}]
    there, other = loader.load(scene_with(tmp_path, None, rough=True, **tables(whale, object=moved))).objects
    assert there.settings.position_m == (1.0, 0.0, -3.0)
    assert there.meshes[0] is first.meshes[0] is second.meshes[0]
    assert other is second


def test_a_file_that_changes_is_read_again(tmp_path: Path, whale: Path) -> None:
    mesh = tmp_path / "fish.glb"
    shutil.copy(whale, mesh)
    loader, scene = Loader(*SIZE, clip=False), scene_with(tmp_path, None, rough=True, **tables(mesh))
    before = loader.load(scene)
    assert loader.load(scene).objects[0] is before.objects[0]
    stamp = mesh.stat()
    os.utime(mesh, ns=(stamp.st_atime_ns, stamp.st_mtime_ns + 1))
    after = loader.load(scene)
    assert after.objects[0] is not before.objects[0]
    assert after.object_files == before.object_files == (mesh,)


@pytest.mark.parametrize(
    ("lamp", "noted"),
    [
        ({"position_m": [0.0, 0.0, 0.0]}, False),  # straight ahead, at the whale
        ({"position_m": [0.0, 0.0, 0.0], "rotation_deg": [180.0, 60.0, 0.0]}, True),  # up and back
        ({"position_m": [0.0, 0.0, 0.0], "rotation_deg": [0.0, -90.0, 0.0]}, False),  # down, at the floor
        ({"position_m": [0.0, 0.0, 0.0], "rotation_deg": [180.0, 0.0, 0.0], "cone_deg": 360.0}, False),
        ({"position_m": [0.0, 0.0, 0.0], "rotation_deg": [180.0, 0.0, 0.0]}, False),  # back, at the floor there
        ({"position_m": [0.0, 0.0, 60.0], "cone_deg": 5.0, "lumen": 100.0}, True),  # too far
        ({"position_m": [0.0, 0.0, 0.0], "lumen": 0.01}, True),
        ({"position_m": [0.0, 0.0, 0.0], "rotation_deg": [180.0, 60.0, 0.0], "attach": "camera"}, True),
        ({"position_m": [0.0, 0.0, 2.0], "attach": 0}, False),
    ],
)
def test_a_lamp_that_reaches_nothing_is_noted(tmp_path: Path, whale: Path, lamp: dict[str, Any], noted: bool) -> None:
    scene = scene_with(tmp_path, whale, lamp=[lamp], receiver={"height_m": -1.6})
    notes = [note for note in load(scene, *SIZE, clip=False).notes if note.startswith("lamp[0]")]
    assert bool(notes) == noted
    assert all("lights no object and no floor" in note for note in notes)
