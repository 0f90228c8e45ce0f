# SPDX-License-Identifier: Apache-2.0
"""Meshes of a glTF file, placed by its nodes, at rest (glTF 2.0 specification, sections 3.5 and 3.7).

Animations are not evaluated: morph targets have the weights and skins the joints of the file.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.composite.mesh.gltf import Gltf, extension_notes, open_gltf
from mr360uw.composite.mesh.gltf_material import BARE, GltfMaterial, MaterialReader
from mr360uw.composite.mesh.gltf_primitive import Primitive, posed, read_primitive
from mr360uw.composite.mesh.part import MeshFile, Part, placed
from mr360uw.errors import MeshError
from mr360uw.types import Floats

_BROKEN = (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error)
"""Exceptions that an inconsistent file causes."""


def read_gltf(path: Path) -> MeshFile:
    """Return the contents of a .gltf or .glb; raise `MeshError`."""
    try:
        return _SceneReader(open_gltf(path)).read()
    except _BROKEN as error:
        what = f"{type(error).__name__}: {error!s:.120}"
        raise MeshError(f"{path} - is not valid glTF (got {what}) - export it again") from error


class _SceneReader:
    """Walks the nodes of the file's scene."""

    def __init__(self, gltf: Gltf) -> None:
        self.gltf = gltf
        self.nodes = gltf.listed("nodes")
        self.reader = MaterialReader(gltf)
        self.numbers: dict[int | None, int] = {}
        self.materials: list[GltfMaterial] = []
        self.primitives: dict[tuple[int, int], Primitive | None] = {}
        self.notes: dict[str, None] = {}  # in order, once each

    def read(self) -> MeshFile:
        world = self._placed_nodes()
        parts = [part for number in world for part in self._parts(number, world)]
        if self.gltf.tree.get("animations"):
            self._note("is animated - it is drawn as it rests in the file; export one mesh a frame to move it")
        notes = (*extension_notes(self.gltf), *self.reader.notes, *self.notes)
        return MeshFile(tuple(parts), tuple(m.material for m in self.materials), notes)

    def _placed_nodes(self) -> dict[int, Floats]:
        """Return the transform to the world of every node of the scene."""
        scenes = self.gltf.listed("scenes")
        children = {c for node in self.nodes for c in node.get("children", [])}
        roots = [n for n in range(len(self.nodes)) if n not in children]
        if scenes:
            roots = self.gltf.entry("scenes", self.gltf.tree.get("scene", 0)).get("nodes", [])
        world: dict[int, Floats] = {}
        pending: list[tuple[int, Floats]] = [(number, np.eye(4)) for number in reversed(roots)]
        while pending:
            number, parent = pending.pop()
            if number in world:
                raise ValueError(f"node {number} hangs below two others")
            node = self.gltf.entry("nodes", number)
            world[number] = parent @ _local(node)
            pending += [(child, world[number]) for child in reversed(node.get("children", []))]
        return world

    def _parts(self, number: int, world: dict[int, Floats]) -> Iterator[Part]:
        node = self.nodes[number]
        if "mesh" not in node:
            return
        mesh = self.gltf.entry("meshes", node["mesh"])
        name = "/".join(dict.fromkeys(str(entry["name"]) for entry in (node, mesh) if entry.get("name")))
        for k, entry in enumerate(mesh["primitives"]):
            primitive = self._primitive(node, mesh, k)
            if primitive is None:
                self._note("has points or lines - they are not drawn")
                continue
            if entry.get("targets"):
                self._note("has morph targets - they are drawn with the weights that the file gives")
            transform = world[number]
            if "skin" in node and "JOINTS_0" in primitive.columns:
                self._note("is skinned - it is drawn in the pose that its joints have in the file")
                primitive, transform = posed(primitive, self._joints(node["skin"], world)), np.eye(4)
            positions, normals, faces = placed(transform, primitive.positions, primitive.normals, primitive.faces)
            if "material" not in entry and primitive.colors is None:
                self._note("has parts without material and colours - they are white, matt and drawn on both sides")
            material = self._material(entry.get("material"))
            coordinates = self.materials[material].coordinates
            uv = primitive.columns.get(f"TEXCOORD_{coordinates.texcoord}")
            uv = None if uv is None else coordinates.of(uv.astype(np.float64))
            title = name or f"mesh {node['mesh']}"
            yield Part(title, positions, faces, normals, uv, primitive.colors, material, flat=True)

    def _primitive(self, node: dict[str, Any], mesh: dict[str, Any], k: int) -> Primitive | None:
        """Return a primitive, read once for all nodes that use it without weights of their own."""
        key = (node["mesh"], k)
        if "weights" in node:
            return read_primitive(self.gltf, mesh["primitives"][k], node["weights"])
        if key not in self.primitives:
            self.primitives[key] = read_primitive(self.gltf, mesh["primitives"][k], mesh.get("weights", []))
        return self.primitives[key]

    def _material(self, source: int | None) -> int:
        if source not in self.numbers:
            self.numbers[source] = len(self.materials)
            self.materials.append(BARE if source is None else self.reader.read(source))
        return self.numbers[source]

    def _joints(self, skin: int, world: dict[int, Floats]) -> Floats:
        """Return the transforms (J, 4, 4) from the bind pose to the world."""
        entry = self.gltf.entry("skins", skin)
        joints = np.stack([world[number] for number in entry["joints"]])
        if "inverseBindMatrices" in entry:
            stored = self.gltf.accessor(entry["inverseBindMatrices"]).astype(np.float64)
            joints = joints @ stored.reshape(-1, 4, 4).swapaxes(1, 2)  # stored column by column
        return joints

    def _note(self, text: str) -> None:
        self.notes[f"{self.gltf.path} - {text}"] = None


def _local(node: dict[str, Any]) -> Floats:
    """Return a node's (4, 4) transform: its matrix (stored column by column), or T R S."""
    if "matrix" in node:
        return np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.asarray(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.asarray(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
