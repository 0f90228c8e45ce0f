# SPDX-License-Identifier: Apache-2.0
"""Scenes whose objects play their animation: pictures, shadows, motion blur, and both renderers."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import mr360uw as uw
from mr360uw.base.cache import Cache
from mr360uw.cli import app
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.motion import load_rig
from mr360uw.composite.reference import render_layer
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import Receiver, Shot, load_object
from mr360uw.composite.tiles import over
from mr360uw.render.loaded import load
from mr360uw.types import Layer
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile, one_square, swimming
from tests.composite.scenes import codes, medium, plate, shot
from tests.scenes import gradient_plate, scene_with

OBJECT: dict[str, Any] = {"position_m": [-0.8, -0.3, -2.0]}
LIT = {"light": {"sun": "given", "sun_azimuth_deg": 30.0, "sun_elevation_deg": 70.0}}


def fish_at(folder: Path, time_s: float, width: int = 128, **more: Any) -> Shot:
    path = swimming(17, 12, 3, degrees=80.0).write(folder / "fish.glb")
    placed = load_object(ObjectSettings(mesh=path, **OBJECT)).at(time_s, 0, np.zeros(3), np.eye(3))
    return shot(placed, width=width, receiver=Receiver(plane_y=-1.2), **more)


def centroid(layer: Layer) -> np.ndarray:
    """Return the mean column and row of what is darker on the ground."""
    dark = np.maximum(1.0 - layer.ratio.mean(axis=-1), 0.0)
    row, column = np.indices(dark.shape)
    return np.array([np.sum(dark * column), np.sum(dark * row)]) / dark.sum()


@pytest.mark.usefixtures("gl")
def test_both_renderers_draw_the_same_poses(tmp_path: Path) -> None:
    renderer, ground = LayerRenderer(), plate(128)
    for time_s in (0.2, 0.7):
        scene = fish_at(tmp_path, time_s, medium=medium())
        expected, got = render_layer(scene), renderer.render(scene)
        difference = np.abs(codes(over(ground, got)) - codes(over(ground, expected)))
        assert 20.0 * np.log10(255.0 / np.sqrt(np.mean(difference**2))) >= tol.RENDERERS_PSNR_DB
        assert np.mean(difference.max(axis=-1) <= tol.RENDERERS_CODES) >= tol.RENDERERS_FRACTION
        # what is kept of the pose before leaves no trace
        fresh = LayerRenderer().render(scene)
        np.testing.assert_array_equal(got.radiance, fresh.radiance)
        np.testing.assert_array_equal(got.ratio, fresh.ratio)


@pytest.mark.usefixtures("gl")
def test_cut_outs_move_with_their_mesh(tmp_path: Path) -> None:
    """A fin cut out by alpha, on both renderers, at two times."""
    file = GltfFile()
    image = np.full((8, 8, 4), 200, np.uint8)
    image[:, :4, 3] = 0
    base = {"baseColorTexture": {"index": file.texture(image)}}
    file.tree["materials"] = [{"pbrMetallicRoughness": base, "alphaMode": "MASK", "doubleSided": True}]
    file.mesh(file.square(material=0))
    file.clip((0, "translation", [0.0, 1.0], [[-1.0, 0, 0], [0.5, 0, 0]]))
    placed = load_object(ObjectSettings(mesh=file.write(tmp_path / "fin.glb"), position_m=(0, 0, -1.5)))
    renderer = LayerRenderer()
    for time_s in (0.0, 0.9):
        scene = shot(placed.at(time_s, 0, np.zeros(3), np.eye(3)))
        expected, got = render_layer(scene).alpha, renderer.render(scene).alpha
        assert 0.0 < expected.mean() < 0.2
        np.testing.assert_allclose(got.mean(), expected.mean(), atol=tol.ALPHA)
        assert np.mean(np.abs(got - expected) > tol.ALPHA) <= 1.0 - tol.RENDERERS_FRACTION


def test_the_shadow_moves(tmp_path: Path, backend: str) -> None:
    render = render_layer if backend == "reference" else LayerRenderer().render
    first, second, again = (centroid(render(fish_at(tmp_path, time_s))) for time_s in (0.25, 0.75, 1.25))
    assert np.linalg.norm(second - first) > 0.5
    assert np.linalg.norm(again - first) < 0.01  # a second later it is there again


@pytest.mark.usefixtures("gl")
def test_poses_take_little_of_the_device(tmp_path: Path) -> None:
    """Poses of one mesh share its textures, and old ones are let go."""
    cache = Cache()
    renderer = LayerRenderer(cache)
    rigged = load_object(ObjectSettings(mesh=swimming().write(tmp_path / "fish.glb"), **OBJECT))
    scenes = [shot(rigged.at(0.1 * k, 0, np.zeros(3), np.eye(3))) for k in range(3)]
    uploads = []
    for scene in (*scenes, scenes[2], scenes[0]):
        renderer.render(scene)
        uploads.append((cache.made["upload_still"], cache.made["upload_mesh"]))
    assert uploads == [(1, 1), (1, 2), (1, 3), (1, 3), (1, 4)]  # the last pose is there, the first was let go


def scene_of(folder: Path, file: GltfFile, **tables: Any) -> uw.Scene:
    path = file.write(folder / "moving.glb")
    table = OBJECT | tables.pop("object", {})
    return scene_with(folder, None, object=[{"mesh": str(path), **table}], **LIT, **tables)


def test_a_scene_plays_its_animation(tmp_path: Path, backend: str) -> None:
    scene, ground = scene_of(tmp_path, swimming()), gradient_plate(128, 64)
    pictures = [uw.render_frame(ground, scene, t, backend).layer.alpha for t in (0.0, 0.25, 1.25)]
    assert np.abs(pictures[1] - pictures[0]).max() > 0.5
    assert np.mean(np.abs(pictures[2] - pictures[1])) < tol.FLOAT32  # a second later it is there again
    still = scene_of(tmp_path, swimming(), object={"animation": ""})
    resting = [uw.render_frame(ground, still, t, backend).layer.alpha for t in (0.0, 0.25)]
    np.testing.assert_array_equal(*resting)


def test_motion_blur_is_the_mean_of_its_instants(tmp_path: Path) -> None:
    ground, shutter_s = gradient_plate(128, 64), 0.2
    blurred = scene_of(tmp_path, swimming(), draw={"motion_samples": 4})
    assert load(blurred, 128, 64).moves
    got = uw.render_frame(ground, blurred, 0.1, "reference", shutter_s=shutter_s).layer.alpha
    sharp = scene_of(tmp_path, swimming())
    times = 0.1 + shutter_s * (np.array([0.125, 0.375, 0.625, 0.875]) - 0.5)
    each = [uw.render_frame(ground, sharp, float(t), "reference").layer.alpha for t in times]
    np.testing.assert_allclose(got, np.mean(each, axis=0), atol=tol.FLOAT32)
    assert np.abs(got - each[0]).max() > 0.2


def test_the_scene_knows_how_far_a_clip_goes(tmp_path: Path) -> None:
    """A square that rises 4 m in its clip: the highest point, the caustics' depths and the notes take it in."""
    file = one_square()
    file.clip((0, "translation", [0.0, 1.0, 2.0], [[0.0, 0, 0], [0.0, 4.0, 0], [0.0, 0, 0]]))
    loaded = load(scene_of(tmp_path, file, camera={"depth_m": 5.0}), 128, 64)
    (placed,) = loaded.objects
    assert placed.highest_m(0.0) >= -0.3 + 4.0 + 1.0
    for time_s in np.linspace(0.0, 2.0, 9):
        view = loaded.view(float(time_s))
        mesh = placed.at(float(time_s), 0, view.position, view.world_from_camera)
        depth = 5.0 - mesh.to_world(mesh.mesh.positions)[..., 1]
        planes = loaded.caustic_depths.planes(Shot(view, (mesh,), shot().environment))
        assert planes[0] <= depth.min() + tol.FLOAT32
        assert planes[-1] >= depth.max() - tol.FLOAT32
    assert loaded.notes == ()
    high = {"object": {"position_m": [0.0, 6.0, -3.0]}, "camera": {"depth_m": 5.0}}
    assert any("wholly above" in note for note in load(scene_of(tmp_path, file, **high), 128, 64).notes)


def test_a_video_from_the_command_line(tmp_path: Path, dive: Any) -> None:
    """Frames 2 and 3 of a run of their own are those of the whole run, and differ by what swims."""
    swimming().write(tmp_path / "fish.glb")
    written: dict[str, list[np.ndarray]] = {}
    for name, animation, frames in (("whole", "swim", "0:4"), ("part", "swim", "2:4"), ("rest", "", "2:4")):
        scene = tmp_path / f"{name}.toml"
        table = (
            f'[[object]]\nmesh = "fish.glb"\nposition_m = [-0.8, -0.3, -2.0]\nanimation = "{animation}"\nspeed = 2.0\n'
        )
        coarse = "[water]\nbands = 8\n[caustics]\nsize = 64\ngrid = 32\nplanes = 2\n[draw]\nsamples = 5\n"
        scene.write_text(f'plate = "{dive.plate}"\n{coarse}{table}')
        out = tmp_path / f"{name}_%04d.png"
        command = ["composite", str(scene), str(out), "--frames", frames, "--backend", "reference"]
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 0, result.output
        written[name] = [cv2.imread(str(tmp_path / f"{name}_{k:04d}.png"), cv2.IMREAD_UNCHANGED) for k in (2, 3)]
    np.testing.assert_array_equal(written["part"], written["whole"])
    checked = CliRunner().invoke(app, ["check", str(tmp_path / "whole.toml"), "--backend", "reference"])
    assert "plays 'swim' of 1.00 s" in checked.output
    changes = [np.abs(one.astype(float) - other) for one, other in zip(written["part"], written["rest"], strict=True)]
    assert min(change.max() for change in changes) > 10.0
    assert np.abs(changes[1] - changes[0]).max() > 10.0


def test_an_unknown_animation_ends_the_run_with_its_names(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, swimming(), object={"animation": "fly"})
    with pytest.raises(uw.errors.MeshError, match="there are: 'swim'"):
        load(scene, 128, 64)


def test_parts_move_alone(tmp_path: Path) -> None:
    file = swimming()
    file.mesh(file.square(material=0))
    file.tree["nodes"] += [{"mesh": 1, "name": "sign"}]
    rig = load_rig(file.write(tmp_path / "two.glb"), part="sign")
    assert rig.rigging is not None
    assert [len(faces) for faces in rig.faces] == [2]
    assert len(rig.mesh.positions) == 2


def test_poses_go_with_their_rig_and_wait_for_no_garbage_collector(tmp_path: Path) -> None:
    gc.disable()
    try:
        rig = load_rig(swimming(5, 4, 3).write(tmp_path / "fish.glb"))
        clip = rig.clip(0)
        refs = [weakref.ref(mesh) for mesh in (rig.mesh, rig.at(clip, 0.3))]
        assert rig.bounds(clip).shape[1:] == (3, 3)
        assert rig.at(clip, 0.3) is refs[1]()  # kept while the rig is there
        del rig
        assert [ref() for ref in refs] == [None, None]
    finally:
        gc.enable()
