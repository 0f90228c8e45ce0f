# SPDX-License-Identifier: Apache-2.0
"""Meshes that contradict themselves, announce more than memory holds, or name files that are not theirs."""

from __future__ import annotations

import base64
import json
import os
import struct
from collections.abc import Callable
from typing import Any

import pytest

from tests.composite.gltf_files import GltfFile, one_square, swimming
from tests.hostile.bench import Bench
from tests.hostile.test_pictures import png_of

Tree = dict[str, Any]


def changed(change: Callable[[Tree], object]) -> Callable[[GltfFile], None]:
    """Return a function that changes the JSON of a file."""

    def apply(file: GltfFile) -> None:
        change(file.tree)

    return apply


def at(*path: str | int, to: Any) -> Callable[[GltfFile], None]:
    """Return a function that sets one value in the JSON."""

    def apply(file: GltfFile) -> None:
        part: Any = file.tree
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = to

    return apply


def texture(image: bytes) -> Callable[[GltfFile], None]:
    """Return a function that gives the material an image."""

    def apply(file: GltfFile) -> None:
        file.tree["images"] = [{"bufferView": file.view(image), "mimeType": "image/png"}]
        file.tree["textures"] = [{"source": 0}]
        file.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]

    return apply


MATERIAL = ("materials", 0)
POSITIONS = ("meshes", 0, "primitives", 0, "attributes", "POSITION")
INDICES = ("meshes", 0, "primitives", 0, "indices")
GLTF: dict[str, tuple[Callable[[GltfFile], None], str]] = {
    "no meshes": (changed(lambda t: t.pop("meshes")), "mesh.glb"),
    "no nodes": (changed(lambda t: t.update(nodes=[])), "no triangles"),
    "nodes that are text": (at("nodes", to="all"), "not valid"),
    "a node that is a number": (at("nodes", 0, to=7), "not valid"),
    "a node of no mesh": (at("nodes", 0, "mesh", to=9), "not valid"),
    "a node before the first": (at("nodes", 0, "mesh", to=-1), "not valid"),
    "a node below itself": (at("nodes", to=[{"mesh": 0, "children": [0]}]), "mesh.glb"),
    "nodes below each other": (at("nodes", to=[{"children": [1], "mesh": 0}, {"children": [0]}]), "mesh.glb"),
    "a node below two": (at("nodes", to=[{"children": [2]}, {"children": [2]}, {"mesh": 0}]), "below two"),
    "a child of nowhere": (at("nodes", 0, "children", to=[99]), "not valid"),
    "a scene of nowhere": (at("scenes", to=[{"nodes": [99]}]), "not valid"),
    "a node at NaN": (at("nodes", 0, "translation", to=[float("nan"), 0, 0]), "not finite"),
    "a node at two": (at("nodes", 0, "translation", to=[1, 2]), "not valid"),
    "a node turned by text": (at("nodes", 0, "rotation", to="left"), "not valid"),
    "a node of no size": (at("nodes", 0, "scale", to=[0, 0, 0]), "no extent"),
    "a node of infinite size": (at("nodes", 0, "scale", to=[float("inf")] * 3), "not finite"),
    "a matrix of nine": (at("nodes", 0, "matrix", to=[1] * 9), "not valid"),
    "primitives that are a table": (at("meshes", 0, "primitives", to={}), "mesh.glb"),
    "a primitive without attributes": (at("meshes", 0, "primitives", to=[{}]), "not valid"),
    "positions of nowhere": (at(*POSITIONS, to=99), "not valid"),
    "positions of text": (at(*POSITIONS, to="x"), "not valid"),
    "indices beyond the vertices": (changed(lambda t: t["accessors"][0].update(count=1)), "not valid"),
    "indices of floats": (at(*INDICES, to=0), "mesh.glb"),
    "accessor of all vertices": (at("accessors", 0, "count", to=10**12), "MR360UW_MAX_DATA"),
    "accessor of nothing stored": (
        changed(lambda t: (t["accessors"][0].pop("bufferView"), t["accessors"][0].update(count=10**10))),
        "MR360UW_MAX_DATA",
    ),
    "accessor of less": (at("accessors", 0, "count", to=-4), "not valid"),
    "accessor of infinity": (at("accessors", 0, "count", to=float("inf")), "not valid"),
    "accessor of an unknown kind": (at("accessors", 0, "componentType", to=1), "not valid"),
    "accessor of an unknown width": (at("accessors", 0, "type", to="VEC9"), "not valid"),
    "accessor before its view": (at("accessors", 0, "byteOffset", to=-8), "not valid"),
    "accessor beyond its view": (at("accessors", 0, "byteOffset", to=10**9), "not valid"),
    "accessor of no view": (at("accessors", 0, "bufferView", to=77), "not valid"),
    "sparse beyond its end": (
        at("accessors", 0, "sparse", to={"count": 1, "indices": {"bufferView": 3, "componentType": 5125},
                                         "values": {"bufferView": 0}}), "mesh.glb",
    ),
    "sparse of all": (
        at("accessors", 0, "sparse", to={"count": 10**15, "indices": {"bufferView": 0, "componentType": 5125},
                                         "values": {"bufferView": 0}}), "mesh.glb",
    ),
    "view beyond its buffer": (at("bufferViews", 0, "byteLength", to=10**9), "not valid"),
    "view of no buffer": (at("bufferViews", 0, "buffer", to=5), "not valid"),
    "view of a long stride": (at("bufferViews", 0, "byteStride", to=10**9), "not valid"),
    "view of a stride back": (at("bufferViews", 0, "byteStride", to=-12), "mesh.glb"),
    "view of text": (at("bufferViews", 0, "byteOffset", to="4"), "not valid"),
    "a material of nowhere": (at("meshes", 0, "primitives", 0, "material", to=4), "not valid"),
    "a colour of NaN": (
        at(*MATERIAL, to={"pbrMetallicRoughness": {"baseColorFactor": [float("nan"), 0, 0, 1]}}), "factor",
    ),
    "a colour below black": (
        at(*MATERIAL, to={"pbrMetallicRoughness": {"baseColorFactor": [-1, 0, 0, 1]}}), "negative",
    ),
    "a colour of three": (at(*MATERIAL, to={"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0]}}), "not valid"),
    "a roughness below 0": (at(*MATERIAL, to={"pbrMetallicRoughness": {"roughnessFactor": -1}}), "negative"),
    "a roughness of infinity": (
        at(*MATERIAL, to={"pbrMetallicRoughness": {"roughnessFactor": float("inf")}}), "factor",
    ),
    "light that takes light": (at(*MATERIAL, to={"emissiveFactor": [-5, 0, 0]}), "negative"),
    "an unknown alpha": (at(*MATERIAL, to={"alphaMode": "GHOST"}), "GHOST"),
    "a texture of nowhere": (
        at(*MATERIAL, to={"pbrMetallicRoughness": {"baseColorTexture": {"index": 3}}}), "not valid",
    ),
    "an image that is text": (texture(b"This is no image."), "texture cannot be read"),
    "an image of all pixels": (texture(png_of(60_000, 60_000)), "mesh.glb image 0"),
    "an image of many pixels": (texture(png_of(9_000, 9_000)), "MR360UW_MAX_TEXTURE"),
    "a deep image of many pixels": (texture(png_of(9_000, 9_000, 16)), "MR360UW_MAX_TEXTURE"),
    "an image that is cut": (texture(png_of(64, 64)[:60]), "texture cannot be read"),
    "a needed extension": (at("extensionsRequired", to=["KHR_gaussian_splatting"]), "KHR_gaussian_splatting"),
    "damaged meshopt": (
        changed(
            lambda t: t.update(
                extensionsUsed=["EXT_meshopt_compression"],
                bufferViews=[
                    {**view, "extensions": {"EXT_meshopt_compression": {**view, "count": 4, "byteStride": 12}}}
                    for view in t["bufferViews"]
                ],
            )
        ),
        "meshopt",
    ),
    "textures in KTX2": (at("extensionsRequired", to=["KHR_texture_basisu"]), "KTX2"),
    "a skin of nowhere": (at("nodes", 0, "skin", to=4), "mesh.glb"),
    "morph targets of nowhere": (at("meshes", 0, "primitives", 0, "targets", to=[{"POSITION": 99}]), "not valid"),
    "weights without targets": (at("nodes", 0, "weights", to=[0.5]), "weights"),
    "points": (at("meshes", 0, "primitives", 0, "mode", to=0), "no triangles"),
    "an unknown mode": (at("meshes", 0, "primitives", 0, "mode", to=77), "no triangles"),
    "many of one": (at("nodes", to=[{"mesh": 0}] * 60), "MR360UW_MAX_TRIANGLES"),
    "deep extras": (at("extras", to=json.loads("[" * 900 + "]" * 900)), ""),
}  # fmt: skip
HARMLESS = {"deep extras", "a skin of nowhere", "view of a stride back", "sparse beyond its end", "indices of floats"}
"""What some readers refuse and others may pass over: an error of the right kind, or a picture."""


def test_gltf(bench: Bench, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests) -> None:
    monkeypatch.setenv("MR360UW_MAX_TRIANGLES", "0.0001")
    for name, (damage, says) in GLTF.items():
        with subtests.test(name):
            file = one_square()
            damage(file)
            for suffix in (".glb", ".gltf"):
                path = file.write(bench.folder / f"mesh{suffix}")
                expected = says.replace(".glb", suffix)
                if name in HARMLESS:
                    code, _, err = bench.run("check", "scene.toml", "--set", f'object.0.mesh="{path.name}"')
                    assert code in (0, 2), err
                    assert "Traceback" not in err
                else:
                    bench.refuses_with(f'object.0.mesh="{path.name}"', says=(path.name, expected))


CLIP = ("animations", 0)


def sampler_of(tree: Tree) -> Tree:
    return tree["animations"][0]["samplers"][0]


ANIMATIONS: dict[str, Callable[[GltfFile], None]] = {
    "a sampler of nowhere": at(*CLIP, "channels", 0, "sampler", to=9),
    "times of nowhere": at(*CLIP, "samplers", 0, "input", to=99),
    "times for values": changed(lambda t: sampler_of(t).update(output=sampler_of(t)["input"])),
    "an unknown interpolation": at(*CLIP, "samplers", 0, "interpolation", to="WOBBLE"),
    "a cubic of too few": at(*CLIP, "samplers", 0, "interpolation", to="CUBICSPLINE"),
    "an unknown path": at(*CLIP, "channels", 0, "target", "path", to="mood"),
    "channels that are text": at(*CLIP, "channels", to="all"),
    "samplers that are missing": changed(lambda t: t["animations"][0].pop("samplers")),
    "a joint of nowhere": at("skins", 0, "joints", to=[1, 99]),
    "no joints": at("skins", 0, "joints", to=[]),
    "bind matrices of nowhere": at("skins", 0, "inverseBindMatrices", to=0),
}  # fmt: skip


def test_animations(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, damage in ANIMATIONS.items():
        with subtests.test(name):
            file = swimming()
            damage(file)
            file.write(bench.folder / "fish.glb")
            bench.refuses_with('object.0.mesh="fish.glb"', says=("fish.glb",))


def glb(
    text: bytes, *, magic: bytes = b"glTF", version: int = 2, length: int | None = None, kind: bytes = b"JSON"
) -> bytes:
    size = len(text) if length is None else length
    return struct.pack("<4sII", magic, version, 20 + len(text)) + struct.pack("<I4s", size, kind) + text


DEEP = 100_000
CONTAINERS = {
    "empty.glb": b"", "short.glb": b"glTF", "head.glb": struct.pack("<4sII", b"glTF", 2, 12), "text.glb": b"none" * 9,
    "other.glb": glb(b"{}", magic=b"glTG"), "first.glb": glb(b"{}", version=1), "kind.glb": glb(b"{}", kind=b"BIN\0"),
    "long.glb": glb(b"{}", length=2**32 - 1), "cut.glb": glb(b'{"asset":'), "list.glb": glb(b"[1, 2]"),
    "number.glb": glb(b"7"), "none.glb": glb(b"null"), "deep.glb": glb(b"[" * DEEP + b"]" * DEEP),
    "tables.glb": glb(b'{"a":' * DEEP + b"1" + b"}" * DEEP), "digits.glb": glb(b'{"a":' + b"9" * 5000 + b"}"),
    "many.glb": glb(b'{"a":[' + b"1," * 5_100_000 + b"1]}"), "binary.glb": glb(b"\xff\xfe\x00\x01" * 20),
    "empty.gltf": b"", "text.gltf": b"no mesh", "cut.gltf": b'{"asset": {"version": "2.0"',
    "binary.gltf": b"\xff\xfe" * 50,
    "list.gltf": b"[]", "deep.gltf": b"[" * DEEP + b"]" * DEEP, "glb.gltf": glb(b"{}"),
    "base64.gltf": json.dumps({"buffers": [{"uri": "data:application/octet-stream;base64,@@@", "byteLength": 3}],
                               "nodes": [{"mesh": 0}]}).encode(),
    "comma.gltf": json.dumps({"buffers": [{"uri": "data:", "byteLength": 3}]}).encode(),
    "number.gltf": json.dumps({"buffers": [{"uri": 7}]}).encode(),
    "images.gltf": json.dumps({"images": "all"}).encode(),
    "table.gltf": json.dumps({"buffers": {"uri": "x"}}).encode(),
    "empty.obj": b"", "points.obj": b"v 0 0 0\nv 1 0 0\n", "beyond.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "words.obj": b"v a b c\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "binary.obj": bytes(range(256)) * 20, "line.obj": b"f " + b"1 " * 100_000 + b"\n",
    "empty.ply": b"", "head.ply": b"ply\nformat ascii 1.0\n", "text.ply": b"no mesh",
    "many.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
                b"property float z\nelement face 4000000000\nproperty list uchar int vertex_indices\nend_header\n"
                + bytes(99),
    "words.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\na\nb\nc\n",
    "long.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                b"property float z\nelement face 2\nproperty list uint int vertex_indices\nend_header\n"
                + struct.pack("<9fI3iI", *range(9), 3, 0, 1, 2, 2**30),
    "back.ply": b"ply\nformat ascii 1.0\nelement vertex -3\nproperty float x\nend_header\n",
    "empty.stl": b"", "text.stl": b"solid\nno mesh\nendsolid\n", "many.stl": bytes(80) + struct.pack("<I", 2**32 - 1),
    "cut.stl": bytes(80) + struct.pack("<I", 4) + bytes(60), "nan.stl": bytes(80) + struct.pack("<I", 1) + b"\xff" * 50,
}  # fmt: skip


def test_files(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, data in CONTAINERS.items():
        path = bench.put(name, data)
        with subtests.test(name):
            bench.refuses_with(f'object.0.mesh="{name}"', says=(name,))
        path.unlink()


def outside_gltf(bench: Bench, uri: str, what: str) -> None:
    file = one_square()
    if what == "buffer":
        file.write(bench.folder / "inner" / "mesh.gltf")
        tree = json.loads((bench.folder / "inner" / "mesh.gltf").read_text())
        data = base64.b64decode(tree["buffers"][0]["uri"].split(",")[1])
        bench.put("mesh.bin", data)
        tree["buffers"][0]["uri"] = uri
        bench.put("inner/mesh.gltf", json.dumps(tree))
        return
    file.tree["images"] = [{"uri": uri}]
    file.tree["textures"] = [{"source": 0}]
    file.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    file.write(bench.folder / "inner" / "mesh.gltf")


@pytest.mark.parametrize(
    "uri",
    [
        "../mesh.bin", "%2e%2e/mesh.bin", "{}/mesh.bin", "/etc/hostname", "../../../../../../../../etc/hostname",
        "link.bin", "x/../../mesh.bin", "..%2fmesh.bin",
    ],
)  # fmt: skip
@pytest.mark.parametrize("what", ["buffer", "texture"])
def test_files_outside_of_the_folder_of_a_mesh(uri: str, what: str, bench: Bench) -> None:
    (bench.folder / "inner").mkdir()
    (bench.folder / "inner" / "x").mkdir()
    outside_gltf(bench, uri.format(bench.folder), what)
    (bench.folder / "inner" / "link.bin").symlink_to(bench.folder / "mesh.bin")
    message = "names a " + what + " outside of its folder"
    bench.refuses_with('object.0.mesh="inner/mesh.gltf"', says=("mesh.gltf", message, "outside_files = true"))
    bench.refuses_with('receiver={kind="mesh", path="inner/mesh.gltf"}', says=("mesh.gltf", message))
    bench.refuses("new", "plate.png", "inner/mesh.gltf", "-o", "new.toml", says=(message,))


@pytest.mark.parametrize(
    "uri",
    [
        "http://127.0.0.1:9/mesh.bin",
        "file:///etc/hostname",
        "mesh.bin\0",
        "m" * 300,
        "",
        ".",
        "pipe.bin",
        "mesh.bin?a=b",
    ],
)
@pytest.mark.parametrize("what", ["buffer", "texture"])
def test_names_in_a_mesh_that_are_no_files(uri: str, what: str, bench: Bench) -> None:
    (bench.folder / "inner").mkdir()
    outside_gltf(bench, uri, what)
    os.mkfifo(bench.folder / "inner" / "pipe.bin")
    trusting = ('object.0.mesh="inner/mesh.gltf"', "object.0.outside_files=true")
    bench.refuses_with(*trusting, says=("mesh.gltf", f"a {what}"))


def test_a_mesh_that_is_trusted_may_name_files_elsewhere(bench: Bench) -> None:
    (bench.folder / "inner").mkdir()
    outside_gltf(bench, "../mesh.bin", "buffer")
    arguments = ("composite", "scene.toml", "out.png", "--explain", "--set", 'object.0.mesh="inner/mesh.gltf"')
    code, out, _ = bench.run(*arguments, "--set", "object.0.outside_files=true", "--backend", "reference")
    assert code == 0
    assert "mesh.gltf: 2 triangles" in out
    code, _, err = bench.run("new", "plate.png", "inner/mesh.gltf", "-o", "new.toml", "--outside-files")
    assert (code, err) == (0, "")
    assert bench.run("composite", "new.toml", "out.png", "--explain", "--backend", "reference")[0] == 0


OBJ = "mtllib {}\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize(
    ("library", "image", "says"),
    [
        ("../out.mtl", "", "material library outside"),
        ("pipe.mtl", "", "pipe"),
        ("in.mtl", "../plate.png", "texture outside"),
        ("in.mtl", "/etc/hostname", "texture outside"),
        ("in.mtl", "none.png", "texture is missing"),
        ("in.mtl", "pipe.png", "pipe"),
        ("in.mtl", "text.png", "cannot be read"),
        ("in.mtl", "bomb.png", "MR360UW_MAX_TEXTURE"),
        ("in.mtl", "huge.png", "huge.png"),
        ("in.mtl", "cut.png", "a texture cannot be read"),
    ],
)
def test_obj(library: str, image: str, says: str, bench: Bench) -> None:
    folder = bench.folder / "inner"
    folder.mkdir()
    bench.put("inner/mesh.obj", OBJ.format(library))
    material = f"newmtl a\nKd 1 1 1\nmap_Kd {image}\n"
    bench.put("out.mtl", material)
    bench.put("inner/in.mtl", material)
    bench.put("inner/text.png", "no image")
    bench.put("inner/bomb.png", png_of(9_000, 9_000))
    bench.put("inner/huge.png", png_of(60_000, 60_000))
    bench.put("inner/cut.png", bench.material.files["plate.png"][:500])
    for name in ("pipe.mtl", "pipe.png"):
        os.mkfifo(folder / name)
    bench.refuses_with('object.0.mesh="inner/mesh.obj"', says=(says,))
