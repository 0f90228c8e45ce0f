# SPDX-License-Identifier: Apache-2.0
"""Animations of glTF files: what nodes, skins and morph targets do over time, and what is refused."""

from __future__ import annotations

import contextlib
import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.motion import looped, rigid
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import PlacedObject, SceneObject, load_object, load_objects
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile, one_square, swimming, tube, turned
from tests.composite.scenes import shot
from tests.composite.test_gltf import every_place
from tests.composite.test_materials import draw

EYE = np.zeros(3), np.eye(3)


def loaded(file: GltfFile, folder: Path, **more: Any) -> SceneObject:
    return load_object(ObjectSettings(mesh=file.write(folder / "moving.glb"), **more))


def mesh_at(placed: SceneObject, time_s: float) -> Mesh:
    return placed.at(time_s, 0, *EYE).mesh


def about_z(angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# --- what moves ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time_s", [0.0, 0.3, 1.0])
def test_a_bar_of_two_joints_bends_in_its_middle(tmp_path: Path, time_s: float) -> None:
    file = tube()
    file.clip((2, "rotation", [0.0, 1.0], turned([0.0, np.radians(80.0)])))
    placed = loaded(file, tmp_path, loop="once")
    rest, mesh = mesh_at(placed, 0.0).still, mesh_at(placed, time_s)
    turn = about_z(np.radians(80.0) * time_s)
    outer = rest.positions[..., :1] > 1.0 - tol.FLOAT32
    middle = np.array([1.0, 0.0, 0.0])
    expected = np.where(outer, (rest.positions - middle) @ turn.T + middle, rest.positions)
    np.testing.assert_allclose(mesh.positions, expected, atol=tol.FLOAT32)
    np.testing.assert_allclose(mesh.normals, np.where(outer, rest.normals @ turn.T, rest.normals), atol=tol.FLOAT32)
    # at rest the skin is where it was bound: the node that shows it is 50 m away and does not count
    assert rest.positions[..., 0].max() == pytest.approx(2.0, abs=tol.FLOAT32)
    assert mesh.uv is rest.uv
    assert mesh.materials is rest.materials


def test_weights_blend_between_joints(tmp_path: Path) -> None:
    file = tube(soft=True)
    file.clip((2, "translation", [0.0, 1.0], [[1.0, 0.0, 0.0], [1.0, 0.6, 0.0]]))
    placed = loaded(file, tmp_path, loop="once")
    rest, mesh = mesh_at(placed, 0.0).still, mesh_at(placed, 1.0)
    np.testing.assert_allclose(
        mesh.positions[..., 1], rest.positions[..., 1] + 0.6 * np.clip(rest.positions[..., 0], 0.0, 1.0),
        atol=tol.FLOAT32,
    )  # fmt: skip


def test_normals_follow_uneven_scales(tmp_path: Path) -> None:
    """A tube squashed along z: its normals are those of the ellipse, not the squashed ones."""
    file = tube()
    file.clip((1, "scale", [0.0], [[1.0, 1.0, 0.25]]))
    mesh = mesh_at(loaded(file, tmp_path), 0.0)
    side = np.abs(mesh.still.normals[..., 0]) < tol.FLOAT32
    normal = mesh.still.normals[side] / [1.0, 1.0, 0.25]
    np.testing.assert_allclose(
        mesh.normals[side], normal / np.linalg.norm(normal, axis=-1, keepdims=True), atol=tol.FLOAT32
    )


@pytest.mark.parametrize("opposite", [False, True])
def test_normals_stay_outside(tmp_path: Path, opposite: bool) -> None:
    """Of a mirrored skin, and of one whose halves are turned half round, so that their mean has no volume."""
    file = tube()
    if opposite:
        file.clip((2, "rotation", [0.0], [[1.0, 0.0, 0.0, 0.0]]))
    else:
        file.tree["nodes"][1]["scale"] = [1.0, 1.0, -1.0]
    mesh = mesh_at(loaded(file, tmp_path), 0.0)
    across = np.cross(mesh.positions[:, 1] - mesh.positions[:, 0], mesh.positions[:, 2] - mesh.positions[:, 0])
    straight = np.linalg.norm(np.ptp(mesh.normals, axis=1), axis=-1) < 1.0  # not between the halves
    assert np.count_nonzero(straight) > len(straight) / 2
    assert np.all(np.einsum("tk,tk->t", across, mesh.normals.mean(axis=1))[straight] > 0.0)


def morphing(**more: Any) -> GltfFile:
    file = GltfFile(materials=[{}])
    lifted, leant = np.tile([0.0, 0.0, 2.0], (4, 1)), np.tile([1.0, 0.0, 0.0], (4, 1))
    targets = [
        {"POSITION": file.accessor(lifted), "NORMAL": file.accessor(leant)}, {"POSITION": file.accessor(leant)}
    ]  # fmt: skip
    file.mesh(file.square(material=0, targets=targets), weights=[0.0, 1.0], **more)
    return file


def test_a_morph_target_at_half_weight(tmp_path: Path) -> None:
    file = morphing()
    file.clip((0, "weights", [0.0, 1.0], [[0.0, 0.0], [1.0, 0.5]]))
    placed = loaded(file, tmp_path, loop="once")
    mesh = mesh_at(placed, 0.5)
    np.testing.assert_allclose(mesh.positions[..., 2], 1.0)
    np.testing.assert_allclose(mesh.positions[..., 0].max(), 1.25)
    np.testing.assert_allclose(mesh.normals, np.broadcast_to([0.5, 0.0, 1.0], (2, 3, 3)) / np.sqrt(1.25))
    assert mesh.still.positions[..., 0].max() == 2.0  # at rest the mesh's own weights


def test_a_rigid_child_follows_its_parents(tmp_path: Path) -> None:
    file = GltfFile(materials=[{}])
    file.mesh(file.square(material=0))
    file.tree["nodes"] = [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "translation": [3, 0, 0]}, {"mesh": 0}]
    file.clip(
        (0, "translation", [0.0, 2.0], [[0.0, 0, 0], [0.0, 4.0, 0]]),
        (1, "rotation", [0.0, 2.0], turned([0.0, np.pi])),
    )
    mesh = mesh_at(loaded(file, tmp_path, loop="once"), 1.0)
    # a quarter turn about the child's origin, then 3 to the right, twice as large, 2 up
    corner = mesh.still.positions[2:]
    np.testing.assert_allclose(mesh.positions[:2], 2.0 * (corner @ about_z(np.pi / 2).T + [3, 0, 0]) + [0, 2, 0])
    np.testing.assert_array_equal(mesh.positions[2:], corner)


