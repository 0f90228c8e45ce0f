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

    def write(self, path: Path) -> Path:
        """Write the file in the format of its suffix."""
        tree = {**self.tree, "buffers": [{"byteLength": len(self.data)}]}
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
