# SPDX-License-Identifier: Apache-2.0
"""glTF files as others write them: what is read, what is noted, what is refused."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw.composite import load_mesh
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import load_object
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile, one_square

GREY = np.full((2, 2, 3), 128, np.uint8)


def facing(mesh: Mesh) -> np.ndarray:
    """Return the unit normals (T, 3) that the winding of the triangles gives."""
    e1, e2 = mesh.positions[:, 1] - mesh.positions[:, 0], mesh.positions[:, 2] - mesh.positions[:, 0]
    normal = np.cross(e1, e2)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def said(mesh: Mesh, text: str) -> bool:
    return any(text in note for note in mesh.notes)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_several_materials_and_instances(tmp_path: Path, suffix: str) -> None:
    file = GltfFile(materials=[{"name": "a", "doubleSided": True}, {"name": "b", "pbrMetallicRoughness": {}}])
    file.mesh(file.square(material=0), file.square(material=1), name="both")
    half = float(np.sqrt(0.5))
    file.tree["nodes"] = [
        {"mesh": 0, "name": "left", "translation": [-3, 0, 0]},
        {"name": "pivot", "children": [2], "rotation": [0, half, 0, half]},
        {"mesh": 0, "name": "right", "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 5, 1]},
        {"mesh": 0, "name": "elsewhere"},
    ]
    file.tree["scenes"], file.tree["scene"] = [{"nodes": [3]}, {"nodes": [0, 1]}], 1
    path = file.write(tmp_path / f"two{suffix}")
    mesh = load_mesh(path)
    assert len(mesh.positions) == 8
    assert [m.name for m in mesh.materials] == ["a", "b"]
    assert mesh.material.tolist() == [0, 0, 1, 1, 0, 0, 1, 1]
    # a quarter turn about +y takes +z to +x: the square at z = 5 comes to x = 5 and faces +x
    np.testing.assert_allclose(mesh.positions[4:, :, 0], 5.0, atol=tol.FLOAT32)
    np.testing.assert_allclose(facing(mesh)[4:], np.tile([1.0, 0.0, 0.0], (4, 1)), atol=tol.FLOAT32)
    assert len(load_mesh(path, part="right").positions) == 4
    with pytest.raises(MeshError, match="left/both, right/both"):
        load_mesh(path, part="elsewhere")


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (1.0, -2.0, 0.5), (-1.0, -1.0, -1.0), (-1e-3, 1e-3, 1e-3)])
def test_a_mirror_turns_the_winding_and_keeps_normals_outside(tmp_path: Path, scale: tuple[float, ...]) -> None:
    file = GltfFile(materials=[{}])
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) - 0.25
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    outside = np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0], [1, 1, 1]], float)
    attributes = {
        "POSITION": file.accessor(corners[faces.ravel()]),
        "NORMAL": file.accessor(np.repeat(outside, 3, axis=0)),
    }
    file.mesh({"attributes": attributes, "material": 0})
    file.tree["nodes"] = [{"mesh": 0, "scale": scale}]
    mesh = load_mesh(file.write(tmp_path / "mirror.glb"), "m")
    center = mesh.positions.mean(axis=(0, 1))
    assert np.all(np.sum(facing(mesh) * (mesh.positions.mean(axis=1) - center), -1) > 0.0)
    # of flat faces the normals are those of the winding, whatever the scale along each axis: inverse transpose
    np.testing.assert_allclose(mesh.normals, np.repeat(facing(mesh)[:, None], 3, axis=1), atol=tol.FLOAT32)


def test_texture_transform_follows_the_extensions_example(tmp_path: Path) -> None:
    """The lower left quarter of the image, turned a quarter clockwise: the image's corners are found by hand."""
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0], image[0, 1], image[1, 0], image[1, 1] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)
    file = GltfFile(extensionsUsed=["KHR_texture_transform"], extensionsRequired=["KHR_texture_transform"])
    number = file.texture(image, wrapS=33071, wrapT=33648)
    transform = {"offset": [0, 1], "rotation": float(np.pi / 2), "scale": [0.5, 0.5]}
    reference = {"index": number, "extensions": {"KHR_texture_transform": transform}}
    file.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": reference}}]
    file.mesh(file.square(material=0))
    mesh = load_mesh(file.write(tmp_path / "turned.glb"))
    corners = {
        tuple(p): uv for p, uv in zip(mesh.positions[..., :2].reshape(-1, 2), mesh.uv.reshape(-1, 2), strict=True)
    }
    np.testing.assert_allclose(corners[0.0, 1.0], [0.0, 1.0], atol=tol.FLOAT32)  # top left shows the bottom left
    np.testing.assert_allclose(corners[1.0, 1.0], [0.0, 0.5], atol=tol.FLOAT32)
    np.testing.assert_allclose(corners[0.0, 0.0], [0.5, 1.0], atol=tol.FLOAT32)
    assert mesh.materials[0].base_map.wrap == ("clamp", "mirror")
    assert mesh.notes == ()