def test_flat_parts_stay_flat(tmp_path: Path) -> None:
    file = one_square(node={"scale": [1.0, 1.0, 1.0]})
    del file.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    file.clip((0, "rotation", [0.0], [[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]]))
    mesh = mesh_at(loaded(file, tmp_path), 0.0)
    np.testing.assert_allclose(mesh.normals, np.broadcast_to([0.0, -1.0, 0.0], (2, 3, 3)), atol=tol.FLOAT32)


# --- interpolation -------------------------------------------------------------------------------------------------


def test_new_normals_follow_the_joints(tmp_path: Path) -> None:
    """A tube that bends: its sides have the normals of its file, at rest and bent."""
    file, bare = tube(), tube()
    del bare.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    for one in (file, bare):
        one.clip((2, "rotation", [0.0, 1.0], turned([0.0, np.pi / 3])))
    own = loaded(file, tmp_path)
    new = load_object(ObjectSettings(mesh=bare.write(tmp_path / "bare.glb"), smooth_deg=60.0))
    sides = slice(0, 8 * 8 * 2)
    for time_s in (0.0, 0.75):
        posed, expected = mesh_at(new, time_s), mesh_at(own, time_s)
        np.testing.assert_allclose(posed.positions, expected.positions, atol=tol.FLOAT64)
        np.testing.assert_allclose(posed.normals[sides], expected.normals[sides], atol=tol.FLOAT32)
    assert not np.allclose(mesh_at(new, 0.75).normals, mesh_at(new, 0.0).normals)


def shift(placed: SceneObject, time_s: float) -> np.ndarray:
    """Return how far a mesh is moved from where it rests."""
    mesh = mesh_at(placed, time_s)
    moved = mesh.positions - mesh.still.positions
    assert np.ptp(moved, axis=(0, 1)).max() < tol.FLOAT32
    return moved[0, 0]


