# SPDX-License-Identifier: Apache-2.0
"""Small glTF files, written byte by byte: the tests' own idea of the format."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np

KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """Collects accessors, images and JSON, then writes a .glb or a .gltf with its buffer inside."""

    def __init__(self, **tree: Any) -> None:
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], **tree}
        self.data = b""
        self.more_buffers: list[dict[str, Any]] = []

    def view(self, data: bytes, **more: Any) -> int:
        """Return the number of a new buffer view."""
        self.data += b"\0" * (-len(self.data) % 4)
        views = self.tree.setdefault("bufferViews", [])
        views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(views) - 1

    def accessor(self, values: Any, kind: str = "f4", *, stride: int = 0, **more: Any) -> int:
        """Return the number of a new accessor of values (n, width); stride: bytes from one to the next."""
        array = np.asarray(values, "<" + kind)
        array = array[:, None] if array.ndim == 1 else array
        data, view_more = array.tobytes(), {}
        if stride:
            data = b"".join(row.tobytes().ljust(stride, b"\x7f") for row in array)
            view_more = {"byteStride": stride}
        entry = {"componentType": KINDS[kind], "count": len(array), "type": TYPES[array.shape[1]], **more}
        accessors = self.tree.setdefault("accessors", [])
        accessors.append({"bufferView": self.view(data, **view_more), **entry})
        return len(accessors) - 1

    def texture(self, image: np.ndarray, **sampler: int) -> int:
        """Return the number of a new texture of code values (h, w, 3 or 4), RGB(A), stored as PNG."""
        order = [2, 1, 0, 3][: image.shape[2]] if image.ndim == 3 else slice(None)
        png = cv2.imencode(".png", np.ascontiguousarray(image[..., order] if image.ndim == 3 else image))[1].tobytes()
        images, textures = self.tree.setdefault("images", []), self.tree.setdefault("textures", [])
        images.append({"bufferView": self.view(png), "mimeType": "image/png"})
        textures.append({"source": len(images) - 1})
        if sampler:
            self.tree.setdefault("samplers", []).append(sampler)
            textures[-1]["sampler"] = len(self.tree["samplers"]) - 1
        return len(textures) - 1

    def mesh(self, *primitives: dict[str, Any], **more: Any) -> int:
        """Return the number of a new mesh."""
        meshes = self.tree.setdefault("meshes", [])
        meshes.append({"primitives": list(primitives), **more})
        return len(meshes) - 1

    def square(self, *, uv: bool = True, normals: bool = True, **more: Any) -> dict[str, Any]:
        """Return a primitive: the square from (0, 0) to (1, 1) in the x, y plane, towards +z, its image upright."""
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
        attributes = {"POSITION": self.accessor(corners)}
        if normals:
            attributes["NORMAL"] = self.accessor(np.tile([0.0, 0.0, 1.0], (4, 1)))
        if uv:
            attributes["TEXCOORD_0"] = self.accessor(corners[:, :2] * [1, -1] + [0, 1])
        return {"attributes": attributes, "indices": self.accessor([0, 1, 2, 0, 2, 3], "u2"), **more}

    def clip(self, *channels: tuple[Any, ...], **more: Any) -> int:
        """Return the number of a new animation of channels (node, path, times, values, interpolation)."""
        entry: dict[str, Any] = {"channels": [], "samplers": [], **more}
        for node, path, times, values, *kind in channels:
            width = {"rotation": 4, "weights": 1}.get(path, 3)
            output = self.accessor(np.reshape(np.asarray(values, float), (-1, width)))
            sampler = {"input": self.accessor(times), "output": output} | ({"interpolation": kind[0]} if kind else {})
            entry["channels"].append({"sampler": len(entry["samplers"]), "target": {"node": node, "path": path}})
            entry["samplers"].append(sampler)
        self.tree.setdefault("animations", []).append(entry)
        return len(self.tree["animations"]) - 1

    def write(self, path: Path) -> Path:
        """Write the file in the format of its suffix."""
        tree = {**self.tree, "buffers": [{"byteLength": len(self.data)}, *self.more_buffers]}
        if path.suffix == ".gltf":
            tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
            path.write_text(json.dumps(tree))
            return path
        text, data = json.dumps(tree).encode(), self.data + b"\0" * (-len(self.data) % 4)
        text += b" " * (-len(text) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
        return path


def one_square(material: dict[str, Any] | None = None, node: dict[str, Any] | None = None, **tree: Any) -> GltfFile:
    """Return a file with a square of one material, hung at a node."""
    file = GltfFile(**tree)
    file.tree["materials"] = [material or {}]
    file.mesh(file.square(material=0))
    file.tree["nodes"] = [{"mesh": 0, **(node or {})}]
    return file


def turned(angle_rad: Any) -> np.ndarray:
    """Return the quaternions (n, 4), or (4,), of turns about +z."""
    half = 0.5 * np.asarray(angle_rad, float)
    return np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=-1)


def tube(sections: int = 9, sides: int = 8, joints: int = 2, *, soft: bool = False) -> GltfFile:
    """Return a file with a closed tube along +x, from 0 to 2 m, 0.4 m thick, skinned to a chain of joints.

    Joint j is node 1 + j, at x = 2 j / joints, below the one before; node 0 shows the mesh. Vertices follow the joint
    before them; with soft, two joints by their distance.
    """
    file = GltfFile(materials=[{"doubleSided": True}])
    x, angle = np.meshgrid(np.linspace(0.0, 2.0, sections), 2 * np.pi * np.arange(sides) / sides, indexing="ij")
    around = np.stack([0 * x, np.cos(angle), np.sin(angle)], axis=-1).reshape(-1, 3)
    middle = np.stack([x, 0 * x, 0 * x], axis=-1).reshape(-1, 3)
    positions = np.concatenate([middle + 0.2 * around, [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    normals = np.concatenate([around, [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    s, k = np.meshgrid(np.arange(sections - 1), np.arange(sides), indexing="ij")
    a, b = (s * sides + k).ravel(), (s * sides + (k + 1) % sides).ravel()
    ends = [(0, len(positions) - 2, 1), (len(positions) - 3 - sides + 1, len(positions) - 1, -1)]
    caps = [
        np.stack([np.full(sides, tip), first + (np.arange(sides) + (sign < 0)) % sides,
                  first + (np.arange(sides) + (sign > 0)) % sides], -1)[:, ::-1]
        for first, tip, sign in ends
    ]  # fmt: skip
    faces = np.concatenate([np.stack([a, b, a + sides], -1), np.stack([b, b + sides, a + sides], -1), *caps])
    place = positions[:, 0] * joints / 2.0
    first = np.minimum(place.astype(int), joints - 1)
    part = np.clip(place - first, 0.0, 1.0) if soft else np.zeros(len(place))
    second = np.minimum(first + 1, joints - 1)
    nothing = np.zeros_like(first)
    bind = np.tile(np.eye(4), (joints, 1, 1))
    bind[:, 3, 0] = -2.0 * np.arange(joints) / joints  # stored column by column
    attributes = {
        "POSITION": file.accessor(positions),
        "NORMAL": file.accessor(normals),
        "JOINTS_0": file.accessor(np.stack([first, second, nothing, nothing], -1), "u1"),
        "WEIGHTS_0": file.accessor(np.stack([1.0 - part, part, 0 * part, 0 * part], -1)),
    }
    file.mesh({"attributes": attributes, "indices": file.accessor(faces.ravel(), "u4"), "material": 0})
    file.tree["skins"] = [
        {"joints": list(range(1, joints + 1)), "inverseBindMatrices": file.accessor(bind.reshape(-1, 16))}
    ]
    chain = [{"translation": [2.0 / joints if j else 0.0, 0.0, 0.0], "children": [j + 2]} for j in range(joints)]
    del chain[-1]["children"]
    file.tree["nodes"] = [{"mesh": 0, "skin": 0, "translation": [50.0, 0.0, 0.0]}, *chain]
    return file


def swimming(sections: int = 9, sides: int = 8, joints: int = 2, *, degrees: float = 60.0) -> GltfFile:
    """Return a soft tube whose joints turn to and fro about +z in one second: the clip "swim"."""
    file = tube(sections, sides, joints, soft=True)
    angles = np.radians(degrees) / (joints - 1) * np.array([0.0, 1.0, 0.0, -1.0, 0.0])
    channels = [(1 + j, "rotation", [0.0, 0.25, 0.5, 0.75, 1.0], turned(angles)) for j in range(1, joints)]
    file.clip(*channels, name="swim")
    return file