def test_a_second_set_of_coordinates(tmp_path: Path) -> None:
    file = GltfFile()
    number = file.texture(GREY)
    square = file.square(material=0)
    square["attributes"]["TEXCOORD_1"] = file.accessor([[0.25, 0.5]] * 4)
    base = {"index": number, "texCoord": 1}
    file.tree["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": base}, "occlusionTexture": {"index": number, "texCoord": 0}}
    ]
    file.mesh(square)
    mesh = load_mesh(file.write(tmp_path / "two.glb"))
    np.testing.assert_allclose(mesh.uv, np.broadcast_to([0.25, 0.5], mesh.uv.shape))
    (read,) = mesh.materials
    assert read.mapped == (("base_map", 0), ("occlusion_map", 1))  # each has its own
    np.testing.assert_allclose(mesh.more_uv[..., 0, :], mesh.positions[..., :2] * [1, -1] + [0, 1], atol=tol.FLOAT32)
    assert mesh.notes == ()


def test_factors_and_material_extensions(tmp_path: Path) -> None:
    material = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.1, 0.2, 0.3, 0.4],
            "metallicFactor": 0.25,
            "roughnessFactor": 0.5,
        },
        "emissiveFactor": [1.0, 0.5, 0.0],
        "alphaMode": "MASK",
        "alphaCutoff": 0.3,
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 4.0},
            "KHR_materials_ior": {"ior": 1.33},
        },
    }
    used = ["KHR_materials_emissive_strength", "KHR_materials_ior"]
    (read,) = load_mesh(one_square(material, extensionsUsed=used).write(tmp_path / "a.glb")).materials
    assert read.base_color == (0.1, 0.2, 0.3, 0.4)  # as written: no rounding to 8 bits
    assert (read.metallic, read.roughness, read.alpha_mode, read.alpha_cutoff) == (0.25, 0.5, "MASK", 0.3)
    assert (read.emission, read.refractive_index, read.double_sided) == ((4.0, 2.0, 0.0), 1.33, False)
    (plain,) = load_mesh(one_square().write(tmp_path / "b.glb")).materials
    assert (plain.metallic, plain.roughness, plain.base_color) == (1.0, 1.0, (1.0, 1.0, 1.0, 1.0))
    with pytest.raises(MeshError, match="alphaMode 'SOFT'"):
        load_mesh(one_square({"alphaMode": "SOFT"}).write(tmp_path / "c.glb"))


def test_unlit_and_glossiness_are_drawn_as_near_as_can_be_and_said(tmp_path: Path) -> None:
    unlit = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.2, 0.1, 1]}, "extensions": {"KHR_materials_unlit": {}}}
    mesh = load_mesh(one_square(unlit, extensionsUsed=["KHR_materials_unlit"]).write(tmp_path / "u.glb"))
    assert mesh.materials[0].metallic == 0.0
    assert said(mesh, "unlit")
    name = "KHR_materials_pbrSpecularGlossiness"
    glossy = {"extensions": {name: {"diffuseFactor": [0.2, 0.4, 0.6, 1.0], "glossinessFactor": 0.75}}}
    mesh = load_mesh(one_square(glossy, extensionsUsed=[name]).write(tmp_path / "g.glb"))
    read = mesh.materials[0]
    assert (read.base_color, read.metallic, read.roughness) == ((0.2, 0.4, 0.6, 1.0), 0.0, 0.25)
    assert said(mesh, "specular")