def test_cubic_splines_are_those_of_the_specification(tmp_path: Path, rng: np.random.Generator) -> None:
    times = np.array([0.5, 1.25, 3.0])
    keys = rng.normal(size=(3, 3, 3))  # key, (into, value, out of), axis
    file = one_square()
    file.clip((0, "translation", times, keys, "CUBICSPLINE"))
    placed = loaded(file, tmp_path, loop="once")
    for key, share in [(0, 0.0), (0, 0.3), (1, 0.5), (1, 0.9)]:
        step = times[key + 1] - times[key]
        powers = np.array([share**3, share**2, share, 1.0])
        hermite = np.array([[2, -2, 1, 1], [-3, 3, -2, -1], [0, 0, 1, 0], [1, 0, 0, 0]])
        points = [keys[key, 1], keys[key + 1, 1], step * keys[key, 2], step * keys[key + 1, 0]]
        expected = powers @ hermite @ np.stack(points)
        # a clip begins with its first key
        np.testing.assert_allclose(shift(placed, times[key] - 0.5 + share * step), expected, atol=tol.FLOAT32)
    np.testing.assert_allclose(shift(placed, 9.0), keys[2, 1], atol=tol.FLOAT32)


def test_cubic_rotations_are_rotations(tmp_path: Path) -> None:
    file = one_square()
    keys = np.stack([np.zeros((2, 4)), turned([0.0, 1.0]), np.zeros((2, 4))], axis=1)
    file.clip((0, "rotation", [0.0, 1.0], keys, "CUBICSPLINE"))
    mesh = mesh_at(loaded(file, tmp_path, loop="once"), 0.5)
    np.testing.assert_allclose(mesh.positions, mesh.still.positions @ about_z(0.5).T, atol=tol.FLOAT32)


def test_steps_stay_until_the_next_key(tmp_path: Path) -> None:
    file = one_square()
    file.clip((0, "translation", [0.0, 1.0, 2.0], [[1.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0]], "STEP"))
    placed = loaded(file, tmp_path, loop="once")
    shown = [shift(placed, time_s)[0] for time_s in (0.0, 0.999, 1.0, 1.5, 2.0, 7.0)]
    np.testing.assert_allclose(shown, [1.0, 1.0, 2.0, 2.0, 4.0, 4.0])


def test_rotations_take_the_shortest_arc_evenly(tmp_path: Path) -> None:
    file = one_square()
    keys = turned([0.0, np.radians(120.0)]) * [[1.0], [-1.0]]  # the same turn, from the other side
    file.clip((0, "rotation", [0.0, 1.0], keys))
    mesh = mesh_at(loaded(file, tmp_path, loop="once"), 0.25)
    expected = mesh.still.positions @ about_z(np.radians(30.0)).T
    np.testing.assert_allclose(mesh.positions, expected, atol=tol.FLOAT32)


# --- playing -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "time_s", "expected"),
    [
        ({}, 0.5, 0.5), ({}, 2.75, 0.75), ({"loop": "once"}, 2.75, 2.0), ({"loop": "once"}, -1.0, 0.0),
        ({"loop": "ping-pong"}, 2.75, 1.25), ({"loop": "ping-pong"}, 4.25, 0.25), ({"speed": 2.0}, 0.5, 1.0),
        ({"speed": -1.0}, 0.5, 1.5), ({"start_s": 0.5}, 1.0, 1.5), ({"start_s": 1.5, "speed": 0.5}, 3.0, 1.0),
        ({"start_s": -3.0, "loop": "once"}, 2.0, 0.0), ({"start_s": -3.0, "loop": "once"}, 4.0, 1.0),
        ({"speed": 0.0, "start_s": 0.25}, 7.0, 0.25),
    ],
)  # fmt: skip
def test_loop_speed_and_start(tmp_path: Path, more: dict[str, Any], time_s: float, expected: float) -> None:
    file = one_square()
    file.clip((0, "translation", [0.0, 2.0], [[0.0, 0, 0], [2.0, 0, 0]]))
    placed = loaded(file, tmp_path, **more)
    assert shift(placed, time_s)[0] == pytest.approx(expected, abs=tol.FLOAT32)
    assert placed.moves == (more.get("speed") != 0.0)


@pytest.mark.parametrize("loop", ["repeat", "once", "ping-pong"])
def test_a_clip_without_length_rests(loop: Any) -> None:
    assert looped(3.0, 0.0, loop) == 0.0


