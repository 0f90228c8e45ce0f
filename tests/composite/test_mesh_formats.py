# SPDX-License-Identifier: Apache-2.0
"""OBJ, PLY and STL as exporters write them: what is in the files is drawn or said."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from mr360uw.composite import Mesh, load_mesh, load_object
from mr360uw.composite.mesh.up_axis import UPRIGHT, Up
from mr360uw.composite.settings import ObjectSettings
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol

SQUARE = "v -0.5 0 0\nv 0.5 0 0\nv 0.5 1 0\nv -0.5 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n"
RED = [1.0, 0.0, 0.0]


def picture(path: Path, color: tuple[int, ...] = (255, 0, 0)) -> None:
    path.parent.mkdir(exist_ok=True)
    Image.new("RGBA" if len(color) == 4 else "RGB", (4, 4), color).save(path)


def obj(folder: Path, library: str | bytes, geometry: str = "mtllib a.mtl\n" + SQUARE, name: str = "a.obj") -> Mesh:
    """Return the mesh of an OBJ with a library."""
    (folder / "a.mtl").write_bytes(library if isinstance(library, bytes) else library.encode())
    (folder / name).write_text(geometry, encoding="utf-8")
    return load_mesh(folder / name)


def is_red(mesh: Mesh) -> bool:
    base = mesh.materials[int(mesh.material[0])].base_map
    return base is not None and np.allclose(base.levels[0][0, 0, :3], RED, atol=tol.HALF_FLOAT)


@pytest.mark.parametrize(
    "line",
    [
        "map_Kd tex a.png", "map_Kd -s 1 1 1 -o 0 0 0 tex a.png", "map_Kd -clamp on tex a.png", "MAP_KD tex a.png",
        "map_Kd -mm 0 1 -blendu off -blendv off -texres 512 tex a.png", "map_Kd -imfchan r -bm 1.0 -t 0 0 0 tex a.png",
        "map_Kd tex a.png # colour", 'map_Kd "tex a.png"', "map_Kd C:\\Users\\me\\ship\\TEX A.PNG", "map_Ka tex a.png",
        "map_Kd /home/me/tex a.png", "Kd 0 0 0\r\nmap_Kd tex a.png\r", "map_Kd Textures\\tex a.png",
    ],
)  # fmt: skip
@pytest.mark.parametrize("folder", ["", "Textures", "maps"])
def test_maps_are_found_as_exporters_name_them(tmp_path: Path, line: str, folder: str) -> None:
    picture(tmp_path / folder / "tex a.png")
    mesh = obj(tmp_path, f"\ufeffnewmtl m\nKd 0.8 0.8 0.8\n{line}\n")
    assert is_red(mesh)
    assert mesh.notes == ()


@pytest.mark.parametrize(
    "line",
    ["mtllib a.mtl b.mtl", "mtllib a.mtl\nmtllib b.mtl", 'mtllib "b.mtl"', "mtllib C:\\me\\B.mtl",
     "mtllib my b.mtl a.mtl", "MTLLIB b.mtl # library", "mtllib ./b.mtl"],
)  # fmt: skip
def test_libraries_are_found_as_exporters_name_them(tmp_path: Path, line: str) -> None:
    picture(tmp_path / "tex.png")
    for name in ("b.mtl", "my b.mtl"):
        (tmp_path / name).write_text('newmtl "M"\nmap_Kd tex.png\n')
    assert is_red(
        obj(tmp_path, "newmtl other\nKd 1 0 0\n", f"\ufeff{line}\r\n" + SQUARE.replace("\n", "\r\n"), "x.obj")
    )


def test_names_in_the_code_page_of_windows(tmp_path: Path) -> None:
    picture(tmp_path / "Körper.png")
    assert is_red(obj(tmp_path, "newmtl m\nmap_Kd Körper.png\n".encode("cp1252")))


def test_what_is_missing_is_said_with_where_it_was_looked_for(tmp_path: Path) -> None:
    gone = obj(tmp_path, "", "mtllib gone.mtl\n" + SQUARE, "ship.obj")
    assert "library is missing (got 'gone.mtl'; looked for there" in gone.notes[0]
    (tmp_path / "ship.mtl").write_text("newmtl m\nKd 1 0 0\n")  # both were renamed: the OBJ still has the old name
    assert load_mesh(tmp_path / "ship.obj").materials[0].base_color == (1.0, 0.0, 0.0, 1.0)
    with pytest.raises(
        MeshError, match=r"texture is missing \(got 'x.png'; looked for there, .* textures, texture, tex"
    ):
        obj(tmp_path, "newmtl m\nmap_Kd x.png\n")
    assert "material 'm' is in no library" in obj(tmp_path, "newmtl n\nKd 1 0 0\n").notes[0]


def test_a_bare_name_does_not_leave_the_folder(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    picture(tmp_path / "tex.png")
    with pytest.raises(MeshError, match="texture outside of its folder"):
        obj(inner, "newmtl m\nmap_Kd ../tex.png\n")
    (inner / "tex.png").symlink_to(tmp_path / "tex.png")
    with pytest.raises(MeshError, match="texture outside of its folder"):
        obj(inner, "newmtl m\nmap_Kd ../tex.png\n")


def test_options_move_and_clamp_a_map(tmp_path: Path) -> None:
    picture(tmp_path / "tex.png")
    mesh = obj(tmp_path, "newmtl m\nmap_Kd -o 0.25 0.5 -s 2 -clamp on tex.png\n")
    corner = mesh.uv[np.all(np.isclose(mesh.positions, [0.5, 0.0, 0.0]), axis=-1)][0]  # vt 1 0
    np.testing.assert_allclose(corner, [2.0 * 1.0 + 0.25, 1.0 - 0.5], atol=tol.FLOAT32)
    base = mesh.materials[0].base_map
    assert base is not None
    assert base.wrap == ("clamp", "clamp")


def test_physically_based_words_of_a_library(tmp_path: Path) -> None:
    for name, color in (
        ("rough", (64,) * 3),
        ("metal", (255,) * 3),
        ("normal", (128, 128, 255)),
        ("height", (90,) * 3),
    ):
        picture(tmp_path / f"{name}.png", color)
    mesh = obj(
        tmp_path, "newmtl m\nKd 1 1 1\nPr 0.3\nPm 0.9\nKe 1 0 0\nd 0.5\nnorm -bm 0.5 normal.png\nmap_Ke metal.png\n"
    )
    material = mesh.materials[0]
    assert (material.roughness, material.metallic, material.emission) == (0.3, 0.9, (1.0, 0.0, 0.0))
    assert (material.base_color[3], material.alpha_mode, material.normal_scale) == (0.5, "BLEND", 0.5)
    assert material.normal_map is not None
    assert material.emission_map is not None
    mapped = obj(tmp_path, "newmtl m\nmap_Pr rough.png\nmap_Pm metal.png\nmap_Bump -bm 1 normal.png\nTr 1\n").materials[
        0
    ]
    assert mapped.metallic_roughness_map is not None
    np.testing.assert_allclose(mapped.metallic_roughness_map.levels[0][0, 0, 1:3], [64 / 255, 1.0], atol=tol.HALF_FLOAT)
    assert mapped.normal_map is not None
    assert mapped.alpha_mode == "OPAQUE"
    said = obj(tmp_path, "newmtl m\nbump height.png\nmap_Ks metal.png\nmap_Ke gone.png\n").notes
    assert [
        any(word in note for note in said) for word in ("has map_ks, bump, not drawn", "map_ks", "map_ke is not")
    ] == [True] * 3


def test_map_d_cuts_out(tmp_path: Path) -> None:
    picture(tmp_path / "leaf.png", (255, 0, 0, 0))
    material = obj(tmp_path, "newmtl m\nmap_Kd leaf.png\nmap_d leaf.png\n").materials[0]
    assert (material.alpha_mode, float(material.base_map.levels[0][0, 0, 3])) == ("MASK", 0.0)
    assert "clear in places" in obj(tmp_path, "newmtl m\nmap_Kd leaf.png\n").notes[0]


def test_polygons_counted_back_concave_and_with_colours(tmp_path: Path) -> None:
    arrow = "v 0 0 0 1 0 0\nv 2 1 0 1 0 0\nv 0 2 0 1 0 0\nv 1.5 1 0 1 0 0\nf -4 -3 -2 -1\n"
    path = tmp_path / "a.obj"
    path.write_text(
        arrow + arrow.replace("v 0", "v 5").replace("v 2", "v 7").replace("v 1.5", "v 6.5") + "l 1 2\np 1\n"
    )
    mesh = load_mesh(path)
    a, b, c = (mesh.positions[:, k] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    np.testing.assert_allclose(area.sum(), 2 * 0.5, rtol=tol.FLOAT32)  # two arrow heads of 2 - 1.5
    np.testing.assert_allclose(mesh.extent_m, [7.0, 2.0, 0.0], atol=tol.FLOAT32)
    np.testing.assert_allclose(mesh.colors[..., :3], np.broadcast_to(RED, (4, 3, 3)))
    assert mesh.materials[0].base_color == (1.0, 1.0, 1.0, 1.0)
    assert "points or lines" in mesh.notes[0]


def ply(
    path: Path,
    vertex: str = "",
    face: str = "",
    values: tuple[str, str] = ("", ""),
    more: str = "",
    kind: str = "float",
) -> Mesh:
    """Return the mesh of a PLY of two triangles with more properties; values: what these are."""
    axes = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\n{more}element vertex 4\n{axes}{vertex}element face 2\n"
    head += f"property list uchar int vertex_indices\n{face}end_header\n"
    rows = [f"{p} {values[0]}" for p in ("-0.5 0 0", "0.5 0 0", "0.5 1 0", "-0.5 1 0")]
    rows += [f"3 {p} {values[1]}" for p in ("0 1 2", "0 2 3")]
    path.write_text(head + "\n".join(rows) + "\n")
    return load_mesh(path)


def properties(kind: str, *names: str) -> str:
    return "".join(f"property {kind} {name}\n" for name in names)


@pytest.mark.parametrize("prefix", ["", "diffuse_"])
@pytest.mark.parametrize(
    ("kind", "red"),
    [("uchar", "255 0 0"), ("ushort", "65535 0 0"), ("float", "1 0 0"), ("float", "255 0 0"), ("int", "255 0 0")],
)
@pytest.mark.parametrize("of_faces", [False, True])
def test_colours_of_a_ply(tmp_path: Path, prefix: str, kind: str, red: str, of_faces: bool) -> None:
    names = properties(kind, *(prefix + name for name in ("red", "green", "blue")))
    mesh = ply(tmp_path / "a.ply", *(("", names, ("", red)) if of_faces else (names, "", (red, ""))))
    np.testing.assert_allclose(mesh.colors[..., :3], np.broadcast_to(RED, (2, 3, 3)), atol=tol.FLOAT32)
    assert mesh.materials[0].base_color == (1.0, 1.0, 1.0, 1.0)
    assert mesh.notes == ()


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_textures_of_a_ply(tmp_path: Path, names: tuple[str, str]) -> None:
    picture(tmp_path / "textures" / "t 1.png")
    comment = "comment TextureFile T 1.png\n"
    mesh = ply(tmp_path / "a.ply", properties("float", *names), "", ("0.25 0.25", ""), comment)
    assert is_red(mesh)
    np.testing.assert_allclose(mesh.uv, np.broadcast_to([0.25, 0.75], (2, 3, 2)), atol=tol.FLOAT32)
    faces = "property list uchar float texcoord\n"
    assert is_red(ply(tmp_path / "b.ply", "", faces, ("", "6 0 0 1 0 1 1"), comment))


def test_what_a_ply_holds_and_does_not_draw_is_said(tmp_path: Path) -> None:
    alpha = properties("uchar", "red", "green", "blue", "alpha")
    path = tmp_path / "a.ply"
    ply(path, alpha, "", ("255 0 0 255", ""))
    path.write_text(path.read_text().replace("255 0 0 255", "255 0 0 9", 1))
    assert "clear in places (alpha)" in load_mesh(path).notes[0]
    ply(path, properties("float", "quality"), "", ("0.5", ""))
    assert load_mesh(path).notes == ()  # all the same: no picture is lost
    path.write_text(path.read_text().replace("0.5 0 0 0.5", "0.5 0 0 0.7", 1))
    assert "has quality of its vertices" in load_mesh(path).notes[0]


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_plys_may_mix_triangles_and_quadrangles(tmp_path: Path, order: str) -> None:
    form = "little" if order == "<" else "big"
    head = f"ply\nformat binary_{form}_endian 1.0\nelement vertex 5\n" + properties("float", "x", "y", "z")
    head += "element face 2\nproperty list uchar int vertex_index\n" + properties("uchar", "red", "green", "blue")
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 0)]
    data = b"".join(struct.pack(order + "3f", *point) for point in points)
    data += struct.pack(order + "B4i3B", 4, 0, 1, 2, 3, 255, 0, 0) + struct.pack(order + "B3i3B", 3, 3, 2, 4, 0, 0, 255)
    (tmp_path / "a.ply").write_bytes((head + "end_header\n").encode() + data)
    mesh = load_mesh(tmp_path / "a.ply")
    np.testing.assert_allclose(mesh.colors[:, 0, :3], [RED, RED, [0.0, 0.0, 1.0]], atol=tol.FLOAT32)
    np.testing.assert_allclose(mesh.extent_m, [1.0, 2.0, 0.0], atol=tol.FLOAT32)


def test_colours_in_an_stl(tmp_path: Path) -> None:
    corners = struct.pack("<12f", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0)
    for head, red in ((b"viscam", 1 << 15 | 31 << 10), (b"COLOR=\xff\xff\xff\xff", 31)):
        (tmp_path / "a.stl").write_bytes(head.ljust(80) + struct.pack("<I", 1) + corners + struct.pack("<H", red))
        np.testing.assert_allclose(load_mesh(tmp_path / "a.stl").colors[0, :, :3], [RED] * 3, atol=tol.FLOAT32)


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_map_coordinates_lose_no_digit(tmp_path: Path, suffix: str) -> None:
    """A body in coordinates of a map has the shape of the one at the origin, about its middle."""
    at = np.array([512345.678, 12.5, -5412345.678])
    points = np.asarray(trimesh.creation.icosphere(subdivisions=1).vertices)
    faces = trimesh.creation.icosphere(subdivisions=1).faces
    meshes = []
    for offset in (np.zeros(3), at):
        path = tmp_path / f"a{suffix}"
        rows = [" ".join(f"{value:.6f}" for value in point + offset) for point in points]
        if suffix == ".obj":
            path.write_text(
                "".join(f"v {row}\n" for row in rows) + "".join("f {} {} {}\n".format(*f + 1) for f in faces)
            )
        else:
            head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n" + properties("float", "x", "y", "z")
            head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
            path.write_text(head + "\n".join(rows) + "\n" + "".join("3 {} {} {}\n".format(*f) for f in faces))
        meshes.append(load_mesh(path))
    near, far = meshes
    np.testing.assert_allclose(far.positions, near.positions, atol=2e-6)  # digits of the text
    assert near.notes == ()
    assert "lies far from its origin, at 512345.678, 12.5, -5412345.68" in far.notes[0]


def z_up(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    turned = mesh.copy()
    turned.apply_transform(np.block([[UPRIGHT["z"].T, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    return turned


def joined(*boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> trimesh.Trimesh:
    """Return boxes of sizes at places."""
    made = []
    for size, place in boxes:
        made.append(trimesh.creation.box(size))
        made[-1].apply_translation(place)
    return trimesh.util.concatenate(made)


def legs(half: float, height: float) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    return [((0.06, height, 0.06), (x * half, 0.5 * height, z * half)) for x in (-1, 1) for z in (-1, 1)]


UPRIGHT_THINGS = {
    "along x": joined(((12, 2, 3), (0, 0, 0)), ((2, 2, 2), (-4, 2, 0)), ((0.2, 6, 0.2), (1, 4, 0))),
    "along z": joined(((3, 2, 12), (0, 0, 0)), ((2, 2, 2), (0, 2, -4)), ((0.2, 6, 0.2), (0, 4, 1))),
    "table": joined(((1.6, 0.05, 1.6), (0, 0.75, 0)), *legs(0.7, 0.75)),
    "person": joined(
        ((0.5, 0.7, 0.25), (0, 1.2, 0)), ((0.2, 0.25, 0.2), (0, 1.7, 0.02)), ((0.3, 0.85, 0.2), (0, 0.4, 0))
    ),
}
OTHERS = {
    "barrel": trimesh.creation.cylinder(
        0.3, 0.9, transform=trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    ),
    "barrel that lies": trimesh.creation.cylinder(0.3, 0.9),
    "chair": joined(((0.45, 0.05, 0.45), (0, 0.45, 0)), ((0.45, 0.5, 0.05), (0, 0.7, -0.2)), *legs(0.2, 0.45)),
    "picture": joined(((2, 1, 0.05), (0, 0, 0)), ((1.8, 0.8, 0.05), (0, 0, 0.05))),
    "spanner": joined(((0.2, 0.008, 0.02), (0, 0, 0)), ((0.03, 0.008, 0.05), (0.1, 0, 0))),
    "fish": trimesh.creation.cone(0.25, 1.0),
}


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
@pytest.mark.parametrize("name", UPRIGHT_THINGS)
def test_bodies_with_z_up_stand(tmp_path: Path, name: str, suffix: str) -> None:
    body = UPRIGHT_THINGS[name]
    path = tmp_path / f"{name}{suffix}"
    z_up(body).export(path)
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.extent_m, body.extents, rtol=1e-5)
    np.testing.assert_allclose(mesh.center_m, body.bounds.mean(axis=0), atol=1e-5)
    assert any("has z up" in note and 'up = "y"' in note for note in mesh.notes)
    np.testing.assert_allclose(load_mesh(path, up="y").extent_m, body.extents[[0, 2, 1]], rtol=1e-5)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
@pytest.mark.parametrize("name", [*UPRIGHT_THINGS, *OTHERS])
def test_bodies_with_y_up_stay_as_they_are(tmp_path: Path, name: str, suffix: str) -> None:
    body = (UPRIGHT_THINGS | OTHERS)[name]
    path = tmp_path / f"{name}{suffix}"
    body.export(path)
    np.testing.assert_allclose(load_mesh(path).extent_m, body.extents, rtol=1e-5)


@pytest.mark.parametrize(
    ("comment", "name", "up"),
    [
        ("# Z-up", "a", "z"), ("# up axis: Z", "a", "z"), ("# up=x", "a", "x"), ("# Forward -Z Up: Y", "a", "y"),
        ("# OpenSCAD 2021", "a", "z"), ("# Blender v2.93.0 OBJ File", "a", "y"), ("# 4x upscaled, group z", "a", "y"),
        ("# mesh", "ship_zup", "z"), ("# mesh", "ship_y_up", "y"), ("# mesh", "lazy upper", "y"),
    ],
)  # fmt: skip
def test_the_up_axis_is_taken_from_words(tmp_path: Path, comment: str, name: str, up: Up) -> None:
    path = tmp_path / f"{name}.obj"
    path.write_text(comment + "\nv 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 2 3\nf 1 2 4\n")
    np.testing.assert_allclose(load_mesh(path).extent_m, np.abs(UPRIGHT[up] @ [1.0, 2.0, 3.0]), rtol=1e-6)


def test_formats_with_an_up_axis_keep_it_unless_told_otherwise(tmp_path: Path) -> None:
    body = UPRIGHT_THINGS["along x"]
    z_up(body).export(tmp_path / "ship.glb")
    lying = load_object(ObjectSettings(mesh=tmp_path / "ship.glb")).meshes[0]
    np.testing.assert_allclose(lying.extent_m, body.extents[[0, 2, 1]], rtol=1e-5)
    assert not any("has z up" in note for note in lying.notes)
    standing = load_object(ObjectSettings(mesh=tmp_path / "ship.glb", up="z")).meshes[0]
    np.testing.assert_allclose(standing.extent_m, body.extents, rtol=1e-5)


def test_a_sequence_is_turned_and_moved_as_its_first_file(tmp_path: Path) -> None:
    for number, height in ((0, 0.0), (1, 3.0)):
        body = UPRIGHT_THINGS["along x"].copy()
        body.apply_translation((5e5, height, 0.0))
        z_up(body).export(tmp_path / f"ship_{number}.obj", digits=4)
    first, second = load_object(ObjectSettings(mesh=tmp_path / "ship_%d.obj")).meshes
    np.testing.assert_allclose(second.center_m - first.center_m, [0.0, 3.0, 0.0], atol=1e-3)
