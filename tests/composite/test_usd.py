# SPDX-License-Identifier: Apache-2.0
"""USD files show what the same bodies show as glTF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.composite import load_mesh
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.reference import render_layer
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import load_object
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile
from tests.composite.scenes import placed, shot, sphere
from tests.composite.usd_files import (
    CORNERS,
    Gf,
    Sdf,
    Usd,
    UsdGeom,
    UsdShade,
    add_material,
    add_mesh,
    add_square,
    add_texture,
    bind,
    new_stage,
    packed,
    write_png,
)  # fmt: skip


def saved(stage: Any) -> Path:
    stage.GetRootLayer().Save()
    return Path(stage.GetRootLayer().realPath)


def said(mesh: Mesh, text: str) -> bool:
    return any(text in note for note in mesh.notes)


# --- the same picture ----------------------------------------------------------------------------------------------


def maps(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return code values (8, 8, 3) of a base, an occlusion-roughness-metallic and a normal map."""
    base, orm = rng.integers(40, 250, (2, 8, 8, 3), np.uint8)
    normal = np.concatenate([rng.integers(110, 146, (8, 8, 2), np.uint8), np.full((8, 8, 1), 250, np.uint8)], axis=-1)
    return base, orm, normal


def as_gltf(body: Mesh, images: Any, path: Path) -> Path:
    file = GltfFile()
    base, orm, normal = (file.texture(image) for image in images)
    file.tree["materials"] = [
        {
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.8, 0.9, 1.0, 1.0],
                "baseColorTexture": {"index": base},
                "metallicRoughnessTexture": {"index": orm},
            },
            "normalTexture": {"index": normal},
            "occlusionTexture": {"index": orm},
            "extensions": {"KHR_materials_ior": {"ior": 1.4}},
        }
    ]
    attributes = {"POSITION": body.positions, "NORMAL": body.normals, "TEXCOORD_0": body.uv}
    numbers = {name: file.accessor(values.reshape(-1, values.shape[-1])) for name, values in attributes.items()}
    file.mesh({"attributes": numbers, "material": 0})
    return file.write(path)