def two_clips() -> GltfFile:
    file = one_square()
    file.clip((0, "translation", [0.0], [[1.0, 0, 0]]), name="left")
    file.clip((0, "translation", [0.0], [[2.0, 0, 0]]), name="right")
    return file


@pytest.mark.parametrize(("animation", "expected"), [("auto", 1.0), ("right", 2.0), (1, 2.0), ("1", 2.0), (0, 1.0)])
def test_clips_are_chosen_by_name_or_number(tmp_path: Path, animation: str | int, expected: float) -> None:
    placed = loaded(two_clips(), tmp_path, animation=animation)
    assert shift(placed, 0.0)[0] == expected
    assert any("set animation to choose of: 'left', 'right'" in note for note in placed.notes) == (animation == "auto")


def test_no_animation_rests_and_does_not_move(tmp_path: Path) -> None:
    placed = loaded(swimming(), tmp_path, animation="")
    assert placed.playback is None
    assert not placed.moves
    assert mesh_at(placed, 0.25) is placed.meshes[0]


def test_one_instant_is_one_mesh_and_a_frame_is_the_same_alone(tmp_path: Path) -> None:
    path = swimming().write(tmp_path / "fish.glb")
    one, two, late = load_objects([ObjectSettings(mesh=path), ObjectSettings(mesh=path, position_m=(1, 0, -2)),
                                   ObjectSettings(mesh=path, start_s=0.3)])  # fmt: skip
    assert mesh_at(one, 0.4) is mesh_at(two, 0.4)
    assert mesh_at(late, 0.1) is not mesh_at(one, 0.1)
    in_turn = [mesh_at(one, 0.04 * k).positions for k in range(20)]
    (alone,) = load_objects([ObjectSettings(mesh=path)])
    np.testing.assert_array_equal(mesh_at(alone, 0.04 * 13).positions, in_turn[13])


@pytest.mark.parametrize("make", [swimming, morphing])
def test_bounds_hold_every_pose(tmp_path: Path, make: Any) -> None:
    file = make()
    if make is morphing:
        file.clip((0, "weights", [0.0, 1.0, 2.0], [[0.0, 0.0], [3.0, 1.0], [-1.0, 0.0]], "LINEAR"))
    placed = loaded(file, tmp_path, position_m=(0.0, 1.0, -3.0))
    hull = placed.meshes[0].hull.reshape(-1, 3)
    for time_s in np.linspace(0.0, 2.0, 97):
        mesh = mesh_at(placed, float(time_s))
        points, around = mesh.positions.reshape(-1, 3), mesh.hull.reshape(-1, 3)
        for inner, outer in ((points, around), (around, hull)):
            assert np.all(inner.min(axis=0) >= outer.min(axis=0))
            assert np.all(inner.max(axis=0) <= outer.max(axis=0))
        np.testing.assert_allclose(mesh.extent_m, np.ptp(points, axis=0), atol=tol.HULL_SHALLOW * np.ptp(points))
        assert placed.highest_m(0.0) >= 1.0 + points[:, 1].max()
        planes = np.cross(mesh.hull[:, 1] - mesh.hull[:, 0], mesh.hull[:, 2] - mesh.hull[:, 0])
        planes *= np.sign(np.einsum("hk,hk->h", planes, mesh.hull[:, 0] - points.mean(axis=0)))[:, None]
        beyond = np.einsum("hk,hvk->hv", planes, points[None] - mesh.hull[:, :1])
        assert beyond.max() <= tol.FLOAT64


# --- what is refused -----------------------------------------------------------------------------------------------


def test_an_animation_that_is_not_there_lists_those_that_are(tmp_path: Path) -> None:
    for animation in ("fly", 2, "-1"):
        with pytest.raises(MeshError, match=r"no animation of that name or number .*there are: 'left', 'right'"):
            loaded(two_clips(), tmp_path, animation=animation)
    with pytest.raises(MeshError, match="there are: none"):
        loaded(one_square(), tmp_path, animation="swim")
    for number in (0, 1):
        two_clips().write(tmp_path / f"many_{number}.glb")
    assert load_object(ObjectSettings(mesh=tmp_path / "many_%d.glb")).playback is None
    with pytest.raises(MeshError, match="a sequence plays its meshes"):
        load_object(ObjectSettings(mesh=tmp_path / "many_%d.glb", animation="left"))