def test_quantised_attributes(tmp_path: Path) -> None:
    """Positions of 16 bits that the node scales, normals of 8 bits 4 bytes apart, coordinates of 16 bits."""
    file = GltfFile(extensionsUsed=["KHR_mesh_quantization"], extensionsRequired=["KHR_mesh_quantization"])
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    attributes = {
        "POSITION": file.accessor(corners * 32767, "i2", stride=8, normalized=True),
        "NORMAL": file.accessor(np.tile([0, 0, 127], (4, 1)), "i1", stride=4, normalized=True),
        "TEXCOORD_0": file.accessor([[0, 65535], [65535, 65535], [65535, 0], [0, 0]], "u2", normalized=True),
        "COLOR_0": file.accessor([[255, 128, 0, 64]] * 4, "u1", normalized=True),
    }
    file.tree["materials"] = [{"alphaMode": "BLEND"}]
    file.mesh({"attributes": attributes, "indices": file.accessor([0, 1, 2, 0, 2, 3], "u1"), "material": 0})
    file.tree["nodes"] = [{"mesh": 0, "scale": [3.0, 3.0, 3.0]}]
    mesh = load_mesh(file.write(tmp_path / "q.glb"))
    np.testing.assert_allclose(mesh.extent_m, [6.0, 6.0, 0.0], atol=tol.FLOAT32)
    np.testing.assert_allclose(mesh.normals, np.broadcast_to([0.0, 0.0, 1.0], mesh.normals.shape), atol=tol.FLOAT32)
    assert (mesh.uv.min(), mesh.uv.max()) == (0.0, 1.0)
    # vertex colours are linear and their alpha counts
    np.testing.assert_allclose(mesh.colors[0, 0], np.array([255, 128, 0, 64]) / 255, atol=tol.FLOAT64)
    loaded = load_object(ObjectSettings(mesh=tmp_path / "q.glb"))
    assert np.array_equal(loaded.meshes[0].colors, mesh.colors)


def test_vertex_colours_multiply_the_texture_of_the_file_but_not_that_of_the_scene(tmp_path: Path) -> None:
    file = GltfFile()
    reference = {"index": file.texture(GREY)}
    square = file.square(material=0)
    square["attributes"]["COLOR_0"] = file.accessor([[0.5, 1.0, 1.0]] * 4)
    file.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": reference}}]
    file.mesh(square)
    path, image = file.write(tmp_path / "c.glb"), tmp_path / "c.png"
    own = load_object(ObjectSettings(mesh=path)).meshes[0]
    assert own.colors[0, 0].tolist() == [0.5, 1.0, 1.0, 1.0]
    assert own.notes == ()
    cv2.imwrite(str(image), GREY)
    other = load_object(ObjectSettings(mesh=path, texture=image)).meshes[0]
    assert other.colors[0, 0].tolist() == [1.0, 1.0, 1.0, 1.0]
    assert said(other, "vertex colours")


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_textures_of_sixteen_bits(tmp_path: Path, channels: int) -> None:
    value = 12345
    image = np.full((4, 4, channels) if channels > 1 else (4, 4), value, np.uint16)
    file = GltfFile()
    number = file.texture(image)
    file.tree["materials"] = [{"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": number}}}]
    file.mesh(file.square(material=0))
    level = load_mesh(file.write(tmp_path / "deep.glb")).materials[0].metallic_roughness_map.levels[0]
    np.testing.assert_allclose(level[..., :3], value / 65535, rtol=tol.HALF_FLOAT)
    np.testing.assert_allclose(level[..., 3], value / 65535 if channels == 4 else 1.0, rtol=tol.HALF_FLOAT)