def as_usd(body: Mesh, images: Any, path: Path) -> Path:
    """The body in centimetres, z up, turned and moved by two prims, its maps apart, in a package."""
    names = [write_png(path.with_name(f"{k}.png"), image) for k, image in enumerate(images)]
    stage = new_stage(path, up="Z", metres=0.01)
    top = UsdGeom.Xform.Define(stage, "/top")
    top.AddTranslateOp().Set(Gf.Vec3d(100.0, 20.0, -50.0))
    points = 100.0 * body.positions.reshape(-1, 3)[:, [0, 2, 1]] * [1.0, -1.0, 1.0]  # (x, -z, y)
    points = points - [100.0, 20.0, -50.0]
    below = UsdGeom.Xform.Define(stage, "/top/below")
    below.AddRotateZOp().Set(90.0)
    points = points[:, [1, 0, 2]] * [1.0, -1.0, 1.0]  # a quarter turn back
    normals = body.normals.reshape(-1, 3)[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    normals = normals[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    faces = np.arange(len(points)).reshape(-1, 3)
    st = body.uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]
    mesh = add_mesh(stage, "/top/below/body", points, faces, normals=normals, st=st)
    base = add_texture(stage, "/look/base", names[0], scale=Gf.Vec4f(0.8, 0.9, 1.0, 1.0), sourceColorSpace="sRGB")
    data = {
        name: add_texture(stage, f"/look/{name}", names[1], output, sourceColorSpace="raw")
        for name, output in (("occlusion", "r"), ("roughness", "g"), ("metallic", "b"))
    }
    bump = add_texture(
        stage,
        "/look/normal",
        names[2],
        scale=Gf.Vec4f(2, 2, 2, 1),
        bias=Gf.Vec4f(-1, -1, -1, 0),
        sourceColorSpace="raw",
    )
    bind(mesh, add_material(stage, "/look", diffuseColor=base, normal=bump, ior=1.4, **data))
    return packed(saved(stage))


def test_the_same_body_is_the_same_picture_as_glTF_and_as_USD(tmp_path: Path, rng: np.random.Generator) -> None:
    body, images = sphere(rows=8), maps(rng)
    pictures = []
    for path in (as_gltf(body, images, tmp_path / "body.glb"), as_usd(body, images, tmp_path / "body.usdc")):
        mesh = load_object(ObjectSettings(mesh=path)).meshes[0]
        assert not mesh.notes
        tiles = render_layer(shot(placed(mesh, (0.1, -0.2, -1.0)), width=48)).tiles
        pictures.append(
            np.concatenate([np.concatenate([t.radiance, t.alpha[..., None]], -1).reshape(-1, 4) for t in tiles])
        )
    one, other = pictures
    assert np.mean(one[:, 3] > 0.5) > 0.1
    np.testing.assert_allclose(other, one, atol=tol.FLOAT32)


# --- geometry ------------------------------------------------------------------------------------------------------


def middles(mesh: Mesh) -> np.ndarray:
    """Return the middles (n, 3) of a mesh's squares."""
    return mesh.positions.reshape(-1, 6, 3).mean(axis=1)


def facing(mesh: Mesh) -> np.ndarray:
    e1, e2 = mesh.positions[:, 1] - mesh.positions[:, 0], mesh.positions[:, 2] - mesh.positions[:, 0]
    return np.cross(e1, e2)


def test_instances_stand_where_they_are_put(tmp_path: Path) -> None:
    """A prototype that two prims refer to, one mirrored, and a cloud of points of which one is masked."""
    stage = new_stage(tmp_path / "many.usda")
    add_square(stage, "/square/shape")
    for name, x in (("left", -5.0), ("right", 5.0)):
        xform = UsdGeom.Xform.Define(stage, f"/{name}")
        xform.AddTranslateOp().Set(Gf.Vec3d(x, 0, 0))
        if name == "right":
            xform.AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
        xform.GetPrim().GetReferences().AddInternalReference("/square")
        xform.GetPrim().SetInstanceable(True)
    cloud = UsdGeom.PointInstancer.Define(stage, "/cloud")
    add_square(stage, "/cloud/kinds/one")
    UsdGeom.Xformable(stage.GetPrimAtPath("/cloud/kinds/one")).AddTranslateOp().Set(Gf.Vec3d(0, 7, 0))
    cloud.CreatePrototypesRel().AddTarget("/cloud/kinds/one")
    cloud.CreateProtoIndicesAttr([0, 0, 0])
    cloud.CreatePositionsAttr([(0, 0, 0), (0, 0, 3), (0, 0, 9)])
    cloud.CreateScalesAttr([(1, 1, 1), (2, 1, 1), (1, 1, 1)])
    cloud.GetPrim().CreateAttribute("ids", Sdf.ValueTypeNames.Int64Array).Set([4, 5, 6])
    cloud.InvisId(6, Usd.TimeCode.Default())
    UsdGeom.Xformable(cloud).AddTranslateOp().Set(Gf.Vec3d(0, 10, 0))
    mesh = load_mesh(saved(stage))
    found = middles(mesh).round(5).tolist()
    expected = [[0.5, 0.5, 0], [-4.5, 0.5, 0], [4.5, 0.5, 0], [0.5, 17.5, 0], [1.0, 17.5, 3]]
    assert sorted(found) == sorted(expected)
    assert np.all(facing(mesh)[:, 2] > 0.0) == np.all(mesh.normals[..., 2] > 0.0)
    # the mirrored one faces the same way: a mirror along x leaves +z
    np.testing.assert_allclose(np.sign(facing(mesh)[:, 2]), 1.0)
    assert len(load_mesh(tmp_path / "many.usda", part="right").positions) == 2


def test_what_is_hidden_is_not_drawn_and_what_is_no_mesh_is_noted(tmp_path: Path) -> None:
    stage = new_stage(tmp_path / "hidden.usda")
    add_square(stage, "/shown")
    add_square(stage, "/away/hidden")
    UsdGeom.Xform.Define(stage, "/away").MakeInvisible()
    add_square(stage, "/proxy").CreatePurposeAttr("proxy")
    UsdGeom.Sphere.Define(stage, "/ball")
    moving = UsdGeom.Xformable(stage.GetPrimAtPath("/shown")).AddTranslateOp()
    moving.Set(Gf.Vec3d(1, 0, 0), 1.0)
    moving.Set(Gf.Vec3d(2, 0, 0), 2.0)
    mesh = load_mesh(saved(stage))
    np.testing.assert_allclose(middles(mesh), [[1.5, 0.5, 0.0]])
    assert said(mesh, "Sphere, which is not drawn")
    assert said(mesh, "moves - it is drawn as it is first")
    assert said(mesh, "without material and colours")


@pytest.mark.parametrize("metres", [1.0, 0.01])
def test_the_unit_of_the_file_holds_unless_another_is_asked_for(tmp_path: Path, metres: float) -> None:
    stage = new_stage(tmp_path / "size.usda", metres=metres)
    add_square(stage, "/square")
    path = saved(stage)
    np.testing.assert_allclose(load_mesh(path).extent_m, [metres, metres, 0.0], atol=tol.FLOAT32)
    np.testing.assert_allclose(load_mesh(path, "mm").extent_m, [1e-3, 1e-3, 0.0], atol=tol.FLOAT32)


ARROW = np.array([[0, 0], [2, 0], [2, 2], [1, 0.5], [0, 2]], np.float32)
DART = np.array([[0, 0.5], [1, 0], [0.2, 0.5], [1, 1]], np.float32)


@pytest.mark.parametrize("outline", [ARROW, np.roll(ARROW, 2, axis=0), DART, np.roll(DART, 1, axis=0), ARROW[::-1]])
def test_concave_polygons_are_covered_once(tmp_path: Path, outline: np.ndarray) -> None:
    points = np.pad(outline, ((0, 0), (0, 1)))
    stage = new_stage(tmp_path / "polygon.usda")
    add_mesh(stage, "/polygon", points, [range(len(points))])
    mesh = load_mesh(saved(stage))
    x, y = outline.astype(float).T
    signed = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    areas = 0.5 * facing(mesh)[:, 2]
    assert np.all(areas * np.sign(signed) > 0.0)
    np.testing.assert_allclose(areas.sum(), signed, rtol=tol.FLOAT32)


def test_handedness_holes_and_normals(tmp_path: Path) -> None:
    stage = new_stage(tmp_path / "three.usda")
    points = np.concatenate([CORNERS + np.array([2 * k, 0, 0]) for k in range(3)])
    faces = [[4 * k + j for j in range(4)] for k in range(3)]
    left = add_mesh(stage, "/left", points, faces, orientation="leftHanded")
    left.CreateHoleIndicesAttr([1])
    by_face = [[0, 0.6, 0.8], [0, 0, 1], [0.6, 0, 0.8]]
    add_mesh(stage, "/flat", points + np.array([0, 9, 0]), faces, normals=by_face, normals_by="uniform")
    bend = [[-1, 0, 0.5], [0, 0, 0], [0, 1, 0], [-1, 1, 0.5], [1, 0, 0.5], [1, 1, 0.5]]
    add_mesh(stage, "/soft", bend, [[0, 1, 2, 3], [1, 4, 5, 2]], scheme="catmullClark")
    path = saved(stage)
    mirrored = load_mesh(path, part="left")
    assert len(mirrored.positions) == 4
    assert np.all(facing(mirrored)[:, 2] < 0.0)
    np.testing.assert_allclose(mirrored.normals[..., 2], -1.0)
    flat = load_mesh(path, part="flat")
    np.testing.assert_allclose(flat.normals, np.repeat(by_face, 6, axis=0).reshape(6, 3, 3), atol=tol.FLOAT32)
    soft = load_mesh(path, part="soft")
    assert said(soft, "subdivision surface")
    on_edge = soft.positions[..., 0] == 0.0
    np.testing.assert_allclose(soft.normals[on_edge][:, 2], 1.0, atol=tol.FLOAT32)


# --- materials -----------------------------------------------------------------------------------------------------


def square_of(folder: Path, **inputs: Any) -> Any:
    """Return a stage with a square of a material and the material's prim."""
    stage = new_stage(folder / "square.usda")
    made = {name: make(stage) if callable(make) else make for name, make in inputs.items()}
    bind(add_square(stage, "/square"), add_material(stage, "/look", **made))
    return stage


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        (
            {"diffuseColor": (0.1, 0.2, 0.3), "metallic": 0.7, "roughness": 0.2, "emissiveColor": (1.0, 2.0, 3.0)},
            {"base_color": (0.1, 0.2, 0.3, 1.0), "metallic": 0.7, "roughness": 0.2, "emission": (1.0, 2.0, 3.0)},
        ),
        ({}, {"base_color": (0.18, 0.18, 0.18, 1.0), "metallic": 0.0, "roughness": 0.5, "refractive_index": 1.5}),
        ({"opacity": 0.25}, {"alpha_mode": "BLEND", "base_color": (0.18, 0.18, 0.18, 0.25)}),
        ({"opacity": 0.25, "opacityThreshold": 0.4}, {"alpha_mode": "MASK", "alpha_cutoff": 0.4}),
        ({"ior": 1.33}, {"refractive_index": 1.33}),
        ({"useSpecularWorkflow": 1, "metallic": 1.0}, {"metallic": 0.0}),
    ],
)
def test_constants_of_a_surface(tmp_path: Path, inputs: dict[str, Any], expected: dict[str, Any]) -> None:
    (material,) = load_mesh(saved(square_of(tmp_path, **inputs))).materials
    for name, value in expected.items():
        found = getattr(material, name)
        assert found == value if isinstance(value, str) else found == pytest.approx(value, rel=tol.FLOAT32), name
    assert not material.double_sided
    assert not material.maps


