# SPDX-License-Identifier: Apache-2.0
"""Mesh files to indexed parts and materials, through trimesh.

What trimesh would lose of a glTF is put where it keeps it: primitives without a material get the default one, so that
their texture coordinates stay, and COLOR_0 travels as a custom attribute. Factors are read from the file itself,
because trimesh rounds them to 8 bits.
"""

from __future__ import annotations

import importlib.util
import io
import json
import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.material import Material
from mr360uw.composite.texture import Texture, Wrap, make_texture
from mr360uw.errors import MeshError
from mr360uw.types import Floats

FORMATS = (".glb", ".gltf", ".obj", ".ply", ".stl")
_COLOR = "_VERTEX_COLOR"
_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Triangles `faces` (T, 3) over vertices; uv from the image's top left; `material` is an index."""

    name: str
    positions: Floats
    faces: NDArray[np.int64]
    normals: Floats | None = None
    uv: Floats | None = None
    colors: Floats | None = None
    material: int = 0


def read_parts(path: Path) -> tuple[list[Part], list[Material]]:
    """Return every placed part of a mesh file and its materials; raise `MeshError`."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise MeshError(f"{path} - not a mesh format that is read (got {suffix!r}) - give {', '.join(FORMATS)}")
    if not path.is_file():
        raise MeshError(f"{path} - no such file - check the path")
    tree = _gltf_tree(path) if suffix in (".glb", ".gltf") else None
    if suffix == ".obj":
        _check_obj_textures(path)
    scene = _load_scene(path, tree)
    parts: list[Part] = []
    materials: list[Material] = []
    known: dict[int, int] = {}
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces"):
            continue
        source = getattr(geometry.visual, "material", None)
        index = known.setdefault(id(source), len(materials))
        if index == len(materials):
            materials.append(_material(source, tree, double_sided=tree is None))
        parts.append(_part(str(name), geometry, np.asarray(transform), index, smooth=tree is None))
    return parts, materials


def _load_scene(path: Path, tree: _Gltf | None) -> Any:
    import trimesh

    try:
        with _quiet_trimesh():
            if tree is None:
                return trimesh.load_scene(path, process=False)
            resolver = trimesh.resolvers.FilePathResolver(str(path))
            return trimesh.load_scene(
                io.BytesIO(tree.repacked()), file_type=path.suffix.lower()[1:], resolver=resolver, process=False
            )
    except MeshError:
        raise
    except Exception as error:  # trimesh lets everything through that its parsers meet in a broken file
        raise MeshError(f"{path} - cannot be read as a mesh (got: {error!s:.200}) - export it again") from error


@contextmanager
def _quiet_trimesh() -> Iterator[None]:
    """Keep trimesh's log lines off the terminal: what matters of them is raised as `MeshError`."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


# --- glTF ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Gltf:
    json: dict[str, Any]
    binary: bytes | None

    def repacked(self) -> bytes:
        """Return the file with a material for every primitive, named by its number, and COLOR_0 renamed."""
        data = json.loads(json.dumps(self.json))
        materials = data.setdefault("materials", [])
        for number, material in enumerate(materials):
            material["name"] = str(number)
            for removed in ("emissiveTexture",):
                if isinstance(material.get(removed), dict) and "index" not in material[removed]:
                    material.pop(removed)
        default = None
        for mesh in data.get("meshes", []):
            for primitive in mesh.get("primitives", []):
                if "material" not in primitive:
                    if default is None:
                        default = len(materials)
                        materials.append({"name": str(default)})
                    primitive["material"] = default
                attributes = primitive.get("attributes", {})
                if "COLOR_0" in attributes:
                    attributes[_COLOR] = attributes.pop("COLOR_0")
        text = json.dumps(data).encode()
        if self.binary is None:
            return text
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.binary), 0x004E4942) + self.binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _gltf_tree(path: Path) -> _Gltf:
    """Return the JSON and binary of a glTF; raise `MeshError` where it is broken or needs what is not there."""
    try:
        data = path.read_bytes()
        binary: bytes | None = None
        if path.suffix.lower() == ".glb":
            magic, version, _ = struct.unpack_from("<4sII", data)
            length, kind = struct.unpack_from("<II", data, 12)
            if magic != b"glTF" or version != 2 or kind != 0x4E4F534A:
                raise MeshError(f"{path} - is not glTF 2.0 (got header {data[:8]!r}) - export it again")
            text = data[20 : 20 + length]
            binary = data[28 + length :] if len(data) > 28 + length else b""
        else:
            text = data
        tree: dict[str, Any] = dict(json.loads(text))
    except (OSError, TypeError, ValueError, struct.error) as error:
        raise MeshError(f"{path} - is not glTF (got: {error!s:.120}) - export it again") from error
    used = set(tree.get("extensionsUsed", []))
    if "KHR_draco_mesh_compression" in used and importlib.util.find_spec("DracoPy") is None:
        raise MeshError(
            f"{path} - is compressed with Draco - install the package DracoPy, or export it without compression"
        )
    if "EXT_meshopt_compression" in used:
        raise MeshError(f"{path} - is compressed with meshopt - export it without compression")
    for image in tree.get("images", []):
        uri = image.get("uri", "")
        if uri and not uri.startswith("data:") and not (path.parent / _unquoted(uri)).is_file():
            raise MeshError(f"{path} - a texture is missing (got {uri!r}) - put it beside the mesh")
    return _Gltf(tree, binary)