def test_one_image_for_two_maps_is_one_texture(tmp_path: Path) -> None:
    file = GltfFile()
    orm = {"index": file.texture(GREY)}
    file.tree["materials"] = [{"pbrMetallicRoughness": {"metallicRoughnessTexture": orm}, "occlusionTexture": orm}]
    file.mesh(file.square(material=0))
    read = load_mesh(file.write(tmp_path / "orm.glb")).materials[0]
    assert read.occlusion_map is read.metallic_roughness_map


def test_without_normals_triangles_are_flat_and_without_coordinates_unmapped(tmp_path: Path) -> None:
    file = GltfFile()
    file.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(GREY)}}}]
    roof = file.accessor([[0, 0, 0], [1, 0, 0], [0, 1, 0.1], [1, 1, 0]])
    file.mesh({"attributes": {"POSITION": roof}, "indices": file.accessor([0, 1, 2, 2, 1, 3], "u2"), "material": 0})
    mesh = load_mesh(file.write(tmp_path / "bare.glb"))
    np.testing.assert_allclose(mesh.normals, np.repeat(facing(mesh)[:, None], 3, axis=1), atol=tol.FLOAT64)
    assert mesh.materials[int(mesh.material[0])].maps == ()
    assert said(mesh, "no texture coordinates")


def test_strips_fans_sparse_values_and_points(tmp_path: Path) -> None:
    file = GltfFile(materials=[{}])
    zigzag = [[0, 0, 0], [0, -1, 0], [1, 0, 0], [1, -1, 0], [2, 0, 0]]
    file.mesh(
        {"attributes": {"POSITION": file.accessor(zigzag)}, "mode": 5, "material": 0},
        {
            "attributes": {"POSITION": file.accessor([[0, 2, 0], [1, 2, 0], [1, 3, 0], [0, 3, 0]])},
            "mode": 6,
            "material": 0,
        },
        {"attributes": {"POSITION": file.accessor(zigzag)}, "mode": 0},
    )
    mesh = load_mesh(file.write(tmp_path / "strips.glb"))
    assert len(mesh.positions) == 3 + 2
    np.testing.assert_allclose(facing(mesh), np.tile([0.0, 0.0, 1.0], (5, 1)), atol=tol.FLOAT64)
    assert said(mesh, "points or lines")
    # an accessor that holds zeros but for two of its values
    file = GltfFile(materials=[{}])
    square = file.square(material=0, uv=False, normals=False)
    indices, values = (
        file.view(np.array([1, 2], "<u2").tobytes()),
        file.view(np.array([[2, 0, 0], [2, 2, 0]], "<f4").tobytes()),
    )
    file.tree["accessors"][square["attributes"]["POSITION"]]["sparse"] = {
        "count": 2, "indices": {"bufferView": indices, "componentType": 5123}, "values": {"bufferView": values},
    }  # fmt: skip
    file.mesh(square)
    np.testing.assert_allclose(load_mesh(file.write(tmp_path / "sparse.glb")).extent_m, [2.0, 2.0, 0.0])


