# SPDX-License-Identifier: Apache-2.0
"""The meshes of a glTF file where its nodes put them, and their animations (glTF 2.0, sections 3.5, 3.7, 3.11).

Parts are at rest: morph targets have the weights and skins the joints that the file gives.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from mr360uw.base.input_files import TRIANGLES
from mr360uw.composite.mesh.gltf import (
    BROKEN,
    Gltf,
    Primitive,
    extension_notes,
    open_gltf,
    read_primitive,
    read_skeleton,
    read_skin,
    read_targets,
    rest_weights,
)
from mr360uw.composite.mesh.material import (
    MAPS,
    MapCoordinates,
    Material,
    MeshFile,
    Part,
    Rigging,
    Texture,
    Wrap,
    decode_image,
    make_texture,
)
from mr360uw.composite.mesh.skin import Animation, Channel, Curve, Interpolation, Target, UnplacedSurface
from mr360uw.composite.settings import FARTHEST
from mr360uw.errors import MeshError
from mr360uw.types import Floats

_WIDTHS: dict[str, int] = {"translation": 3, "rotation": 4, "scale": 3}
_POINTER = "pointer"
"""Path of channels of KHR_animation_pointer, which move materials, lights and cameras: they are passed over."""
_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


Broken = Callable[[str, str], MeshError]
"""Makes the error of a clip, of what is wrong and what was got."""


def read_clip(gltf: Gltf, place: Mapping[int, int], names: tuple[str, ...], number: int) -> Animation:
    """Return a clip of a file; raise `MeshError` where it is broken.

    place: number in the skeleton of each node; names: of the clips.
    """
    broken = functools.partial(_broken, gltf, names[number])
    try:
        entry = gltf.entry("animations", number)
        channels = (_channel(gltf, place, channel, entry["samplers"], broken) for channel in entry["channels"])
        return Animation(names[number], tuple(channel for channel in channels if channel is not None))
    except BROKEN as error:
        raise broken("is not valid glTF", f"{type(error).__name__}: {error!s:.120}") from error


def _channel(
    gltf: Gltf, place: Mapping[int, int], entry: dict[str, Any], samplers: list[dict[str, Any]], broken: Broken
) -> Channel | None:
    """Return a channel; None where what it moves is not drawn."""
    target = entry["target"]
    path, node = target["path"], target.get("node")
    if path not in (*_WIDTHS, "weights", _POINTER):
        raise broken("moves something unknown", f"path {path!r}")
    if path == _POINTER or node is None:
        return None
    details = gltf.entry("nodes", node)
    if node not in place:
        return None
    if path == "weights":
        mesh = gltf.entry("meshes", details["mesh"]) if "mesh" in details else {"primitives": [{}]}
        width = len(mesh["primitives"][0].get("targets", []))
        if width == 0:
            raise broken("moves morph targets of a node that has none", f"node {node}")
    else:
        width = _WIDTHS[path]
        if "matrix" in details:
            raise broken("moves a node that is placed by a matrix", f"node {node}")
    curve = _curve(gltf, samplers[entry["sampler"]], width, path, broken)
    return place[node], cast("Target", path), curve


def _curve(gltf: Gltf, sampler: dict[str, Any], width: int, path: str, broken: Broken) -> Curve:
    # Read the times of the keys, which must ascend
    times = gltf.accessor(sampler["input"]).astype(np.float64).ravel()
    kind = sampler.get("interpolation", "LINEAR")
    if kind not in _INTERPOLATIONS:
        raise broken("has an interpolation that is unknown", repr(kind))
    if len(times) == 0 or not np.all(np.abs(times) <= FARTHEST) or times[0] < 0.0:
        got = "no keys" if len(times) == 0 else f"{_worst(times) if times[0] >= 0.0 else times[0]:g} s"
        raise broken(f"has keys of {path} at no time or before 0", got)
    if np.any(np.diff(times) < 0.0):
        at = int(np.argmax(np.diff(times) < 0.0))
        got = f"{times[at]:g} s, then {times[at + 1]:g} s"
        raise broken(f"has keys of {path} that do not ascend in time", got)
    # Read the values, of splines with a tangent on either side
    stored = gltf.accessor(sampler["output"]).astype(np.float64)
    parts = 3 if kind == "CUBICSPLINE" else 1
    if stored.size != len(times) * parts * width:
        got = f"{stored.size} numbers for {len(times)} keys of {parts * width}"
        raise broken(f"has values of {path} that do not fit its keys", got)
    if not np.all(np.abs(stored) <= FARTHEST):
        raise broken(f"has values of {path} that are not finite or too large", f"{_worst(stored):g}")
    # Take values and tangents apart; rotations are unit quaternions
    rows = stored.reshape(len(times), parts, width)
    tangents = rows[:, [0, 2]] if parts == 3 else None
    values = rows[:, parts // 2]
    turns = path == "rotation"
    return Curve(times, _unit(values, broken) if turns else values, cast("Interpolation", kind), tangents, turns)


def _unit(values: Floats, broken: Broken) -> Floats:
    length = np.linalg.norm(values, axis=-1, keepdims=True)
    if not np.all(length > 0.0):
        raise broken("has a rotation that is none", "the quaternion 0, 0, 0, 0")
    return values / length


def _broken(gltf: Gltf, name: str, what: str, got: str) -> MeshError:
    return gltf.broken(f"animation {name!r} {what}", got, 'export it again, or play none (animation = "")')


def _worst(values: Floats) -> float:
    """Return a value that is not finite, or else the largest one."""
    return float(values.ravel()[np.argmax(np.where(np.isfinite(values), np.abs(values), np.inf))])


def read_gltf(path: Path, *, outside: bool = False) -> MeshFile:
    """Return the contents of a .gltf or .glb; outside: as of `open_gltf`. Raises `MeshError`."""
    try:
        return _SceneReader(open_gltf(path, outside=outside)).read()
    except BROKEN as error:
        what = f"{type(error).__name__}: {error!s:.120}"
        raise MeshError(f"{path} - is not valid glTF (got {what}) - export it again") from error


class _SceneReader:
    """Walks the nodes of the file's scene."""

    def __init__(self, gltf: Gltf) -> None:
        self.gltf = gltf
        self.nodes = gltf.listed("nodes")
        self.skeleton = read_skeleton(gltf)
        self.place = {number: k for k, number in enumerate(self.skeleton.numbers)}
        self.rest = self.skeleton.at_rest()
        self.reader = MaterialReader(gltf)
        self.numbers: dict[int | None, int] = {}
        self.materials: list[tuple[Material, tuple[MapCoordinates, ...]]] = []
        # several nodes may show a primitive
        self.primitive = functools.cache(
            lambda mesh, k: read_primitive(gltf, gltf.entry("meshes", mesh)["primitives"][k])
        )
        self.notes: dict[str, None] = {}  # in order, once each
        self.triangles = 0

    def read(self) -> MeshFile:
        found = [pair for number in self.place for pair in self._parts(number)]
        parts, bodies = tuple(part for part, _ in found), tuple(body for _, body in found)
        self._note_what_is_left()
        notes = (*extension_notes(self.gltf), *self.reader.notes, *self.notes)
        # a clip without a name has its number
        clips = enumerate(self.gltf.listed("animations"))
        names = tuple(str(entry.get("name") or number) for number, entry in clips)
        clip = functools.partial(read_clip, self.gltf, self.place, names)
        rigging = Rigging(self.skeleton, bodies, names, clip) if names else None
        return MeshFile(parts, tuple(material for material, _ in self.materials), notes, rigging)

    def _note_what_is_left(self) -> None:
        """Note other scenes of the file, and cameras."""
        scenes, drawn = self.gltf.listed("scenes"), self.gltf.tree.get("scene", 0)
        if len(scenes) > 1:
            name = scenes[drawn].get("name", drawn)
            self._note(f"has {len(scenes)} scenes - {name!r} is drawn, its default - export another as the default")
        if any("camera" in self.nodes[number] for number in self.place):
            self._note("has a camera - it is not used - the camera of the scene is")

    def _parts(self, number: int) -> Iterator[tuple[Part, UnplacedSurface]]:
        """Yield what a node shows, at rest and as it moves."""
        node = self.nodes[number]
        if "mesh" not in node:
            return
        mesh = self.gltf.entry("meshes", node["mesh"])
        name = "/".join(dict.fromkeys(str(entry["name"]) for entry in (node, mesh) if entry.get("name")))
        for k, entry in enumerate(mesh["primitives"]):
            primitive = self.primitive(node["mesh"], k)
            if primitive is None:
                self._note("has points or lines - they are not drawn")
                continue
            self.triangles += len(primitive.faces)
            TRIANGLES.check(str(self.gltf.path), self.triangles, MeshError)
            body = self._body(number, mesh, entry, primitive)
            positions, normals, faces = body.at(self.rest)
            if "COLOR_1" in primitive.columns:
                self._note("has a second set of vertex colours (COLOR_1) - the first alone is drawn")
            if "material" not in entry and primitive.colors is None:
                self._note("has parts without material and colours - they are white, matt and drawn on both sides")
            material = self._material(entry.get("material"))
            uv, *more_uv = [primitive.coordinates(of) for of in self.materials[material][1]]
            title, more = name or f"mesh {node['mesh']}", tuple(more_uv)
            yield Part(title, positions, faces, normals, uv, primitive.colors, material, True, more), body

    def _body(self, number: int, mesh: dict[str, Any], entry: dict[str, Any], primitive: Primitive) -> UnplacedSurface:
        node, vertices = self.nodes[number], len(primitive.positions)
        targets = read_targets(self.gltf, entry, vertices)
        weights = rest_weights(self.gltf, node, mesh, len(targets))
        skin = None
        if "skin" in node and "JOINTS_0" in primitive.columns:
            skin, notes = read_skin(self.gltf, node["skin"], primitive.columns, self.place)
            self.notes |= dict.fromkeys(notes)
        place = self.place[number]
        return UnplacedSurface(place, primitive.positions, primitive.normals, primitive.faces, targets, weights, skin)

    def _material(self, source: int | None) -> int:
        if source not in self.numbers:
            self.numbers[source] = len(self.materials)
            self.materials.append((BARE, (_PLAIN,)) if source is None else self.reader.read(source))
        return self.numbers[source]

    def _note(self, text: str) -> None:
        self.notes[f"{self.gltf.path} - {text}"] = None


