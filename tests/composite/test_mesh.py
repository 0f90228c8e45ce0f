# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from mr360uw.composite import load_mesh, load_objects
from mr360uw.composite import motion as rig_module
from mr360uw.composite.mesh.material import Material, Part
from mr360uw.composite.mesh.mesh import make_mesh
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import load_object
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile
from tests.composite.scenes import box, sphere


def written(path: Path, mesh: trimesh.Trimesh) -> Path:
    mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_formats_and_units(tmp_path: Path, suffix: str) -> None:
    path = written(tmp_path / f"box{suffix}", trimesh.creation.box((2.0, 1.0, 0.5)))
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.extent_m, [2.0, 1.0, 0.5], atol=tol.FLOAT32)
    np.testing.assert_allclose(load_mesh(path, "cm").extent_m, [0.02, 0.01, 0.005], atol=tol.FLOAT32)
    facing = np.sum(mesh.normals.mean(axis=1) * mesh.positions.mean(axis=1), -1)
    assert np.all(facing > 0.0)


def test_odd_sizes_are_noted(tmp_path: Path) -> None:
    path = written(tmp_path / "big.glb", trimesh.creation.box((40.0, 1.0, 1.0)))
    assert "40 m long" in load_mesh(path).notes[-1]
    assert not any("long" in note for note in load_mesh(path, "m").notes)
    small = written(tmp_path / "small.glb", trimesh.creation.box((0.01, 0.01, 0.01)))
    assert "10 mm" in load_mesh(small).notes[-1]


def test_what_cannot_be_used_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2]])
    bad = triangle.copy()
    bad[1, 1] = np.nan
    with pytest.raises(MeshError, match="no triangles"):
        make_mesh([Part("none", triangle, faces[:0])], [])
    with pytest.raises(MeshError, match="not finite"):
        make_mesh([Part("nan", bad, faces)], [])
    with pytest.raises(MeshError, match="no extent"):
        make_mesh([Part("point", 0 * triangle, faces)], [])
    with pytest.raises(MeshError, match="no such file"):
        load_mesh(tmp_path / "absent.glb")
    with pytest.raises(MeshError, match="not a mesh format"):
        load_mesh(tmp_path / "mesh.thing")
    for name, says in (("a.fbx", "bpy.ops.import_scene.fbx"), ("a.abc", "alembic_import"), ("a.blend", "-b .*a.blend")):
        with pytest.raises(MeshError, match=rf"which is not read - convert it with Blender: blender .*{says}.*a\.glb"):
            load_mesh(tmp_path / name)
    monkeypatch.setitem(sys.modules, "pxr", None)
    (tmp_path / "a.usdz").write_bytes(b"PK")
    with pytest.raises(MeshError, match=r"usd-core - pip install 'mr360uw\[usd\]', or export it as"):
        load_mesh(tmp_path / "a.usdz")
    (tmp_path / "text.glb").write_text("this is not a mesh")
    with pytest.raises(MeshError, match="not glTF"):
        load_mesh(tmp_path / "text.glb")