def test_morph_targets_and_skins_are_drawn_at_rest(tmp_path: Path) -> None:
    file = GltfFile(materials=[{}], animations=[{"channels": [], "samplers": []}])
    lifted = file.accessor(np.tile([0.0, 0.0, 2.0], (4, 1)))
    file.mesh(file.square(material=0, targets=[{"POSITION": lifted}]), weights=[0.5])
    mesh = load_mesh(file.write(tmp_path / "morph.glb"))
    np.testing.assert_allclose(mesh.positions[..., 2], 1.0)
    assert said(mesh, "animated - here it is drawn as it rests")

    # two joints: the left half stays, the right half goes up by 1; the mesh's own node does not count
    file = GltfFile(materials=[{}])
    square = file.square(material=0)
    square["attributes"] |= {
        "JOINTS_0": file.accessor([[0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]], "u1"),
        "WEIGHTS_0": file.accessor([[255, 0, 0, 0]] * 4, "u1", normalized=True),
    }
    file.mesh(square)
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 3, 1] = -5.0  # column by column: the second joint was 5 high when the skin was bound
    file.tree["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.accessor(bind.reshape(2, 16))}]
    file.tree["nodes"] = [{"mesh": 0, "skin": 0, "translation": [100, 0, 0]}, {}, {"translation": [0, 6, 0]}]
    mesh = load_mesh(file.write(tmp_path / "skin.glb"))
    points = mesh.positions.reshape(-1, 3)
    np.testing.assert_allclose(points[points[:, 0] == 0.0][:, 1].max(), 1.0)
    np.testing.assert_allclose(points[points[:, 0] == 1.0][:, 1].max(), 2.0)
    assert points[:, 0].max() == 1.0
    assert mesh.notes == ()


def test_degenerate_triangles_are_left_out(tmp_path: Path) -> None:
    file = GltfFile(materials=[{}])
    square = file.square(material=0, normals=False)
    square["indices"] = file.accessor([0, 1, 2, 0, 0, 1, 2, 2, 2, 0, 2, 3], "u2")
    file.mesh(square)
    mesh = load_mesh(file.write(tmp_path / "d.glb"))
    assert len(mesh.positions) == 2
    assert np.all(np.isfinite(mesh.normals))


def test_no_material_and_unknown_extensions_are_noted(tmp_path: Path) -> None:
    file = GltfFile(extensionsUsed=["KHR_materials_transmission", "KHR_lights_punctual"])
    file.mesh(file.square())
    mesh = load_mesh(file.write(tmp_path / "bare.glb"))
    assert said(mesh, "without material")
    assert said(mesh, "KHR_materials_transmission")
    assert said(mesh, "KHR_lights_punctual")
    assert (mesh.materials[0].metallic, mesh.materials[0].double_sided) == (0.0, True)


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        ({"extensionsRequired": ["KHR_texture_basisu"]}, "KTX2"),
        ({"extensionsRequired": ["EXT_mesh_gpu_instancing"]}, "EXT_mesh_gpu_instancing"),
        ({"extensionsRequired": ["ACME_subdivision"]}, "ACME_subdivision"),
        ({"nodes": [{"mesh": 0, "children": [0]}], "scenes": [{"nodes": [0]}]}, "hangs below two"),
        ({"nodes": [{"mesh": 7}]}, "not valid glTF"),
        ({"nodes": [{"mesh": 0, "rotation": [1, 2]}]}, "not valid glTF"),
    ],
)
def test_what_cannot_be_read_says_why(tmp_path: Path, tree: dict[str, Any], message: str) -> None:
    file = GltfFile(**tree)
    file.mesh(file.square())
    with pytest.raises(MeshError, match=message):
        load_mesh(file.write(tmp_path / "bad.glb"))


