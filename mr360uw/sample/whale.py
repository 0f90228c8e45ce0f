# SPDX-License-Identifier: Apache-2.0
"""A humpback whale that swims, as a binary glTF file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.files import write_whole
from mr360uw.sample.whale_shape import Chart, Detail, WhaleSkin, humpback, triangles
from mr360uw.sample.whale_skin import map_coordinates, painted
from mr360uw.sample.whale_swim import JOINTS, influences, stroke
from mr360uw.types import Floats

_TEXTURE = {"high": 2048, "low": 256}
"""Pixels along each side of the maps, by level of detail."""
_FLOAT, _SHORT, _BYTE = 5126, 5123, 5121
_TYPES = {np.dtype(np.float32): _FLOAT, np.dtype(np.uint16): _SHORT, np.dtype(np.uint8): _BYTE}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (16,): "MAT4"}
_VERTICES, _INDICES = 34962, 34963
"""Numbers of glTF 2.0 for types of components and for the use of buffers."""


def write_whale(
    path: Path, length_m: float = 13.5, *, detail: Detail = "high", seed: int = 1, swims: bool = True
) -> None:
    """Write a humpback whale as binary glTF: metres, front +z, up +y, its middle at the origin.

    One closed skin, a skeleton, and a stroke of swimming that repeats.

    Parameters
    ----------
    path : Path
        File to write, .glb.
    length_m : float
        Length from the snout to the notch of the flukes; adults are 11 to 16 m, newborn calves 4 m long.
    detail : str
        "high": 24 thousand triangles, maps of colour, roughness and normals of 2048 x 2048; "low": 2 thousand, matt, a
        map of colour of 256 x 256.
    seed : int
        Seed of its markings.
    swims : bool
        Whether it has a skeleton and swims; else it is rigid.
    """
    # Vertices of the charts, and the joints that they follow
    skin = humpback(detail)
    file = _Glb()
    columns, faces = _vertices(skin, length_m)
    if detail == "low":
        del columns["TANGENT"]  # are of use to a map of normals alone
    if swims:
        columns |= _joints_and_weights(skin)
    attributes = {name: file.accessor(values, _VERTICES) for name, values in columns.items()}
    primitive = {"attributes": attributes, "indices": file.accessor(faces.ravel(), _INDICES), "material": 0}
    # Maps and material
    maps = painted(skin, _TEXTURE[detail], seed)
    images = [file.image(name, data) for name, data in maps.items() if detail == "high" or name == "colour"]
    # The scene: the mesh, and beside it the skeleton that moves it
    tree: dict[str, Any] = {
        "scene": 0,
        "scenes": [{"name": "whale", "nodes": [0]}],
        "nodes": [{"name": _NAME, "mesh": 0, "extras": _extras(length_m)}],
        "meshes": [{"name": _NAME, "primitives": [primitive]}],
        "materials": [_GLOSSY if detail == "high" else _MATT],
        "images": images,
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "textures": [{"sampler": 0, "source": k} for k in range(len(images))],
    }
    if swims:
        _add_skeleton(file, tree, length_m)
    write_whole(path, file.packed(tree, _extras(length_m)))


_NAME = "humpback whale"
_COLOURED: dict[str, Any] = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}
_MATT = {"name": "whale skin", "pbrMetallicRoughness": _COLOURED}
_GLOSSY = {
    "name": "whale skin",
    "pbrMetallicRoughness": _COLOURED | {"metallicRoughnessTexture": {"index": 1}},
    "normalTexture": {"index": 2},
}


def _extras(length_m: float) -> dict[str, Any]:
    return {"species": "Megaptera novaeangliae", "common_name": _NAME, "length_m": length_m}


# --------------------------------------------------------------------------------------------------------- the vertices


def _vertices(skin: WhaleSkin, length_m: float) -> tuple[dict[str, NDArray[Any]], NDArray[np.uint16]]:
    """Return the attributes of the charts' vertices and the triangles (T, 3) of their numbers."""
    numbers, faces, uv, tangents = _grids(skin)
    columns = {
        "POSITION": (length_m * skin.positions[numbers]).astype(np.float32),
        "NORMAL": _unit(skin.normals[numbers]).astype(np.float32),
        "TANGENT": tangents.astype(np.float32),
        "TEXCOORD_0": uv.astype(np.float32),
    }
    return columns, faces.astype(np.uint16)


def _grids(skin: WhaleSkin) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats]:
    """Return, of all charts' used vertices, the numbers in the skin, triangles, texture coordinates and tangents."""
    numbers, faces, uv, tangents, count = [], [], [], [], 0
    for chart in skin.charts:
        own = chart.vertex.ravel()
        corners = triangles(chart.drawn)
        # Cells that meet in a pole have but one triangle
        corners = corners[(own[corners] != np.roll(own[corners], 1, axis=1)).all(axis=1)]
        used, renumbered = np.unique(corners, return_inverse=True)
        numbers.append(own[used])
        faces.append(renumbered.reshape(-1, 3) + count)
        uv.append(map_coordinates(chart).reshape(-1, 2)[used])
        tangents.append(_tangents(skin, chart).reshape(-1, 4)[used])
        count += len(used)
    return np.concatenate(numbers), np.concatenate(faces), np.concatenate(uv), np.concatenate(tangents)


