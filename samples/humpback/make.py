# SPDX-License-Identifier: Apache-2.0
"""Makes the sample whale, a humpback that swims: python samples/humpback/make.py

Writes `humpback_high.glb` and `humpback_low.glb` of 1 m into mr360uw/sample, of which `write_whale` makes any length.
The first has 24 thousand triangles, and maps of colour, roughness and normals of 2048 x 2048; the other 2 thousand, and
a map of colour of 256 x 256.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from shape import Chart, Detail, WhaleSkin, humpback, neighbour_means, triangles
from skin import map_coordinates, painted

from mr360uw.base.files import write_whole
from mr360uw.base.texels import smoothstep
from mr360uw.types import Floats

_SEED = 1
"""Of its markings."""
_TEXTURE = {"high": 2048, "low": 256}
"""Pixels along each side of the maps, by level of detail."""
_FLOAT, _SHORT, _BYTE = 5126, 5123, 5121
_TYPES = {np.dtype(np.float32): _FLOAT, np.dtype(np.uint16): _SHORT, np.dtype(np.uint8): _BYTE}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (16,): "MAT4"}
_VERTICES, _INDICES = 34962, 34963
"""Numbers of glTF 2.0 for types of components and for the use of buffers."""


def humpback_file(detail: Detail) -> bytes:
    """Return a humpback whale as binary glTF: 1 m long, front +z, up +y, its middle at the origin.

    One closed skin, a skeleton, and a stroke of swimming that repeats.
    """
    # Vertices of the charts, and the joints that they follow
    skin = humpback(detail)
    file = _Glb()
    numbers, faces, uv, tangents = _grids(skin)
    columns: dict[str, NDArray[Any]] = {
        "POSITION": skin.positions[numbers].astype(np.float32),
        "NORMAL": _unit(skin.normals[numbers]).astype(np.float32),
        "TANGENT": tangents.astype(np.float32),
        "TEXCOORD_0": uv.astype(np.float32),
    }
    if detail == "low":
        del columns["TANGENT"]  # are of use to a map of normals alone
    columns |= _joints_and_weights(skin, numbers)
    attributes = {name: file.accessor(values, _VERTICES) for name, values in columns.items()}
    primitive = {
        "attributes": attributes,
        "indices": file.accessor(faces.ravel().astype(np.uint16), _INDICES),
        "material": 0,
    }
    # Maps and material
    maps = painted(skin, _TEXTURE[detail], _SEED)
    images = [file.image(name, data) for name, data in maps.items() if detail == "high" or name == "colour"]
    # The scene: the mesh, and beside it the skeleton that moves it
    tree: dict[str, Any] = {
        "scene": 0,
        "scenes": [{"name": "whale", "nodes": [0]}],
        "nodes": [{"name": _NAME, "mesh": 0, "extras": _EXTRAS}],
        "meshes": [{"name": _NAME, "primitives": [primitive]}],
        "materials": [_GLOSSY if detail == "high" else _MATT],
        "images": images,
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "textures": [{"sampler": 0, "source": k} for k in range(len(images))],
    }
    _add_skeleton(file, tree)
    return file.packed(tree, _EXTRAS)


_NAME = "humpback whale"
_COLOURED: dict[str, Any] = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}
_MATT = {"name": "whale skin", "pbrMetallicRoughness": _COLOURED}
_GLOSSY = {
    "name": "whale skin",
    "pbrMetallicRoughness": _COLOURED | {"metallicRoughnessTexture": {"index": 1}},
    "normalTexture": {"index": 2},
}


_EXTRAS = {"species": "Megaptera novaeangliae", "common_name": _NAME, "length_m": 1.0}


# --------------------------------------------------------------------------------------------------------- the vertices


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


def _joints_and_weights(skin: WhaleSkin, numbers: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Return the four joints and weights of each of the numbered vertices of a skin.

    Weights are 16-bit codes that sum to 1 exactly.
    """
    weights = influences(skin)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    codes = np.round(65535.0 * np.take_along_axis(weights, order, axis=1)).astype(np.int64)
    codes[:, 0] += 65535 - codes.sum(axis=1)
    order[codes == 0] = 0
    return {"JOINTS_0": order[numbers].astype(np.uint8), "WEIGHTS_0": codes[numbers].astype(np.uint16)}


