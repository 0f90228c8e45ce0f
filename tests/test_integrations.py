# SPDX-License-Identifier: Apache-2.0
"""The files for other programs: their arithmetic, without these programs."""

from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.scene.model import scene_from_dict
from tests.tolerances import FLOAT64

FOLDER = Path(__file__).resolve().parents[1] / "integrations"
DEGREES, METRES = 1e-4, 1e-5
"""The scene file has 4 and 5 digits."""


def loaded(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_angles_undo_the_scene_s_rotation(rng: np.random.Generator) -> None:
    blender = loaded("blender_mr360uw")
    for given in [*rng.uniform([-179, -89, -179], [179, 89, 179], (20, 3)), (30.0, 90.0, 0.0), (-50.0, -90.0, 0.0)]:
        matrix = rotation_matrix(given)
        np.testing.assert_allclose(rotation_matrix(blender.angles(matrix)), matrix, atol=1e6 * FLOAT64)


def test_objects_of_blender_stand_where_they_stood(rng: np.random.Generator) -> None:
    """A point of the mesh, through Blender's world and through the scene's, is at one place seen from the camera."""
    blender = loaded("blender_mr360uw")
    turn = rotation_matrix([20.0, 30.0, -50.0])
    world = rigid([2.0, 6.0, 0.5], turn * np.array([1.0, 2.0, 0.5]))
    looking = np.array([[1.0, 0.0, 0.0], [0.0, 0.2, -0.98], [0.0, 0.98, 0.2]])  # camera's axes: tilted, along +y
    camera = rigid([1.0, 2.0, 0.5], looking)
    position, rotation = blender.pose(world, camera)
    points = rng.normal(size=(10, 3))
    in_blender = points @ world[:3, :3].T + world[:3, 3] - camera[:3, 3]
    seen = np.stack([in_blender[:, 0], in_blender[:, 2], -in_blender[:, 1]], axis=1)  # right, up, back
    sized = points * np.array([1.0, 2.0, 0.5])
    in_file = np.stack([sized[:, 0], sized[:, 2], -sized[:, 1]], axis=1)  # glTF, y up
    placed = rigid(position, rotation_matrix(rotation))
    np.testing.assert_allclose(in_file @ placed[:3, :3].T + placed[:3, 3], seen, atol=2 * METRES)


def test_the_scene_from_blender_is_one(tmp_path: Path) -> None:
    blender = loaded("blender_mr360uw")
    still = [(0.0, [0.0, 0.0, -3.0], [0.0, 0.0, 0.0])] * 2
    moving = [(0.0, [0.0, 0.0, -3.0], [0.0, 0.0, 0.0]), (1.0, [1.0, 0.0, -3.0], [9.0, 0.0, 0.0])]
    text = blender.toml_of("dive.mp4", [("a.glb", still), ("b.glb", moving)])
    for name in ("dive.mp4", "a.glb", "b.glb"):
        (tmp_path / name).touch()
    one, other = scene_from_dict(tomllib.loads(text), tmp_path).objects
    assert not one.key
    assert other.key[1].position_m == (1.0, 0.0, -3.0)
    assert blender.KEYS_PER_S == 10.0


def test_a_camera_that_looks_down_is_refused() -> None:
    with pytest.raises(SystemExit, match="turn it"):
        loaded("blender_mr360uw").pose(np.eye(4), np.eye(4))


class Nodes:
    """Nuke's nodes as pictures: each returns what it shows for the arrays of `files`."""

    def __init__(self, files: dict[str, dict[str, Any]]) -> None:
        self.files = files

    def Read(self, file: str, **_: Any) -> dict[str, Any]:
        return self.files[file]

    def Shuffle(self, inputs: list[Any], **knobs: Any) -> dict[str, Any]:
        return {"rgb": inputs[0][knobs["in"]], "alpha": np.zeros(1)}

    def Grade(self, inputs: list[Any], **_: Any) -> dict[str, Any]:
        return inputs[0]

    def Copy(self, inputs: list[Any], **_: Any) -> dict[str, Any]:
        return {"rgb": inputs[0]["rgb"], "alpha": inputs[1]["alpha"]}

    def Merge2(self, inputs: list[Any], operation: str, **_: Any) -> dict[str, Any]:
        below, above = inputs
        kept = 1.0 - above["alpha"] if operation == "over" else 1.0
        return {"rgb": above["rgb"] + kept * below["rgb"], "alpha": above["alpha"] + kept * below["alpha"]}


def test_the_tree_of_nuke_is_the_composite(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its nodes, evaluated by their definitions on random numbers, give the formula of the layers."""
    script = loaded("nuke_mr360uw")
    parts = {name: rng.random(3) for name in script.PARTS}
    layers = {**parts, "receiver_difference": rng.normal(size=3), "alpha": rng.random(1)}
    plate = {"rgb": rng.random(3), "alpha": np.zeros(1)}
    nuke = ModuleType("nuke")
    nuke.nodes = Nodes({"plate": plate, "layers": layers})  # type: ignore[attr-defined]
    monkeypatch.setitem(__import__("sys").modules, "nuke", nuke)
    made = script.build("plate", "layers", 0, 1)
    expected = sum(parts.values()) + (1 - layers["alpha"]) * (plate["rgb"] + layers["receiver_difference"])
    np.testing.assert_allclose(made["rgb"], expected, atol=FLOAT64)