def test_maps_of_one_channel_are_joined(tmp_path: Path) -> None:
    """Roughness from a small map, metalness constant, opacity from a large one, a normal map with y down."""
    rgba = np.zeros((4, 4, 4), np.uint8)
    rgba[...] = (10, 60, 200, 128)
    small = np.full((2, 2, 3), (20, 40, 80), np.uint8)
    color, rough = write_png(tmp_path / "color.png", rgba), write_png(tmp_path / "rough.png", small)
    down = {"scale": Gf.Vec4f(1, -1, 1, 1), "bias": Gf.Vec4f(-0.5, 0.5, -0.5, 0)}
    stage = square_of(
        tmp_path,
        diffuseColor=lambda s: add_texture(s, "/look/a", rough, wrapS="mirror", wrapT="black"),
        opacity=lambda s: add_texture(s, "/look/b", color, "a"),
        roughness=lambda s: add_texture(s, "/look/c", rough, "g", scale=Gf.Vec4f(1, 0.5, 1, 1)),
        metallic=0.25,
        occlusion=lambda s: add_texture(s, "/look/d", color, "b", bias=Gf.Vec4f(0, 0, 0.1, 0)),
        normal=lambda s: add_texture(s, "/look/e", rough, **down),
    )
    mesh = load_mesh(saved(stage))
    (m,) = mesh.materials
    assert not mesh.notes
    assert m.base_map.size == (4, 4)
    assert m.base_map.wrap == ("mirror", "clamp")
    np.testing.assert_allclose(m.base_map.levels[0][..., 3], 128 / 255, rtol=1e-3)  # half floats
    assert m.base_map.levels[0][0, 0, 0] < 20 / 255  # decoded from sRGB
    np.testing.assert_allclose(m.metallic_roughness_map.levels[0][..., 1:3], [[[40 / 255, 1.0]] * 2] * 2, rtol=1e-3)
    assert (m.roughness, m.metallic) == (0.5, 0.25)
    np.testing.assert_allclose(m.occlusion_map.levels[0][..., 0], 200 / 255 + 0.1, rtol=1e-3)
    np.testing.assert_allclose(m.normal_map.levels[0][0, 0, :2], [20 / 255, 215 / 255], rtol=1e-3)
    assert (m.normal_scale, m.alpha_mode) == (0.5, "BLEND")