MOVE = [[0.0, 0, 0], [1.0, 0, 0]]
BROKEN_CLIPS = {
    "do not ascend in time": (0, "translation", [1.0, 0.5], MOVE),
    "at no time or before 0": (0, "translation", [-1.0, 0.5], MOVE),
    "at no time or before 0 (got nan s)": (0, "translation", [0.0, np.nan], MOVE),
    "do not fit its keys (got 6 numbers for 3 keys of 3)": (0, "translation", [0.0, 1.0, 2.0], MOVE),
    "do not fit its keys (got 6 numbers for 2 keys of 9)": (0, "translation", [0.0, 1.0], MOVE, "CUBICSPLINE"),
    "are not finite": (0, "translation", [0.0, 1.0], [[0.0, 0, 0], [np.inf, 0, 0]]),
    "interpolation that is unknown (got 'SMOOTH')": (0, "translation", [0.0, 1.0], MOVE, "SMOOTH"),
    "moves something unknown (got path 'colour')": (0, "colour", [0.0, 1.0], MOVE),
    "morph targets of a node that has none": (0, "weights", [0.0, 1.0], [0.0, 1.0]),
    "the quaternion 0, 0, 0, 0": (0, "rotation", [0.0], [[0.0, 0.0, 0.0, 0.0]]),
}


@pytest.mark.parametrize("what", BROKEN_CLIPS)
def test_broken_clips_say_what_is_wrong(tmp_path: Path, what: str) -> None:
    file = one_square()
    file.clip(BROKEN_CLIPS[what], name="swim")
    with pytest.raises(MeshError) as caught:
        loaded(file, tmp_path)
    assert what in str(caught.value)
    assert "moving.glb - animation 'swim' " in str(caught.value)
    assert loaded(file, tmp_path, animation="").playback is None  # without it, the file is drawn


def test_a_node_with_a_matrix_is_not_animated(tmp_path: Path) -> None:
    file = one_square(node={"matrix": np.eye(4).ravel().tolist()})
    file.clip((0, "translation", [0.0, 1.0], MOVE))
    with pytest.raises(MeshError, match="moves a node that is placed by a matrix"):
        loaded(file, tmp_path)


def test_channels_of_what_is_not_drawn_are_passed_over(tmp_path: Path) -> None:
    file = one_square(scenes=[{"nodes": [0]}])
    file.tree["nodes"].append({})
    file.clip((1, "translation", [0.0, 1.0], MOVE), (None, "pointer", [0.0, 1.0], MOVE), name="aside")
    placed = loaded(file, tmp_path)
    assert not placed.moves
    assert any("'aside' moves nothing that is drawn" in note for note in placed.notes)


def with_weights(weights: Any, joints: Any = ((0, 1, 0, 0),)) -> GltfFile:
    file = one_square()
    file.tree["meshes"][0]["primitives"][0]["attributes"] |= {
        "JOINTS_0": file.accessor(np.resize(joints, (4, 4)), "u1"),
        "WEIGHTS_0": file.accessor(np.resize(weights, (4, 4))),
    }
    file.tree["skins"] = [{"joints": [1, 2]}]
    file.tree["nodes"] = [{"mesh": 0, "skin": 0}, {}, {"translation": [0, 0, 2]}]
    return file


@pytest.mark.parametrize(
    ("weights", "joints", "what"),
    [
        ([0.5, np.nan, 0.0, 0.0], [0, 1, 0, 0], r"broken weights \(got nan at vertex 0\)"),
        ([1.5, -0.5, 0.0, 0.0], [0, 1, 0, 0], r"broken weights \(got -0.5 at vertex 0\)"),
        ([0.5, 0.5, 0.0, 0.0], [0, 7, 0, 0], r"joints that it has not \(got joint 7 of 2\)"),
    ],
)
def test_broken_skins_say_what_is_wrong(tmp_path: Path, weights: Any, joints: Any, what: str) -> None:
    with pytest.raises(MeshError, match=r"moving.glb - skin 0 .*" + what):
        loaded(with_weights(weights, joints), tmp_path)


def test_joints_outside_the_scene_and_lost_matrices_are_refused(tmp_path: Path) -> None:
    file = with_weights([0.5, 0.5, 0.0, 0.0])
    file.tree["scenes"] = [{"nodes": [0, 1]}]
    with pytest.raises(MeshError, match="follows nodes that are not in the scene"):
        loaded(file, tmp_path)
    file = with_weights([0.5, 0.5, 0.0, 0.0])
    file.tree["skins"][0]["inverseBindMatrices"] = file.accessor(np.eye(4).reshape(1, 16))
    with pytest.raises(MeshError, match=r"broken inverseBindMatrices \(got 1 for 2 joints"):
        loaded(file, tmp_path)
    file = with_weights([0.5, 0.5, 0.0, 0.0])
    del file.tree["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    with pytest.raises(MeshError, match="joints without weights"):
        loaded(file, tmp_path)


@pytest.mark.parametrize(
    ("weights", "height", "note"),
    [
        ([1.0, 3.0, 0.0, 0.0], 1.5, "weights that do not sum to 1 (got 4)"),
        ([0.25, 0.7499, 0.0, 0.0], 2.0 * 0.7499 / 0.9999, ""),
        ([0.0, 0.0, 0.0, 0.0], 0.0, "4 vertices without weights"),
    ],
)
def test_weights_are_made_to_sum_to_one(tmp_path: Path, weights: Any, height: float, note: str) -> None:
    placed = loaded(with_weights(weights), tmp_path)
    np.testing.assert_allclose(placed.meshes[0].positions[..., 2], height, atol=tol.FLOAT32)
    assert any(note in text for text in placed.notes) if note else placed.notes == ()


def test_morph_targets_must_fit(tmp_path: Path) -> None:
    file = morphing()
    file.tree["meshes"][0]["weights"] = [1.0]
    with pytest.raises(MeshError, match=r"weights do not fit the morph targets \(got 1 weights for 2 targets\)"):
        loaded(file, tmp_path)
    file = morphing()
    file.tree["meshes"][0]["primitives"][0]["targets"][1]["POSITION"] = file.accessor(np.zeros((3, 3)))
    with pytest.raises(MeshError, match="morph target 1 does not fit its mesh"):
        loaded(file, tmp_path)


@pytest.mark.parametrize("value", [None, -1, "x", 10**9])
def test_a_damaged_animation_is_played_or_refused(tmp_path: Path, value: object) -> None:
    """Whatever one entry of skins, nodes and animations is replaced by, nothing but `MeshError` is raised."""
    file = swimming(3, 3)
    whole = copy.deepcopy(file.tree)
    mesh_at(loaded(file, tmp_path), 0.1)
    for *keys, last in every_place({name: whole[name] for name in ("animations", "skins", "nodes", "accessors")}):
        file.tree = copy.deepcopy(whole)
        entry: Any = file.tree
        for key in keys:
            entry = entry[key]
        entry[last] = value
        with contextlib.suppress(MeshError):
            mesh_at(loaded(file, tmp_path), 0.1)


@pytest.mark.parametrize("joint", [1, 2])
def test_what_has_no_size_at_rest_grows(tmp_path: Path, backend: str, joint: int) -> None:
    """A joint of scale 0 at rest, the second or that of all: half of the tube, or all of it, shows in the end."""
    file = tube()
    whole = file.write(tmp_path / "whole.glb")
    file.tree["nodes"][joint]["scale"] = [0.0, 0.0, 0.0]
    file.clip((joint, "scale", [0.0, 1.0, 2.0], [[0, 0, 0], [1, 1, 1], [1, 1, 1]]))
    grows = load_object(ObjectSettings(mesh=file.write(tmp_path / "grows.glb")))

    def covered(at: PlacedObject) -> float:
        away = PlacedObject(at.mesh, rigid((-1.0, 0.0, -2.0), np.eye(3), 1.0))
        layer, _ = draw(backend, shot(away, width=64, sun=None))
        assert np.all(np.isfinite(layer.radiance))
        return float(layer.alpha.sum())

    full = covered(PlacedObject(load_object(ObjectSettings(mesh=whole)).meshes[0], np.eye(4)))
    first, last = (covered(grows.at(t, 0, np.zeros(3), np.eye(3))) for t in (0.0, 1.5))
    assert last == pytest.approx(full, rel=1e-3)
    assert first < 0.6 * full
    unmoved = load_object(ObjectSettings(mesh=tmp_path / "grows.glb", animation=""))
    assert covered(unmoved.at(0.0, 0, np.zeros(3), np.eye(3))) == pytest.approx(first, abs=0.05)
