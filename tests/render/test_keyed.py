# SPDX-License-Identifier: Apache-2.0
"""Clips whose parameters change over time: each frame is that of the scene with the values of its time."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.color import encode
from mr360uw.errors import SceneError
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import Backend, Frame, composite_frame, make_backend
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.plan import joined_plan
from mr360uw.runs.pipeline import export_caustics
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import scene_at
from mr360uw.video import VideoFrame
from tests.scenes import BACKENDS, gradient_plate, scene_with
from tests.tolerances import RENDERERS_PSNR_DB

SIZE = (128, 64)
DRAW = {"samples": 1, "sun_samples": 1, "ambient_occlusion": False}
TIMES = (0.0, 0.7, 2.5)


def keys(*rows: tuple[str, list[Any]]) -> list[dict[str, Any]]:
    """Return keys at 0 and 2 s."""
    return [{"parameter": name, "time_s": [0, 2], "value": value} for name, value in rows]


ALL = keys(
    ("object.0.position_m", [[0.3, -0.4, -3.0], [0.6, -0.2, -2.5]]),
    ("object.0.base_color", [[1, 1, 1], [1, 0.5, 0.2]]),
    ("light.sun_azimuth_deg", [350, 30]),
    ("receiver.height_m", [-1.8, -1.4]),
    ("sea.wind_speed", [2, 7]),
    ("sea.wind_direction_deg", [350, 30]),
    ("sea.detail_slope", [0.05, 0.2]),
    ("water.gain", [[1, 1, 1], [0.5, 1, 1]]),
    ("water.sun_share", [0.3, 0.5]),
    ("lamp.0.lumen", [500, 4000]),
    ("draw.grain", [0, 0.5]),
)


def scene_of(folder: Path, mesh: Path, entries: list[dict[str, Any]], **changed: Any) -> Scene:
    tables = {
        "object": [{"mesh": str(mesh), "base_color": [1, 1, 1], "position_m": [0.3, -0.4, -3.0]}],
        "receiver": {"height_m": -1.6, "occlusion": False},
        "light": {"sun": "given"},
        "lamp": [{"attach": "camera", "casts_shadow": False}],
        "water": {"mode": "kd"},
        "caustics": {"size": 64, "grid": 32},
        "draw": DRAW,
    }
    return scene_with(folder, None, keys=entries, **(tables | changed))


def frame(loaded: Loaded, backend: Backend, time_s: float, shutter_s: float = 0.0) -> Frame:
    plate = VideoFrame.of_linear(gradient_plate(*SIZE), 0, time_s)
    return composite_frame(loaded, ClipAnalysis(), backend, plate, shutter_s)


def picture(loaded: Loaded, backend: Backend, time_s: float, shutter_s: float = 0.0) -> np.ndarray:
    return np.asarray(frame(loaded, backend, time_s, shutter_s).picture.image_linear)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory, whale: Path) -> Scene:
    return scene_of(tmp_path_factory.mktemp("clip"), whale, ALL)


@pytest.fixture(scope="module")
def pictures(clip: Scene) -> dict[str, list[np.ndarray]]:
    """The frames of the clip by each renderer, one after the other."""
    loaded = {name: (load(clip, *SIZE), make_backend(name)[0]) for name in BACKENDS}
    return {name: [picture(*one, time_s) for time_s in TIMES] for name, one in loaded.items()}


@pytest.mark.parametrize("name", BACKENDS)
def test_a_keyed_clip_is_the_stills_of_its_values(
    clip: Scene, pictures: dict[str, list[np.ndarray]], name: str
) -> None:
    """By one renderer in the order of the clip, and each alone by a fresh one."""
    for time_s, one in zip(TIMES, pictures[name], strict=True):
        still = load(scene_at(clip, time_s), *SIZE)
        np.testing.assert_array_equal(one, picture(still, make_backend(name)[0], time_s))
    assert not np.array_equal(pictures[name][0], pictures[name][1])


def test_both_renderers_make_the_same_of_keys(pictures: dict[str, list[np.ndarray]]) -> None:
    for one, other in zip(*pictures.values(), strict=True):
        difference = 255.0 * (encode(one, "srgb") - encode(other, "srgb"))
        assert 20.0 * np.log10(255.0 / np.sqrt(np.mean(difference**2))) >= RENDERERS_PSNR_DB


def test_a_frame_is_the_same_whatever_came_before(clip: Scene, pictures: dict[str, list[np.ndarray]]) -> None:
    loaded, backend = load(clip, *SIZE), make_backend("reference")[0]
    back = [picture(loaded, backend, time_s) for time_s in reversed(TIMES)]
    np.testing.assert_array_equal(pictures["reference"], back[::-1])


def test_an_object_moves_within_the_exposure(tmp_path: Path, whale: Path) -> None:
    """As the object's own keys move it; water and light are those of the frame."""
    draw, straight = DRAW | {"motion_samples": 4}, [[0.0, -0.4, -3.0], [1.0, -0.4, -3.0]]
    entries = [{"parameter": "object.0.position_m", "time_s": [0, 2], "value": straight}]
    loaded = load(scene_of(tmp_path, whale, entries, draw=draw), *SIZE)
    own = [{"time_s": t, "position_m": place} for t, place in zip((0.0, 2.0), straight, strict=True)]
    moving = {"mesh": str(whale), "base_color": [1, 1, 1], "key": own, "interpolation": "linear"}
    expected = load(scene_of(tmp_path, whale, [], draw=draw, object=[moving]), *SIZE)
    backend = make_backend("reference")[0]
    blurred = picture(loaded, backend, 1.0, 0.5)
    np.testing.assert_allclose(blurred, picture(expected, backend, 1.0, 0.5), atol=1e-6)  # float32, other plans
    assert np.abs(blurred - picture(loaded, backend, 1.0)).max() > 1e-3


def test_a_stage_runs_if_it_runs_at_any_key(tmp_path: Path, whale: Path) -> None:
    still = load(scene_of(tmp_path, whale, []), *SIZE).plan
    assert not still.grain.runs
    loaded = load(scene_of(tmp_path, whale, keys(("draw.grain", [0, 0.5]))), *SIZE)
    assert loaded.plan.grain.runs
    assert joined_plan([still, loaded.plan]).grain == loaded.plan.grain
    assert loaded.plan.stages | {"grain": still.grain} == still.stages
    moving = load(scene_of(tmp_path, whale, keys(("object.0.scale", [1, 2]))), *SIZE)
    assert "objects move" in str(moving.plan)
    assert "objects stand still" in str(loaded.plan)


def test_notes_are_those_of_all_keys(tmp_path: Path, whale: Path) -> None:
    far = keys(("object.0.position_m", [[0.0, 0.0, -3.0], [0.0, 9.0, -3.0]]))
    (note,) = load(scene_of(tmp_path, whale, far), *SIZE).notes
    assert re.search(r"above the water's surface", note)


def test_a_keyed_sea_is_not_exported_as_tiles(tmp_path: Path, whale: Path) -> None:
    scene = scene_of(tmp_path, whale, keys(("sea.wind_speed", [2, 6])))
    with pytest.raises(SceneError, match=r"a sea that changes does not repeat, as tiles do \(got sea.wind_speed\)"):
        export_caustics(scene, tmp_path / "tiles")
    assert not (tmp_path / "tiles").exists()