def _tangents(skin: WhaleSkin, chart: Chart) -> Floats:
    """Return tangents (R, C, 4) of a chart: along it, and the sign of the bitangent, which is up on the texture."""
    positions, normals = skin.positions[chart.vertex], skin.normals[chart.vertex]
    along = np.gradient(positions, axis=1)
    along = along - normals * np.sum(along * normals, axis=-1, keepdims=True)
    return np.concatenate([_unit(along), np.full((*along.shape[:2], 1), -1.0)], axis=-1)


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _joints_and_weights(skin: WhaleSkin) -> dict[str, NDArray[Any]]:
    """Return the four joints and weights of each vertex; weights are 16-bit codes that sum to 1 exactly."""
    numbers = _grids(skin)[0]
    weights = influences(skin)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    codes = np.round(65535.0 * np.take_along_axis(weights, order, axis=1)).astype(np.int64)
    codes[:, 0] += 65535 - codes.sum(axis=1)
    order[codes == 0] = 0
    return {"JOINTS_0": order[numbers].astype(np.uint8), "WEIGHTS_0": codes[numbers].astype(np.uint16)}


def _add_skeleton(file: _Glb, tree: dict[str, Any], length_m: float) -> None:
    """Add the joints, the skin and the cycle to a glTF's tree whose only node is the mesh."""
    # Joints are nodes below one another, unturned at rest
    places = length_m * np.array([joint.place for joint in JOINTS])
    for joint, place in zip(JOINTS, places, strict=True):
        parent = np.zeros(3) if joint.parent < 0 else places[joint.parent]
        node: dict[str, Any] = {"name": joint.name, "translation": (place - parent).tolist()}
        children = [1 + k for k, other in enumerate(JOINTS) if JOINTS[other.parent] is joint and other.parent >= 0]
        tree["nodes"].append(node | ({"children": children} if children else {}))
    back = np.tile(np.eye(4), (len(JOINTS), 1, 1))
    back[:, 3, :3] = -places  # stored column by column
    joints = list(range(1, 1 + len(JOINTS)))
    matrices = file.accessor(back.reshape(-1, 16).astype(np.float32))
    tree["skins"] = [{"name": _NAME, "inverseBindMatrices": matrices, "joints": joints, "skeleton": 1}]
    tree["nodes"][0]["skin"] = 0
    tree["scenes"][0]["nodes"].append(1)
    # Keys of all joints that turn, and of the chest's place
    cycle = stroke()
    times = file.accessor(cycle.time_s.astype(np.float32))
    moved = [(k, "rotation", cycle.turns[:, k]) for k in range(len(JOINTS))]
    moved.append((0, "translation", length_m * cycle.chest))
    tree["animations"] = [{
        "name": "swim",
        "samplers": [
            {"input": times, "output": file.accessor(values.astype(np.float32)), "interpolation": "LINEAR"}
            for _, _, values in moved
        ],
        "channels": [
            {"sampler": n, "target": {"node": 1 + k, "path": what}} for n, (k, what, _) in enumerate(moved)
        ],
    }]  # fmt: skip


# ------------------------------------------------------------------------------------------------------------- the file


class _Glb:
    """Binary glTF 2.0 in the making: buffer views and accessors, by number."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def _view(self, data: bytes, target: int | None = None) -> int:
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
            | ({} if target is None else {"target": target})
        )
        self.data += data + bytes(-len(data) % 4)
        return len(self.views) - 1

    def accessor(self, values: NDArray[Any], target: int | None = None) -> int:
        """Add an array (n, ...); 16-bit rows are fractions of 1."""
        entry = {
            "bufferView": self._view(values.tobytes(), target),
            "componentType": _TYPES[values.dtype],
            "count": len(values),
            "type": _SHAPES[values.shape[1:]],
        }
        if values.dtype == np.float32 and values.shape[1:] in ((), (3,)):
            entry["min"], entry["max"] = (np.atleast_1d(f(values, axis=0)).tolist() for f in (np.min, np.max))
        if values.dtype == np.uint16 and values.ndim > 1:
            entry["normalized"] = True
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def image(self, name: str, data: bytes) -> dict[str, Any]:
        """Add a JPEG."""
        return {"name": name, "mimeType": "image/jpeg", "bufferView": self._view(data)}

    def packed(self, tree: dict[str, Any], extras: dict[str, Any]) -> bytes:
        """Return the file (glTF 2.0 specification, section 4.4)."""
        asset = {"version": "2.0", "generator": "mr360uw", "extras": extras}
        size = {"byteLength": len(self.data)}
        whole = {"asset": asset} | tree | {"accessors": self.accessors, "bufferViews": self.views, "buffers": [size]}
        text = json.dumps(whole, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = b"".join(
            len(chunk).to_bytes(4, "little") + kind + chunk for kind, chunk in ((b"JSON", text), (b"BIN\0", self.data))
        )
        return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks
