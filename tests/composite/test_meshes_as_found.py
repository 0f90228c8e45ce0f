# SPDX-License-Identifier: Apache-2.0
"""Mesh files as people have them: what is in them is drawn, or said with the way to have it drawn."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from mr360uw.composite import load_mesh
from mr360uw.composite.mesh.material import Part
from mr360uw.composite.mesh.mesh import make_mesh
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import load_object
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol
from tests.composite.test_mesh_formats import SQUARE, obj, picture, ply

TRIANGLE = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.5)])
CUBE = [TRIANGLE + np.array([k, 0, k]) for k in range(4)]


@pytest.mark.parametrize(
    ("library", "says"),
    [
        ("Kd 1 0 0\nPs 0.5\nPc 0.2\naniso 0.4\nmap_ORM a.png", "has ps, pc, aniso, map_orm, not drawn"),
        ("Ks 1 1 1\nNs 250\nTf 0.2 0.5 0.9", "has ks, tf, not drawn"),
        ("Kd xyz 0.3 0.2 0.1", "kd is no colour"),
        ("Kd 255 128 0", "numbers above 1"),
        ("Kd 1 0 0\nd 1\nTr 1", "may be clear (d 1 and tr 1)"),
        ("Kd 1 0 0\nTr 1", "may be clear (tr 1)"),
    ],
)
def test_words_of_a_library_that_are_not_drawn_are_said(tmp_path: Path, library: str, says: str) -> None:
    assert any(says in note for note in obj(tmp_path, f"newmtl m\n{library}\n").notes)


def test_words_that_change_nothing_are_not_said(tmp_path: Path) -> None:
    """Every exporter writes these."""
    plain = "newmtl m\nNs 250\nKa 1 1 1\nKd 0.8 0.8 0.8\nKs 0 0 0\nKe 0 0 0\nNi 1.45\nd 1\nillum 2\nTf 1 1 1\n"
    assert obj(tmp_path, plain).notes == ()


def test_phong_s_exponent_is_a_roughness(tmp_path: Path) -> None:
    """Of the GGX lobe whose peak is as wide, where there is a highlight and no roughness; the default otherwise."""
    found = [
        obj(tmp_path, f"newmtl m\n{library}\n").materials[0].roughness
        for library in ("Ks 0.5 0.5 0.5\nNs 198", "Ks 0.5 0.5 0.5\nNs 198\nPr 0.4", "Ns 198", "Ks 1 1 1\nNs 0")
    ]
    np.testing.assert_allclose(found, [0.1**0.5, 0.4, 0.7, 1.0])


def test_colours_above_one(tmp_path: Path) -> None:
    """Codes of 8 bits, as some exporters write them; emission may be stronger than white."""
    codes = obj(tmp_path, "newmtl m\nKd 255 0 0\nKe 5 5 5\n").materials[0]
    assert codes.base_color == (1.0, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(codes.emission, 5.0)


def test_names_of_maps_may_be_of_the_web_and_tiles_are_refused(tmp_path: Path) -> None:
    picture(tmp_path / "my map.png")
    assert obj(tmp_path, "newmtl m\nmap_Kd my%20map.png\n").materials[0].base_map is not None
    with pytest.raises(MeshError, match=r"set of tiles \(UDIM.*bake them into one picture"):
        obj(tmp_path, "newmtl m\nmap_Kd body.<UDIM>.png\n")


def test_lines_of_an_obj_that_are_not_drawn_are_said(tmp_path: Path) -> None:
    notes = obj(tmp_path, "newmtl m\n", "mtllib a.mtl\nusemap x.png\ncall other.obj\n" + SQUARE).notes
    assert ["usemap" in "".join(notes), "(call)" in "".join(notes)] == [True, True]


def text_stl(*solids: tuple[str, list[np.ndarray]], end: str = "endsolid\n") -> str:
    """Return STL as text, a solid for each name with its triangles."""
    out = ""
    for name, triangles in solids:
        out += f"solid {name}\n"
        for corners in triangles:
            lines = "".join(f"   vertex {x:g} {y:g} {z:e}\n" for x, y, z in corners)
            out += f"  facet normal 0 0 1\n   outer loop\n{lines}   endloop\n  endfacet\n"
        out += end
    return out


def binary_stl(head: bytes, count: int | None = None, more: bytes = b"") -> bytes:
    """Return the four triangles of `CUBE` as rows. count: that the header says; more: bytes behind them."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *one.ravel(), 0) for one in CUBE)
    return head.ljust(80, b"\0") + struct.pack("<I", len(CUBE) if count is None else count) + rows + more


@pytest.mark.parametrize(
    "data",
    [
        binary_stl(b"solid made by a CAD program"), binary_stl(b"x", more=b"what follows them"),
        text_stl(("a b", CUBE)).encode(), text_stl(("", CUBE)).upper().replace("\n", "\r\n").encode(),
        b"\xef\xbb\xbf" + text_stl(("facet", CUBE)).encode(), text_stl(("one", CUBE[:1]), ("two", CUBE[1:])).encode(),
    ],
    ids=["solid in a binary header", "bytes behind", "text", "capitals and CRLF", "mark", "two solids"],
)  # fmt: skip
def test_every_kind_of_stl_is_read_whole(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.stl").write_bytes(data)
    mesh = load_mesh(tmp_path / "a.stl", up="y")
    np.testing.assert_allclose(mesh.positions, np.array(CUBE), atol=tol.FLOAT32)
    assert mesh.notes == ()


def test_numbers_of_triangles_that_are_wrong(tmp_path: Path) -> None:
    """Programs that write while they compute leave the number 0; what is cut short is no mesh."""
    path = tmp_path / "a.stl"
    path.write_bytes(binary_stl(b"x", count=0))
    mesh = load_mesh(path, up="y")
    assert len(mesh.positions) == len(CUBE)
    assert "longer than its number of triangles says" in mesh.notes[0]
    path.write_text(text_stl(("a", CUBE), end=""))
    assert any("is it cut short?" in note for note in load_mesh(path, up="y").notes)
    for data in (binary_stl(b"x")[:200], b"", text_stl(("a", CUBE))[:100].encode()):
        path.write_bytes(data)
        with pytest.raises(MeshError, match="is cut short"):
            load_mesh(path)
    path.write_text(text_stl(("a", CUBE)).replace("vertex 0 ", "vertex 0,5 "))
    with pytest.raises(MeshError, match="no numbers"):
        load_mesh(path)


def test_a_ply_in_capitals_of_strips_and_of_splats(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    xyz = "property float X\nproperty float Y\nproperty float Z\n"
    points = "0 0 0\n1 0 0\n0 1 0\n1 1 0.5\n"
    head = f"ply\nformat ascii 1.0\nelement vertex 4\n{xyz}"
    path.write_text(
        f"{head}element tristrips 1\nproperty list int int vertex_indices\nend_header\n{points}6 0 1 2 3 -1 0\n"
    )
    mesh = load_mesh(path, up="y")
    assert len(mesh.positions) == 2
    assert np.all(mesh.normals[..., 2] > 0.5)  # every second triangle of a strip runs the other way
    path.write_text(f"{head}property float f_dc_0\nend_header\n" + points.replace("\n", " 1\n"))
    with pytest.raises(MeshError, match="Gaussian splats, which have no surface"):
        load_mesh(path)
    path.write_text(f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{points}")
    with pytest.raises(MeshError, match=r"cut short|fewer than"):
        load_mesh(path)


def test_what_a_ply_has_beside_its_surface_is_said(tmp_path: Path) -> None:
    """One alpha for all is clear too; a texture that is not named, and grey values, colour nothing."""
    colors = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha"))
    for properties, value, says in (
        (colors, "255 0 0 100", "clear in places (alpha)"),
        ("property float s\nproperty float t\n", "0 0", "names no texture"),
    ):
        assert any(says in note for note in ply(tmp_path / "a.ply", properties, "", (value, "")).notes)


def glb(path: Path, change: dict[str, object], images: list[bytes] = [], *, text: bool = False) -> None:  # noqa: B006
    """Write a triangle with colours of vertices 0.1 and coordinates, whose material a change is merged into."""
    blocks = [TRIANGLE.astype("<f4"), np.full((3, 3), 0.1, "<f4"), np.array([(0, 0), (1, 0), (0, 1)], "<f4")]
    data = [block.tobytes() for block in blocks] + images
    at = np.cumsum([0, *(len(one) + -len(one) % 4 for one in data)]).tolist()
    tree: dict[str, object] = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1, "TEXCOORD_0": 2}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "emissiveTexture": {"index": 0}}],
        "textures": [{"source": 0}], "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": k, "componentType": 5126, "count": 3, "type": f"VEC{block.shape[1]}"}
            for k, block in enumerate(blocks)
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": at[k], "byteLength": len(one)} for k, one in enumerate(data)],
        "buffers": [{"byteLength": at[-1]}],
    } | change  # fmt: skip
    body = b"".join(one + bytes(-len(one) % 4) for one in data)
    if text:
        tree["buffers"] = [{"byteLength": at[-1], "uri": "a.bin"}]
        (path.parent / "a.bin").write_bytes(body)
        path.write_text(json.dumps(tree))
        return
    head = json.dumps(tree).encode()
    head += b" " * (-len(head) % 4)
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(body)) + struct.pack("<II", len(head), 0x4E4F534A) + head
        + struct.pack("<II", len(body), 0x4E4942) + body
    )  # fmt: skip


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_gltf_is_known_by_its_content(tmp_path: Path, suffix: str, *, text: bool) -> None:
    """And what darkens a texture, and a map that glows by a factor of 0, are said."""
    picture(tmp_path / "a.png")
    path = tmp_path / f"a{suffix}"
    glb(path, {}, [(tmp_path / "a.png").read_bytes()], text=text)
    notes = load_mesh(path).notes
    assert any("vertex colours that darken its texture to 0.1 of it" in note for note in notes)
    assert any("map of emission and the factor 0" in note for note in notes)


def test_lights_and_looks_that_a_file_requires_are_said(tmp_path: Path) -> None:
    """Blender requires the lights that it exports. Shapes and textures that are not read stay an error."""
    picture(tmp_path / "a.png")
    for name, says in (("KHR_lights_punctual", "lamp"), ("KHR_materials_clearcoat", "clear coat")):
        glb(
            tmp_path / "a.glb",
            {"extensionsUsed": [name], "extensionsRequired": [name]},
            [(tmp_path / "a.png").read_bytes()],
        )
        assert any(says in note for note in load_mesh(tmp_path / "a.glb").notes)
    glb(tmp_path / "a.glb", {"extensionsUsed": ["X_new"], "extensionsRequired": ["X_new"]})
    with pytest.raises(MeshError, match="requires the extension X_new"):
        load_mesh(tmp_path / "a.glb")


def test_colours_that_darken_little_are_not_said() -> None:
    """Occlusion in the colours of vertices is usual."""
    uv, colors = TRIANGLE[:, :2], np.full((3, 4), 0.7)
    from mr360uw.composite.mesh.material import Material, make_texture

    mapped = Material(base_map=make_texture(np.full((2, 2, 3), 200, np.uint8), srgb=True))
    one = Part("one", TRIANGLE, np.array([[0, 1, 2]]), None, uv, colors, 0)
    assert make_mesh([one], [mapped]).notes == ()


def test_a_picture_of_a_kind_that_is_not_known_is_called_so(tmp_path: Path) -> None:
    glb(tmp_path / "a.glb", {}, [b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(60)])
    with pytest.raises(MeshError, match=r"got: no kind of picture that is known\) - give a PNG or JPEG"):
        load_mesh(tmp_path / "a.glb")


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.stl", "a.glb"])
def test_what_stands_in_for_a_mesh_is_told(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for data, says in (
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        (b"PK\3\4" + bytes(60), "unpack it"),
        (gzip.compress(SQUARE.encode()), "unpack it"),
        (b"\n<!DOCTYPE html><html>404</html>", "download the file again"),
    ):
        path.write_bytes(data)
        with pytest.raises(MeshError, match=says):
            load_mesh(path)


@pytest.mark.parametrize(
    ("name", "says"),
    [("a.dae", "collada_import"), ("a.3mf", "MeshLab"), ("a.STEP", "FreeCAD"), ("a.max", "modelling program"),
     ("a.splat", "no surface"), ("a.las", "no surface"), ("a.zip", "unpack it"), ("a.vrm", "call it .glb")],
)  # fmt: skip
def test_other_formats_are_answered_with_a_way(tmp_path: Path, name: str, says: str) -> None:
    with pytest.raises(MeshError, match=says):
        load_mesh(tmp_path / name)


def test_vertex_colours_are_left_out_where_a_scene_says_so(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    glb(tmp_path / "a.glb", {}, [(tmp_path / "a.png").read_bytes()])
    settings = ObjectSettings(mesh=tmp_path / "a.glb", vertex_colors=False)
    mesh = load_object(settings).meshes[0]
    np.testing.assert_array_equal(mesh.colors[..., :3], 1.0)
    assert not any("vertex colours" in note for note in mesh.notes)
