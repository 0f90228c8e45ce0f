# SPDX-License-Identifier: Apache-2.0
"""The files for other programs: their arithmetic without these programs, and what Blender makes where it is there."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import OpenEXR
import pytest
import trimesh

import mr360uw as uw
from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.scene.model import scene_from_dict
from mr360uw.video.exr import write_exr
from tests.scenes import gradient_plate, scene_with
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
    assert script.PARTS == loaded("blender_layers").PARTS
    parts = {name: rng.random(3) for name in script.PARTS}
    layers = {**parts, "receiver_difference": rng.normal(size=3), "alpha": rng.random(1)}
    plate = {"rgb": rng.random(3), "alpha": np.zeros(1)}
    nuke = ModuleType("nuke")
    nuke.nodes = Nodes({"plate": plate, "layers": layers})  # type: ignore[attr-defined]
    monkeypatch.setitem(__import__("sys").modules, "nuke", nuke)
    made = script.build("plate", "layers", 0, 1)
    expected = sum(parts.values()) + (1 - layers["alpha"]) * (plate["rgb"] + layers["receiver_difference"])
    np.testing.assert_allclose(made["rgb"], expected, atol=FLOAT64)


MATTE = """
import sys, bpy
tree = bpy.data.node_groups.new("matte", "CompositorNodeTree")
tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
node, out = tree.nodes.new("CompositorNodeCryptomatteV2"), tree.nodes.new("NodeGroupOutput")
node.source, node.image = "IMAGE", bpy.data.images.load(sys.argv[1])
node.layer_name, node.matte_id = "CryptoObject", "ball"
tree.links.new(node.outputs["Matte"], out.inputs[0])
scene = bpy.context.scene
scene.compositing_node_group, scene.render.engine, scene.render.filepath = tree, "CYCLES", sys.argv[2]
scene.render.resolution_x, scene.render.resolution_y = 128, 64
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
bpy.ops.render.render(write_still=True)
"""


@pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="needs bpy, Blender as a module")
def test_the_compositor_of_blender_makes_the_composite(tmp_path: Path) -> None:
    """Blender itself renders the tree from a plate and its layers, with a ball over the ground in snow."""
    for k in (1, 2):
        write_exr(tmp_path / f"plate_{k:04d}.exr", gradient_plate(128, 64) / k)
    trimesh.creation.icosphere(subdivisions=3, radius=0.8).export(tmp_path / "ball.glb")
    scene = scene_with(
        tmp_path, tmp_path / "ball.glb", rough=True, plate=str(tmp_path / "plate_%04d.exr"),
        receiver={"height_m": -1.5}, snow={"amount": 30.0},
    )  # fmt: skip
    made, layers = tmp_path / "made_%04d.exr", tmp_path / "layers_%04d.exr"
    uw.composite_video(scene, made, layers=layers)
    found = tmp_path / "over_"
    words = [tmp_path / "plate_0001.exr", layers, 1, 2, found]
    program = [sys.executable, FOLDER / "blender_layers.py", "--", *words]
    subprocess.run([str(word) for word in program], check=True, capture_output=True, cwd=tmp_path)
    for k in (1, 2):
        names = f"made_{k:04d}.exr", f"over_{k:04d}.exr"
        ours, theirs = (next(uw.open_video(tmp_path / name).frames()).image_linear for name in names)
        # half floats of ten parts, each off by 2^-11 of itself
        np.testing.assert_allclose(theirs, ours, atol=10 * 2.0**-11)
    words = [sys.executable, "-c", MATTE, tmp_path / "layers_0001.exr", tmp_path / "matte.exr"]
    subprocess.run([str(word) for word in words], check=True, capture_output=True)
    matte = next(uw.open_video(tmp_path / "matte.exr").frames()).image_linear[..., 0]
    part = {p.header["name"]: p for p in OpenEXR.File(str(tmp_path / "layers_0001.exr")).parts}["CryptoObject00"]
    manifest = next(text for name, text in part.header.items() if name.endswith("manifest") and "ball" in text)
    number, covered = part.channels["CryptoObject00"].pixels[..., 0], part.channels["CryptoObject00"].pixels[..., 1]
    of_ball = number.view(np.uint32) == int(json.loads(manifest)["ball"], 16)
    np.testing.assert_allclose(matte, np.where(of_ball, covered, 0.0), atol=2.0**-11)  # a half float, up to 1
    assert matte.max() == 1.0