def test_missing_textures_are_named(tmp_path: Path) -> None:
    obj = tmp_path / "one.obj"
    obj.write_text("mtllib one.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    (tmp_path / "one.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd not there.png\n")
    with pytest.raises(MeshError, match=r"texture is missing .*not there\.png"):
        load_mesh(obj)
    (tmp_path / "one.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "images": [{"uri": "gone.png"}]}))
    with pytest.raises(MeshError, match="gone"):
        load_mesh(tmp_path / "one.gltf")


def test_gltf_without_material_keeps_coordinates_and_colours(tmp_path: Path) -> None:
    box_mesh = trimesh.creation.box()
    uv = np.random.default_rng(1).uniform(size=(len(box_mesh.vertices), 2))
    box_mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=trimesh.visual.material.PBRMaterial())
    data = box_mesh.export(file_type="glb")
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    tree.pop("materials")
    del tree["meshes"][0]["primitives"][0]["material"]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    total = 20 + len(text) + len(rest)
    header = data[:8] + total.to_bytes(4, "little") + len(text).to_bytes(4, "little") + b"JSON"
    (tmp_path / "bare.glb").write_bytes(header + text + rest)
    mesh = load_mesh(tmp_path / "bare.glb")
    assert np.ptp(mesh.uv) > 0.5
    assert mesh.materials[0].base_color == (1.0, 1.0, 1.0, 1.0)


def test_creases_stay_sharp_and_round_bodies_smooth() -> None:
    cube = box()
    face = np.cross(cube.positions[:, 1] - cube.positions[:, 0], cube.positions[:, 2] - cube.positions[:, 0])
    face /= np.linalg.norm(face, axis=-1, keepdims=True)
    np.testing.assert_allclose(cube.normals, np.repeat(face[:, None], 3, axis=1), atol=tol.FLOAT64)
    assert cube.patch.max() + 1 == 6
    ball = sphere()
    bare = make_mesh(
        [Part("ball", ball.positions.reshape(-1, 3), np.arange(ball.positions.size // 3).reshape(-1, 3))],
        list(ball.materials),
    )
    angle = np.sum(bare.normals * ball.normals, -1)
    assert angle.min() > 1.0 - tol.SMOOTH_NORMALS
    assert bare.patch.max() == 0


def test_normals_about_a_vertex_do_not_depend_on_how_many_faces_meet_there() -> None:
    # a cone of n faces about its tip: blunt, it is round there; sharp, every face takes those within 60 degrees of it
    count = 96
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(turn), np.zeros(count), np.sin(turn)], axis=-1)
    faces = np.stack([np.full(count, count), (np.arange(count) + 1) % count, np.arange(count)], axis=-1)
    for height, is_round in ((0.2, True), (3.0, False)):
        cone = make_mesh([Part("cone", np.vstack([rim, [[0.0, height, 0.0]]]), faces)], [Material()])
        at_tip = cone.normals[:, 0]
        if is_round:
            np.testing.assert_allclose(at_tip, np.broadcast_to([0.0, 1.0, 0.0], at_tip.shape), atol=tol.FLOAT64)
            assert cone.patch.max() == 0
            continue
        flat = np.cross(cone.positions[:, 1] - cone.positions[:, 0], cone.positions[:, 2] - cone.positions[:, 0])
        flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
        expected = np.stack([flat[flat @ one > 0.5].sum(axis=0) for one in flat])  # the faces' angles are the same
        expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
        np.testing.assert_allclose(at_tip, expected, atol=tol.FLOAT64)


def test_hull_holds_every_vertex_of_a_mesh(rng: np.random.Generator) -> None:
    points = rng.normal(size=(300, 3))
    mesh = make_mesh([Part("cloud", points, rng.integers(0, 300, (900, 3)))], [Material()])
    corners = mesh.hull.reshape(-1, 3)
    for direction in rng.normal(size=(50, 3)):
        highest = np.max(mesh.positions @ direction)
        np.testing.assert_allclose(np.max(corners @ direction), highest, rtol=tol.FLOAT64)


def test_hull_of_a_large_round_mesh_is_small_and_holds_it(rng: np.random.Generator) -> None:
    ball = trimesh.creation.icosphere(subdivisions=7)  # 163842 vertices, all of them on the exact hull
    mesh = make_mesh([Part("ball", np.asarray(ball.vertices), np.asarray(ball.faces))], [Material()])
    assert len(mesh.hull) < 0.2 * len(mesh.positions)
    corners = mesh.hull.reshape(-1, 3)
    directions = rng.normal(size=(50, 3))
    for direction in directions / np.linalg.norm(directions, axis=-1, keepdims=True):
        out = np.max(mesh.positions @ direction) - np.max(corners @ direction)
        assert 0.0 <= out <= 2.0 * tol.HULL_SHALLOW


def test_scene_objects_override_materials_and_follow_sequences(tmp_path: Path) -> None:
    Image.new("RGB", (8, 8), (255, 0, 0)).save(tmp_path / "red.png")
    for k in range(1, 4):
        written(tmp_path / f"fish_{k:03d}.glb", trimesh.creation.box((k, 1, 1)))
    settings = ObjectSettings(
        mesh=tmp_path / "fish_%03d.glb", texture=tmp_path / "red.png", roughness=0.25, metallic=0.5, attach="camera"
    )
    loaded = load_object(settings)
    assert len(loaded.meshes) == 3
    assert loaded.moves
    material = loaded.meshes[0].materials[0]
    assert (material.roughness, material.metallic) == (0.25, 0.5)
    np.testing.assert_allclose(material.base_map.levels[-1][0, 0, :3], [1.0, 0.0, 0.0], atol=tol.HALF_FLOAT)
    at = loaded.at(0.0, 4, np.array([1.0, 2.0, 3.0]), np.eye(3))
    assert at.mesh is loaded.meshes[1]
    np.testing.assert_allclose(at.world_from_object[:3, 3], [1.0, 2.0, 0.0], atol=tol.FLOAT64)
    with pytest.raises(MeshError, match="no such files"):
        load_object(ObjectSettings(mesh=tmp_path / "none_%03d.glb"))


def test_objects_of_one_file_share_their_meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.new("RGB", (8, 8), (255, 0, 0)).save(tmp_path / "red.png")
    fish = {"mesh": written(tmp_path / "fish.glb", trimesh.creation.box((3, 1, 1))), "texture": tmp_path / "red.png"}
    reads: list[Path] = []
    read = rig_module.read_mesh_file
    monkeypatch.setattr(rig_module, "read_mesh_file", lambda path, **kw: reads.append(path) or read(path, **kw))
    one, other, matt = load_objects(
        [
            ObjectSettings(**fish),
            ObjectSettings(**fish, position_m=(1, 2, 3), scale=2.0, casts_shadow=False),
            ObjectSettings(**fish, roughness=1.0),
        ]
    )
    assert one.meshes[0] is other.meshes[0]
    assert (one.motion.scale[0], other.motion.scale[0]) == (1.0, 2.0)
    assert one.meshes[0].positions is matt.meshes[0].positions
    assert one.meshes[0].materials[0].base_map is matt.meshes[0].materials[0].base_map
    assert one.meshes[0].materials != matt.meshes[0].materials
    assert len(reads) == 1


def test_meshes_as_they_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fish in centimetres, alpha modes and a wheel used twice, an OBJ with a space in a name, a scan, Draco."""
    grey = np.full((4, 4, 3), 128, np.uint8)
    fish = GltfFile()
    maps = {"baseColorTexture": {"index": fish.texture(grey)}}
    fish.tree["materials"] = [{"pbrMetallicRoughness": maps, "normalTexture": {"index": fish.texture(grey)}}]
    fish.mesh(fish.square(material=0))
    fish.tree["nodes"] = [{"mesh": 0, "scale": [12.5, 40.2, 18.5]}]
    mesh = load_mesh(fish.write(tmp_path / "fish.glb"))
    assert "40.2 m long" in mesh.notes[0]
    assert mesh.materials[0].normal_map is not None
    np.testing.assert_allclose(load_mesh(tmp_path / "fish.glb", "cm").extent_m.max(), 0.402, rtol=tol.FLOAT32)

    half = {"baseColorFactor": [1.0, 1.0, 1.0, 0.5]}
    truck = GltfFile(materials=[{"alphaMode": m, "pbrMetallicRoughness": half} for m in ("OPAQUE", "MASK", "BLEND")])
    truck.mesh(truck.square(material=0), truck.square(material=1))
    truck.mesh(truck.square(material=2))
    truck.tree["nodes"] = [{"mesh": 0}, {"mesh": 1, "translation": [1, 0, 0]}, {"mesh": 1, "translation": [3, 0, 0]}]
    mesh = load_mesh(truck.write(tmp_path / "truck.gltf"))
    assert len(mesh.positions) == 2 + 2 + 2 * 2
    assert [material.alpha_mode for material in mesh.materials] == ["OPAQUE", "MASK", "BLEND"]

    Image.new("RGB", (4, 4), (0, 0, 255)).save(tmp_path / "fuze uv.png")
    (tmp_path / "can.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd fuze uv.png\n")
    (tmp_path / "can.obj").write_text(
        "mtllib can.mtl\nusemtl skin\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    )
    can = load_mesh(tmp_path / "can.obj")
    assert can.materials[0].base_map is not None
    np.testing.assert_allclose(can.uv[0], [[0, 1], [1, 1], [0, 0]], atol=tol.FLOAT32)  # v counts down from the top

    (tmp_path / "scan.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n"
    )
    np.testing.assert_allclose(load_mesh(tmp_path / "scan.ply").extent_m, [1.0, 1.0, 0.0], atol=tol.FLOAT32)

    draco = "KHR_draco_mesh_compression"
    wreck = GltfFile(extensionsUsed=[draco], extensionsRequired=[draco])
    packed = {draco: {"bufferView": wreck.view(bytes(60)), "attributes": {"POSITION": 0}}}
    wreck.tree["accessors"] = [{"componentType": 5126, "count": 24, "type": "VEC3"}]
    wreck.mesh({"attributes": {"POSITION": 0}, "extensions": packed})
    wreck.write(tmp_path / "wreck.gltf")
    if importlib.util.find_spec("DracoPy") is not None:
        with pytest.raises(MeshError, match="Draco, is damaged"):
            load_mesh(tmp_path / "wreck.gltf")
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(MeshError, match=r"Draco, .* pip install 'mr360uw\[gltf\]'"):
        load_mesh(tmp_path / "wreck.gltf")


def test_smooth_deg_decides_which_edges_are_smooth_and_replaces_normals(tmp_path: Path) -> None:
    """Two squares that meet at 40 degrees: their shared corners are flat, or lie between the two."""
    bend = np.radians(40.0)
    up = np.array([[0.0, 0.0, 1.0], [-np.sin(bend), 0.0, np.cos(bend)]])
    points = [[-1, 0, 0], [0, 0, 0], [0, 1, 0], [-1, 1, 0], [np.cos(bend), 0, np.sin(bend)]]
    points.append([np.cos(bend), 1, np.sin(bend)])
    file = GltfFile()
    attributes = {"POSITION": file.accessor(points), "NORMAL": file.accessor(np.tile([0.0, 0.6, 0.8], (6, 1)))}
    indices = file.accessor([0, 1, 2, 0, 2, 3, 1, 4, 5, 1, 5, 2], "u2")
    file.mesh({"attributes": attributes, "indices": indices})
    path = file.write(tmp_path / "fold.glb")
    own, flat, sharp, smooth = (load_mesh(path, smooth_deg=angle) for angle in (None, 0.0, 39.0, 41.0))
    np.testing.assert_allclose(own.normals, np.broadcast_to([0.0, 0.6, 0.8], (4, 3, 3)), atol=tol.FLOAT32)
    each = np.repeat(up[[0, 0, 1, 1], None], 3, axis=1)
    np.testing.assert_allclose(flat.normals, each, atol=tol.FLOAT32)
    np.testing.assert_allclose(sharp.normals, each, atol=tol.FLOAT32)
    expected = each.copy()
    expected[smooth.positions[..., 0] ** 2 < tol.FLOAT32] = 0.0
    on_edge = np.all(expected == 0.0, axis=-1)
    between = smooth.normals[on_edge]
    assert on_edge.sum() == 6
    # by the corners' angles: on one side 90 degrees to 45 + 45, so the normal is exactly between the two faces' or not
    # far from it; it lies in their plane, and no nearer to one than a third of the way
    np.testing.assert_allclose(between[:, 1], 0.0, atol=tol.FLOAT32)
    turn = np.degrees(np.arctan2(-between[:, 0], between[:, 2]))
    assert np.all((turn > 40.0 / 3.0) & (turn < 80.0 / 3.0))
    np.testing.assert_allclose(smooth.normals[~on_edge], expected[~on_edge], atol=tol.FLOAT32)
    assert (sharp.patch.max(), smooth.patch.max()) == (1, 0)