def _unquoted(uri: str) -> str:
    from urllib.parse import unquote

    return unquote(uri)


# --- OBJ -----------------------------------------------------------------------------------------------------------


def _check_obj_textures(path: Path) -> None:
    """Raise `MeshError` where a material of an OBJ names an image that is not there."""
    text = path.read_text("utf-8", errors="replace")
    for line in text.splitlines():
        words = line.strip().split(None, 1)
        if len(words) < 2 or words[0] != "mtllib":
            continue
        library = path.parent / words[1].strip()
        if not library.is_file():
            continue  # a mesh without its materials still has a shape
        for entry in library.read_text("utf-8", errors="replace").splitlines():
            words = entry.strip().split(None, 1)
            if len(words) == 2 and words[0].lower() == "map_kd" and not words[1].startswith("-"):
                image = words[1].strip().replace("\\", "/")
                if not (path.parent / image).is_file():
                    raise MeshError(f"{library} - a texture is missing (got {image!r}) - put it beside the mesh")


# --- what both share -----------------------------------------------------------------------------------------------


def _part(name: str, geometry: Any, transform: Floats, material: int, *, smooth: bool) -> Part:
    linear = transform[:3, :3]
    positions = np.asarray(geometry.vertices, np.float64) @ linear.T + transform[:3, 3]
    faces = np.asarray(geometry.faces, np.int64)
    mirrored = np.linalg.det(linear) < 0.0
    if mirrored:
        faces = faces[:, ::-1]
    normals = None
    if "vertex_normals" in geometry._cache.cache:
        own = np.asarray(geometry.vertex_normals, np.float64)
        if own.shape == positions.shape and np.any(own):
            normals = own @ np.linalg.inv(linear)  # normals transform by the inverse transpose
    uv = getattr(geometry.visual, "uv", None)
    if uv is not None:
        uv = np.asarray(uv, np.float64) * [1.0, -1.0] + [0.0, 1.0]
    return Part(name, positions, faces, normals, uv, _colors(geometry, encoded=smooth), material)


def _colors(geometry: Any, *, encoded: bool) -> Floats | None:
    """Return linear vertex colours (V, 4); those of glTF are linear, 8-bit ones of PLY and OBJ are encoded."""
    from mr360uw.color import decode

    colors = geometry.vertex_attributes.get(_COLOR)
    if colors is None and encoded and getattr(geometry.visual, "kind", None) == "vertex":
        colors = geometry.visual.vertex_colors
    if colors is None:
        return None
    colors = np.asarray(colors)
    if colors.dtype == np.uint16:
        colors = colors / 65535.0
    elif colors.dtype == np.uint8:
        colors = colors / 255.0
    colors = colors.astype(np.float64)
    if colors.shape[1] == 3:
        colors = np.concatenate([colors, np.ones((len(colors), 1))], axis=1)
    if encoded:
        colors[:, :3] = decode(colors[:, :3], "srgb")
    return colors


def _material(source: Any, tree: _Gltf | None, *, double_sided: bool) -> Material:
    """Return the material of a trimesh material; glTF's defaults and factors come from the file."""
    if source is None:
        return Material(double_sided=double_sided)
    if tree is None:
        return _simple_material(source)
    number = int(source.name) if str(source.name).isdigit() else len(tree.json.get("materials", []))
    listed = tree.json.get("materials", [])
    entry = listed[number] if number < len(listed) else {}
    pbr = entry.get("pbrMetallicRoughness", {})
    strength = entry.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    red, green, blue = entry.get("emissiveFactor", (0.0, 0.0, 0.0))

    def texture(attribute: str, reference: dict[str, Any] | None, *, srgb: bool) -> Texture | None:
        image = getattr(source, attribute, None)
        return None if image is None or reference is None else make_texture(
            _pixels(image), srgb=srgb, wrap=_wrap(tree.json, reference)
        )  # fmt: skip

    bare = not entry
    return Material(
        name=str(entry.get("name", number)),
        base_color=tuple(float(c) for c in pbr.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))),  # type: ignore[arg-type]
        metallic=float(pbr.get("metallicFactor", 0.0 if bare else 1.0)),
        roughness=float(pbr.get("roughnessFactor", 1.0)),
        emission=(red * strength, green * strength, blue * strength),
        normal_scale=float(entry.get("normalTexture", {}).get("scale", 1.0)),
        occlusion_strength=float(entry.get("occlusionTexture", {}).get("strength", 1.0)),
        alpha_mode=entry.get("alphaMode", "OPAQUE"),
        alpha_cutoff=float(entry.get("alphaCutoff", 0.5)),
        double_sided=bool(entry.get("doubleSided", bare)),
        refractive_index=float(entry.get("extensions", {}).get("KHR_materials_ior", {}).get("ior", 1.5)),
        base_map=texture("baseColorTexture", pbr.get("baseColorTexture"), srgb=True),
        metallic_roughness_map=texture("metallicRoughnessTexture", pbr.get("metallicRoughnessTexture"), srgb=False),
        normal_map=texture("normalTexture", entry.get("normalTexture"), srgb=False),
        occlusion_map=texture("occlusionTexture", entry.get("occlusionTexture"), srgb=False),
        emission_map=texture("emissiveTexture", entry.get("emissiveTexture"), srgb=True),
    )


def _wrap(tree: dict[str, Any], reference: dict[str, Any]) -> tuple[Wrap, Wrap]:
    sampler = tree["textures"][reference["index"]].get("sampler")
    entry = {} if sampler is None else tree["samplers"][sampler]
    return _WRAPS[entry.get("wrapS", 10497)], _WRAPS[entry.get("wrapT", 10497)]


def _simple_material(source: Any) -> Material:
    """Return an OBJ's material: diffuse colour (encoded) or its image; without either, a middle grey."""
    from mr360uw.color import decode

    image = getattr(source, "image", None)
    real = image is not None and max(image.size) > 2  # trimesh stands in a 2 x 2 image where there is none
    if real:
        texture = make_texture(_pixels(image), srgb=True)
        return Material(base_color=(1.0, 1.0, 1.0, 1.0), base_map=texture, double_sided=True)
    diffuse = getattr(source, "diffuse", None)
    r, g, b = 0.5, 0.5, 0.5
    if diffuse is not None and getattr(source, "kwargs", {}).get("kd") is not None:
        r, g, b = decode(np.asarray(diffuse[:3], np.float64) / 255.0, "srgb")
    return Material(base_color=(float(r), float(g), float(b), 1.0), double_sided=True)


def _pixels(image: Any) -> NDArray[np.uint8]:
    """Return a PIL image as (h, w, 3 or 4) uint8."""
    clear = image.mode in ("RGBA", "LA") or "transparency" in image.info
    return np.asarray(image.convert("RGBA" if clear else "RGB"))


def read_texture(path: Path, *, srgb: bool) -> Texture:
    """Return the texture of an image file; raise `MeshError`."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            return make_texture(_pixels(image), srgb=srgb)
    except (OSError, UnidentifiedImageError) as error:
        raise MeshError(f"{path} - a texture cannot be read (got: {error!s:.120}) - give a PNG or JPEG") from error