# Materials of glTF 2.0 (section 3.9 of its specification) and of extensions (`data/gltf_extensions.csv`).

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


_PLAIN = MapCoordinates("TEXCOORD_0")
BARE = Material(base_color=(1.0, 1.0, 1.0, 1.0), roughness=1.0, double_sided=True)
"""Default material: glTF's white, but not metallic, and drawn on both sides."""


class MaterialReader:
    """Reads the materials of a file; one image is decoded once for each use, and maps of one image are one texture."""

    def __init__(self, gltf: Gltf) -> None:
        self.gltf = gltf
        self.notes: dict[str, None] = {}  # in order, once each
        pixels = functools.cache(lambda image: decode_image(gltf.image(image), f"{gltf.path} image {image}"))
        self._made = functools.cache(lambda image, srgb, wrap: make_texture(pixels(image), srgb=srgb, wrap=wrap))

    def read(self, number: int) -> tuple[Material, tuple[MapCoordinates, ...]]:
        """Return a material of the file's list, and the coordinates of each of its `sets`."""
        # Find the factors, also those of the older workflow and of unlit materials
        entry = self.gltf.entry("materials", number)
        extensions = entry.get("extensions", {})
        name = str(entry.get("name", number))
        pbr = entry.get("pbrMetallicRoughness", {})
        if "KHR_materials_pbrSpecularGlossiness" in extensions:
            pbr = self._from_glossiness(name, extensions["KHR_materials_pbrSpecularGlossiness"])
        metallic = float(pbr.get("metallicFactor", 1.0))
        if "KHR_materials_unlit" in extensions:
            metallic = float(pbr.get("metallicFactor", 0.0))
            self._note(f"material {name!r} is unlit (KHR_materials_unlit) - the scene lights its colours")
        # Find the maps; one of emission counts only where its factor is not 0
        if "emissiveTexture" in entry and not any(entry.get("emissiveFactor", ())):
            self._note(
                f"material {name!r} has a map of emission and the factor 0 - it does not glow; export the factor"
            )
        references = {
            "base_map": pbr.get("baseColorTexture"),
            "metallic_roughness_map": pbr.get("metallicRoughnessTexture"),
            "normal_map": entry.get("normalTexture"),
            "occlusion_map": entry.get("occlusionTexture"),
            "emission_map": entry.get("emissiveTexture") if any(entry.get("emissiveFactor", ())) else None,
        }
        maps, coordinates = self._maps({slot: r for slot, r in references.items() if r is not None})
        # Make the material of them
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        red, green, blue = (strength * float(c) for c in entry.get("emissiveFactor", (0.0, 0.0, 0.0)))
        r, g, b, a = (float(c) for c in pbr.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0)))
        mode = entry.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ValueError(f"alphaMode {mode!r}")
        material = Material(
            name=name,
            base_color=(r, g, b, a),
            metallic=metallic,
            roughness=float(pbr.get("roughnessFactor", 1.0)),
            emission=(red, green, blue),
            normal_scale=float((references["normal_map"] or {}).get("scale", 1.0)),
            occlusion_strength=float((references["occlusion_map"] or {}).get("strength", 1.0)),
            alpha_mode=mode,
            alpha_cutoff=float(entry.get("alphaCutoff", 0.5)),
            double_sided=bool(entry.get("doubleSided", False)),
            refractive_index=_index(extensions),
            **maps,
        )
        self._check(material, coordinates)
        return material, coordinates

    def _check(self, material: Material, coordinates: tuple[MapCoordinates, ...]) -> None:
        """Raise `MeshError` where a factor is not finite, or one of light or reflection is negative."""
        placed = [n for one in coordinates for n in (*one.offset, *one.scale, one.rotation_rad)]
        if bad := [*material.wrong_factors, *(factor for factor in placed if not math.isfinite(factor))]:
            what = f"material {material.name!r} has a factor that is negative or not finite"
            raise self.gltf.broken(what, f"{bad[0]:g}", "correct the material")

    def _from_glossiness(self, name: str, entry: dict[str, Any]) -> dict[str, Any]:
        """Return the diffuse half of KHR_materials_pbrSpecularGlossiness as a dielectric."""
        self._note(f"material {name!r} is given by specular and glossiness - its specular colours are not drawn")
        return {
            "baseColorFactor": entry.get("diffuseFactor", (1.0, 1.0, 1.0, 1.0)),
            "baseColorTexture": entry.get("diffuseTexture"),
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0 - float(entry.get("glossinessFactor", 1.0)),
        }

    def _maps(self, references: dict[str, dict[str, Any]]) -> tuple[dict[str, Any], tuple[MapCoordinates, ...]]:
        """Return the maps by slot, with the `sets` of their texture coordinates, and these, each once."""
        own = {slot: _coordinates(reference) for slot, reference in references.items()}
        each = tuple(dict.fromkeys(own.values())) or (_PLAIN,)
        maps: dict[str, Any] = {
            slot: self._texture(reference["index"], srgb=slot in ("base_map", "emission_map"))
            for slot, reference in references.items()
        }
        return maps | {"sets": tuple(each.index(own[slot]) if slot in own else 0 for slot in MAPS)}, each

    def _texture(self, number: int, *, srgb: bool) -> Texture:
        entry = self.gltf.entry("textures", number)
        source = entry.get("extensions", {}).get("EXT_texture_webp", {}).get("source", entry.get("source"))
        if source is None:
            raise MeshError(f"{self.gltf.path} - texture {number} is of a kind that is not read - export PNG or JPEG")
        sampler = self.gltf.entry("samplers", entry["sampler"]) if "sampler" in entry else {}
        wrap = _WRAPS[sampler.get("wrapS", 10497)], _WRAPS[sampler.get("wrapT", 10497)]
        return self._made(source, srgb, wrap)

    def _note(self, text: str) -> None:
        self.notes[f"{self.gltf.path} - {text}"] = None


def _coordinates(reference: dict[str, Any]) -> MapCoordinates:
    """Return a set of coordinates and its KHR_texture_transform.

    The signs are those of the extension's own example; those of its first shader text turn the other way.
    """
    entry = reference.get("extensions", {}).get("KHR_texture_transform", {})
    (x, y), (sx, sy) = entry.get("offset", (0.0, 0.0)), entry.get("scale", (1.0, 1.0))
    texcoord = int(entry.get("texCoord", reference.get("texCoord", 0)))
    turn = float(entry.get("rotation", 0.0))
    return MapCoordinates(f"TEXCOORD_{texcoord}", (float(x), float(y)), turn, (float(sx), float(sy)))


def _index(extensions: dict[str, Any]) -> float:
    """Return the refractive index; 0, a perfect mirror in the extension, becomes a very large index."""
    index = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
    return index if index > 0.0 else 1e3