def _add_skeleton(file: _Glb, tree: dict[str, Any]) -> None:
    """Add the joints, the skin and the cycle to a glTF's tree whose only node is the mesh."""
    # Joints are nodes below one another, unturned at rest
    places = np.array([joint.place for joint in JOINTS])
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
    time_s, turns, chest = stroke()
    times = file.accessor(time_s.astype(np.float32))
    moved = [(k, "rotation", turns[:, k]) for k in range(len(JOINTS))]
    moved.append((0, "translation", chest))
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


# Skeleton of the whale, how its skin follows the joints, and a stroke of swimming that repeats without a jump.
#
# A wave runs down the body. The midline is at the height
#
#     h(s, t) = A(s) cos(2 pi (t / T - (s - s0) / W))
#
# above its height at rest, all lengths in body lengths: T the period, W the wavelength, A(s) growing from the chest s0
# to the flukes, which rise and fall by about a fifth of the length from peak to peak, as those of swimming cetaceans do
# (Fish 1998). A joint of the spine turns by the change of the slope dh/ds from one segment to the next, so that the
# flukes pitch as they beat.

PERIOD_S = 4.0
"""Time of a stroke down and up."""
_KEYS = 24
"""Intervals between keys: straight lines between them miss the wave by less than 1 % of its height."""
_CHEST, _WAVELENGTH = 0.36, 1.25
"""s of the chest, and length of the wave."""
_LEAST, _MOST = 0.005, 0.090
"""Amplitude of the wave at the chest and at the flukes."""
_SPINE = (0.46, 0.56, 0.66, 0.75, 0.83, 0.905)
"""s of the joints behind the chest; the last one moves the flukes."""
_HEAD = 0.26
_Y = 0.010
"""y of the spine."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint. parent: its number, -1 of the root; place: (x, y, z) at rest, in body lengths."""

    name: str
    parent: int
    place: tuple[float, float, float]


def _joints() -> tuple[Joint, ...]:
    chain = [Joint("chest", -1, (0.0, _Y, 0.5 - _CHEST)), Joint("head", 0, (0.0, _Y, 0.5 - _HEAD))]
    for k, s in enumerate(_SPINE):
        name = "flukes" if s == _SPINE[-1] else f"spine {k + 1}"
        chain.append(Joint(name, k + 1 if k else 0, (0.0, _Y, 0.5 - s)))
    flukes = len(chain) - 1
    for side, name in ((1.0, "left"), (-1.0, "right")):
        shoulder = len(chain)
        chain.append(Joint(f"{name} pectoral", 0, (0.085 * side, -0.045, 0.175)))
        chain.append(Joint(f"{name} pectoral tip", shoulder, (0.200 * side, -0.110, 0.090)))
        chain.append(Joint(f"{name} fluke", flukes, (0.060 * side, _Y, -0.470)))
    return tuple(chain)


JOINTS = _joints()
"""The joints, each after its parent."""
_NUMBER = {joint.name: number for number, joint in enumerate(JOINTS)}


def influences(skin: WhaleSkin) -> Floats:
    """Return weights (V, J) with which vertices follow the joints: at most four of a vertex, which sum to 1."""
    weights = np.zeros((len(skin.positions), len(JOINTS)))
    # Along the body each segment takes over from the one before it, smoothly about the joint between them
    s = 0.5 - skin.positions[:, 2]
    reaches = (0.08, *(0.5 * np.diff((_CHEST, *_SPINE))))
    starts = [smoothstep(s, at - reach, at + reach) for at, reach in zip((_HEAD, *_SPINE), reaches, strict=True)]
    chain = [_NUMBER["head"], _NUMBER["chest"], *range(2, 2 + len(_SPINE))]
    for number, begun, ended in zip(chain, [np.ones_like(s), *starts], [*starts, np.zeros_like(s)], strict=True):
        weights[:, number] = begun - ended
    # Fins take over from the body, and their tips from them
    for chart in skin.charts[1:]:
        place = np.broadcast_to(chart.place, chart.vertex.shape)[:, 1:]
        for joint, first, last in _FIN_JOINTS.get(chart.name, ()):
            taken, vertex = smoothstep(place, first, last)[..., None], chart.vertex[:, 1:]
            weights[vertex] *= 1.0 - taken
            weights[vertex, _NUMBER[joint]] += taken[..., 0] * (weights[vertex, _NUMBER[joint]] == 0.0)
    # Let the weights run out into the body about the roots of fins
    means = neighbour_means(skin.faces, len(weights))
    for _ in range(6):
        weights = 0.5 * (weights + means @ weights)
    weights[weights < np.sort(weights, axis=1)[:, -4:-3]] = 0.0
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


