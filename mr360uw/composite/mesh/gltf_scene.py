# SPDX-License-Identifier: Apache-2.0
"""The meshes of a glTF file where its nodes put them, and what moves them (glTF 2.0 specification, sections 3.5, 3.7).

Parts are at rest: morph targets have the weights and skins the joints that the file gives.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.composite.mesh.gltf import BROKEN, Gltf, extension_notes, open_gltf
from mr360uw.composite.mesh.gltf_animation import ClipReader, clip_names
from mr360uw.composite.mesh.gltf_material import BARE, GltfMaterial, MaterialReader
from mr360uw.composite.mesh.gltf_primitive import Primitive, read_primitive
from mr360uw.composite.mesh.gltf_rig import read_skeleton, read_skin, read_targets, rest_weights
from mr360uw.composite.mesh.part import MeshFile, Part, Rigging
from mr360uw.composite.mesh.skin import UnplacedSurface
from mr360uw.errors import MeshError
from mr360uw.reading.limits import TRIANGLES


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
        self.materials: list[GltfMaterial] = []
        self.primitives: dict[tuple[int, int], Primitive | None] = {}
        self.notes: dict[str, None] = {}  # in order, once each
        self.triangles = 0

    def read(self) -> MeshFile:
        found = [pair for number in self.place for pair in self._parts(number)]
        parts, bodies = tuple(part for part, _ in found), tuple(body for _, body in found)
        notes = (*extension_notes(self.gltf), *self.reader.notes, *self.notes)
        names = clip_names(self.gltf)
        rigging = Rigging(self.skeleton, bodies, names, ClipReader(self.gltf, self.place, names)) if names else None
        return MeshFile(parts, tuple(m.material for m in self.materials), notes, rigging)

    def _parts(self, number: int) -> Iterator[tuple[Part, UnplacedSurface]]:
        """Yield what a node shows, at rest and as it moves."""
        node = self.nodes[number]
        if "mesh" not in node:
            return
        mesh = self.gltf.entry("meshes", node["mesh"])
        name = "/".join(dict.fromkeys(str(entry["name"]) for entry in (node, mesh) if entry.get("name")))
        for k, entry in enumerate(mesh["primitives"]):
            primitive = self._primitive(node["mesh"], k, entry)
            if primitive is None:
                self._note("has points or lines - they are not drawn")
                continue
            self.triangles += len(primitive.faces)
            TRIANGLES.check(str(self.gltf.path), self.triangles, MeshError)
            body = self._body(number, mesh, entry, primitive)
            positions, normals, faces = body.at(self.rest)
            if "material" not in entry and primitive.colors is None:
                self._note("has parts without material and colours - they are white, matt and drawn on both sides")
            material = self._material(entry.get("material"))
            coordinates = self.materials[material].coordinates
            uv = primitive.columns.get(f"TEXCOORD_{coordinates.texcoord}")
            uv = None if uv is None else coordinates.of(uv.astype(np.float64))
            title = name or f"mesh {node['mesh']}"
            yield Part(title, positions, faces, normals, uv, primitive.colors, material, flat=True), body

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

    def _primitive(self, mesh: int, k: int, entry: dict[str, Any]) -> Primitive | None:
        """Return a primitive, read once where several nodes show it."""
        if (mesh, k) not in self.primitives:
            self.primitives[mesh, k] = read_primitive(self.gltf, entry)
        return self.primitives[mesh, k]

    def _material(self, source: int | None) -> int:
        if source not in self.numbers:
            self.numbers[source] = len(self.materials)
            self.materials.append(BARE if source is None else self.reader.read(source))
        return self.numbers[source]

    def _note(self, text: str) -> None:
        self.notes[f"{self.gltf.path} - {text}"] = None