def test_broken_accessors_and_textures_say_why(tmp_path: Path) -> None:
    file = GltfFile()
    square = file.square()
    square["indices"] = file.accessor([0, 1, 9], "u2")
    file.mesh(square)
    with pytest.raises(MeshError, match="index 9 of 4 vertices"):
        load_mesh(file.write(tmp_path / "index.glb"))
    file = one_square()
    path = file.write(tmp_path / "short.glb")
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(MeshError, match="ends beyond its buffer"):
        load_mesh(path)
    file = one_square()
    file.tree["accessors"][0]["count"] = 4000
    with pytest.raises(MeshError, match="not valid glTF"):
        load_mesh(file.write(tmp_path / "count.glb"))
    file = GltfFile(textures=[{"extensions": {"KHR_texture_basisu": {"source": 0}}}])
    file.tree["materials"] = [{"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}}]
    file.mesh(file.square(material=0))
    with pytest.raises(MeshError, match="of a kind that is not read"):
        load_mesh(file.write(tmp_path / "ktx.glb"))
    file = GltfFile()
    number = file.texture(GREY)
    file.tree["bufferViews"][0]["byteLength"] = 20
    file.tree["materials"] = [{"normalTexture": {"index": number}}]
    file.mesh(file.square(material=0))
    with pytest.raises(MeshError, match="texture cannot be read"):
        load_mesh(file.write(tmp_path / "png.glb"))


def test_a_missing_buffer_is_named(tmp_path: Path) -> None:
    path = tmp_path / "apart.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "buffers": [{"uri": "the%20mesh.bin", "byteLength": 4}]}')
    with pytest.raises(MeshError, match=r"a buffer is missing .*the%20mesh\.bin"):
        load_mesh(path)
    (tmp_path / "the mesh.bin").write_bytes(b"1234")
    with pytest.raises(MeshError, match="no triangles"):
        load_mesh(path)


def every_place(tree: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys to everything in nested dictionaries and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield (*place, key)
        yield from every_place(value, (*place, key))


@pytest.mark.parametrize("length", [-1, 0])
def test_nothing_is_read_behind_an_empty_part_of_a_buffer(tmp_path: Path, length: int) -> None:
    file = GltfFile()
    square = file.square()
    file.mesh(square)
    view = file.tree["accessors"][square["attributes"]["POSITION"]]["bufferView"]
    file.tree["bufferViews"][view]["byteLength"] = length
    with pytest.raises(MeshError, match=f"buffer view {view} has {length} bytes"):
        load_mesh(file.write(tmp_path / "empty.glb"))


@pytest.mark.parametrize("value", [None, -1, "x", 10**9])
def test_a_damaged_file_is_read_or_refused(tmp_path: Path, value: object) -> None:
    """Whatever one entry of the JSON is replaced by, nothing but `MeshError` is raised."""
    file = GltfFile(scenes=[{"nodes": [0]}], scene=0)
    texture = {"index": file.texture(GREY, wrapS=33071), "texCoord": 0}
    file.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": texture}, "emissiveFactor": [1, 1, 1]}]
    square = file.square(material=0)
    square["attributes"] |= {
        "JOINTS_0": file.accessor([[0, 0, 0, 0]] * 4, "u1"), "WEIGHTS_0": file.accessor([[1, 0, 0, 0]] * 4)
    }  # fmt: skip
    file.mesh({**square, "targets": [{"POSITION": square["attributes"]["POSITION"]}]}, weights=[0.5])
    file.tree |= {
        "skins": [{"joints": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0, "children": [1]}, {"scale": [1, 1, 1]}],
    }
    whole = copy.deepcopy(file.tree)
    load_mesh(file.write(tmp_path / "whole.glb"))
    for *keys, last in every_place(whole):
        file.tree = copy.deepcopy(whole)
        entry = file.tree
        for key in keys:
            entry = entry[key]
        entry[last] = value
        with contextlib.suppress(MeshError):
            load_mesh(file.write(tmp_path / "damaged.glb"))


def test_what_is_not_drawn_is_said_once_with_what_is_drawn_instead(tmp_path: Path) -> None:
    file = GltfFile(
        extensionsUsed=["KHR_materials_clearcoat", "KHR_materials_transmission", "KHR_materials_variants", "ACME_fur"],
        scenes=[{"nodes": [0, 1, 2]}, {"name": "inside", "nodes": [0]}],
        cameras=[{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
        nodes=[{"mesh": 0}, {"camera": 0}, {"camera": 0}],
        scene=1,
        materials=[{}],
    )
    file.mesh(file.square(material=0))
    inside = load_mesh(file.write(tmp_path / "inside.glb"))
    for words in (
        "clear coat) is not drawn - what is below",
        "alphaMode BLEND",
        "variants of materials",
        "ACME_fur is",
    ):
        assert said(inside, words)
    assert said(inside, "2 scenes - 'inside' is drawn")
    assert not any("camera" in note for note in inside.notes)
    file.tree["scene"] = 0
    outside = load_mesh(file.write(tmp_path / "outside.glb"))
    assert said(outside, "2 scenes - 0 is drawn")
    assert sum("camera" in note for note in outside.notes) == 1