_FIN_JOINTS = {
    f"{side} {fin}": steps
    for side in ("left", "right")
    for fin, steps in {
        "pectoral": ((f"{side} pectoral", 0.0, 0.3), (f"{side} pectoral tip", 0.3, 0.8)),
        "fluke": ((f"{side} fluke", 0.1, 0.8),),
    }.items()
}
"""Joints of fins, and the fractions of a fin's length between which each takes over."""


def wave(s: Floats, phase: Floats) -> tuple[Floats, Floats]:
    """Return the height of the midline and its slope dh/ds at s, which broadcasts with the phase 2 pi t / T."""
    behind = np.maximum(s - _CHEST, 0.0)
    grown = behind / (1.0 - _CHEST)
    amplitude, growth = _LEAST + (_MOST - _LEAST) * grown**2, 2.0 * (_MOST - _LEAST) * grown / (1.0 - _CHEST)
    number = 2.0 * np.pi / _WAVELENGTH
    angle = phase - number * behind
    return amplitude * np.cos(angle), growth * np.cos(angle) + number * amplitude * np.sin(angle)


def stroke() -> tuple[Floats, Floats, Floats]:
    """Return a cycle of swimming: times (k,) [s] of its keys, the last one as the first, quaternions (k, J, 4), x, y,
    z, w, of the joints, and places (k, 3) of the chest, in body lengths.
    """
    from scipy.spatial.transform import Rotation

    phase = 2.0 * np.pi * np.arange(_KEYS + 1) / _KEYS
    phase[-1] = 0.0
    # The pitch of a segment is the slope at its middle: (k, segments) from the chest backwards
    ends = np.array([_CHEST, *_SPINE, 1.04])
    middles = np.append(_CHEST, 0.5 * (ends[1:-1] + ends[2:]))
    pitch = np.arctan(wave(middles, phase[:, None])[1])
    angles = np.zeros((_KEYS + 1, len(JOINTS), 3))
    angles[:, 0, 0] = pitch[:, 0]
    angles[:, 2 : 2 + len(_SPINE), 0] = np.diff(pitch, axis=1)
    # The head holds its direction against the chest's
    angles[:, _NUMBER["head"], 0] = -0.8 * pitch[:, 0]
    # The tips of the flukes trail behind their beat; the pectorals rock a little
    beat = np.sin(phase - 2.0 * np.pi * (1.0 - _CHEST) / _WAVELENGTH)
    for side, name in ((1.0, "left"), (-1.0, "right")):
        angles[:, _NUMBER[f"{name} fluke"]] = np.stack([0.08 * beat, 0.0 * beat, 0.16 * side * beat], axis=-1)
        angles[:, _NUMBER[f"{name} pectoral"], 2] = 0.07 * side * np.cos(phase - 0.6)
        angles[:, _NUMBER[f"{name} pectoral tip"], 2] = 0.07 * side * np.cos(phase - 1.5)
    turns = Rotation.from_euler("xyz", angles.reshape(-1, 3)).as_quat().reshape(*angles.shape[:2], 4)
    chest = np.tile(JOINTS[0].place, (_KEYS + 1, 1))
    chest[:, 1] += wave(np.array(_CHEST), phase)[0]
    return PERIOD_S * np.arange(_KEYS + 1) / _KEYS, turns, chest


def main() -> None:
    """Write both files into the package."""
    folder = Path(__file__).resolve().parents[2] / "mr360uw" / "sample"
    for detail in get_args(Detail):
        write_whole(folder / f"humpback_{detail}.glb", humpback_file(detail))


if __name__ == "__main__":
    main()