def test_texture_coordinates_are_scaled_turned_and_moved(tmp_path: Path) -> None:
    name = write_png(tmp_path / "a.png", np.full((2, 2, 3), 90, np.uint8))
    moved = (90.0, Gf.Vec2f(2.0, 1.0), Gf.Vec2f(0.25, 0.0))
    stage = square_of(
        tmp_path,
        diffuseColor=lambda s: add_texture(s, "/look/a", name, transform=moved),
        roughness=lambda s: add_texture(s, "/look/b", name, "r"),
    )
    mesh = load_mesh(saved(stage))
    at = {tuple(p[:2]): uv for p, uv in zip(mesh.positions.reshape(-1, 3), mesh.uv.reshape(-1, 2), strict=True)}
    # st (1, 0) is scaled to (2, 0), turned to (0, 2), moved to (0.25, 2): v counts down from the top
    np.testing.assert_allclose(at[1.0, 0.0], [0.25, 1.0 - 2.0], atol=tol.FLOAT32)
    np.testing.assert_allclose(at[0.0, 1.0], [0.25 - 1.0, 1.0], atol=tol.FLOAT32)
    assert said(mesh, "roughness with texture coordinates of its own")


def test_subsets_colours_and_sides(tmp_path: Path) -> None:
    stage = new_stage(tmp_path / "parts.usda")
    points = np.concatenate([CORNERS + np.array([2 * k, 0, 0]) for k in range(3)])
    mesh = add_mesh(stage, "/strip", points, [[4 * k + j for j in range(4)] for k in range(3)], doubleSided=True)
    bind(mesh, add_material(stage, "/red", diffuseColor=(1.0, 0.0, 0.0)))
    subset = UsdShade.MaterialBindingAPI(mesh).CreateMaterialBindSubset("middle", [1])
    bind(subset, add_material(stage, "/green", diffuseColor=(0.0, 1.0, 0.0)))
    painted = add_square(stage, "/painted")
    color = painted.CreateDisplayColorPrimvar("uniform")
    color.Set([(0.2, 0.4, 0.6)])
    read = load_mesh(saved(stage))
    by_place = {
        round(float(p[:, 0].mean()) // 2): m for p, m in zip(read.positions[:6], read.material[:6], strict=True)
    }
    assert [read.materials[by_place[k]].name for k in range(3)] == ["red", "green", "red"]
    assert [m.double_sided for m in read.materials] == [True, True, False]
    np.testing.assert_allclose(read.colors[6:, :, :3], np.broadcast_to([0.2, 0.4, 0.6], (2, 3, 3)), atol=tol.FLOAT32)
    assert read.materials[2].base_color == (1.0, 1.0, 1.0, 1.0)


def test_other_surfaces_and_nodes_are_noted(tmp_path: Path) -> None:
    stage = square_of(tmp_path, clearcoat=0.5, diffuseColor=lambda s: add_texture(s, "/look/a", "./tile.<UDIM>.png"))
    other = UsdShade.Material.Define(stage, "/other")
    shader = UsdShade.Shader.Define(stage, "/other/x")
    shader.CreateIdAttr("ND_standard_surface_surfaceshader")
    other.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    bind(add_square(stage, "/second"), other)
    mesh = load_mesh(saved(stage))
    for text in ("clear coat", "tiled textures", "'other' has no UsdPreviewSurface"):
        assert said(mesh, text), mesh.notes


def test_a_file_that_changed_is_read_again(tmp_path: Path) -> None:
    stage = new_stage(tmp_path / "square.usda")
    add_square(stage, "/square")
    path = saved(stage)
    text = path.read_text()
    del stage
    assert len(load_mesh(path).positions) == 2
    path.write_text(text.replace("(1, 1, 0)", "(1, 3, 0)"))
    np.testing.assert_allclose(load_mesh(path).extent_m, [1.0, 3.0, 0.0], atol=tol.FLOAT32)


# --- what cannot be read -------------------------------------------------------------------------------------------


def test_layers_are_composed_and_must_lie_in_the_folder(tmp_path: Path) -> None:
    for folder in ("in/sub", "out"):
        (tmp_path / folder).mkdir(parents=True)
        part = new_stage(tmp_path / folder / "part.usdc")
        add_square(part, "/part")
        part.SetDefaultPrim(part.GetPrimAtPath("/part"))
        saved(part)
    for name, asset in (("good", "./sub/part.usdc"), ("bad", "../out/part.usdc"), ("gone", "./sub/none.usdc")):
        stage = new_stage(tmp_path / "in" / f"{name}.usda")
        stage.DefinePrim("/a").GetReferences().AddReference(asset)
        # composed by the reader: here the missing layer would be a warning on the terminal
        stage.GetRootLayer().Save()
    assert len(load_mesh(tmp_path / "in" / "good.usda").positions) == 2
    with pytest.raises(MeshError, match="names a layer outside of its folder"):
        load_mesh(tmp_path / "in" / "bad.usda")
    assert len(load_mesh(tmp_path / "in" / "bad.usda", outside=True).positions) == 2
    with pytest.raises(MeshError, match="a layer is missing"):
        load_mesh(tmp_path / "in" / "gone.usda")


def test_damaged_files_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, data in (("a.usda", b"#usda 1.0\n def {"), ("a.usdc", b"PXR-USDC" + bytes(99)), ("a.usdz", b"PK" * 40)):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(MeshError, match="is not valid USD"):
            load_mesh(tmp_path / name)
    stage = new_stage(tmp_path / "counts.usda")
    mesh = add_square(stage, "/square")
    mesh.CreateFaceVertexCountsAttr([3])
    with pytest.raises(MeshError, match="4 corners for polygons of 3"):
        load_mesh(saved(stage))
    for inputs in (
        {"diffuseColor": (-0.1, 0.2, 0.3)},
        {"roughness": float("nan")},
        {"emissiveColor": (-1.0, 0.0, 0.0)},
    ):
        with pytest.raises(MeshError, match="a factor of material 'look' that is negative or not finite"):
            load_mesh(saved(square_of(tmp_path, **inputs)))
    stage = new_stage(tmp_path / "unit.usda", metres=-1.0)
    add_square(stage, "/square").CreateDisplayColorAttr([(-1, 0, 0)])
    with pytest.raises(MeshError, match="a colour is negative: -1"):
        load_mesh(saved(stage))
    stage.RemovePrim("/square")
    with pytest.raises(MeshError, match="a unit of -1 m"):
        load_mesh(saved(stage))
    stage = square_of(tmp_path, diffuseColor=lambda s: add_texture(s, "/look/a", "./gone.png"))
    with pytest.raises(MeshError, match="a texture is missing"):
        load_mesh(saved(stage))
    with pytest.raises(MeshError, match="no triangles"):
        load_mesh(saved(new_stage(tmp_path / "empty.usda")))
    monkeypatch.setenv("MR360UW_MAX_TRIANGLES", "0.000001")
    stage = new_stage(tmp_path / "many.usda")
    add_square(stage, "/square")
    with pytest.raises(MeshError, match="MR360UW_MAX_TRIANGLES"):
        load_mesh(saved(stage))
