# SPDX-License-Identifier: Apache-2.0
"""The container of glTF 2.0: its JSON, buffers, accessors and images (glTF 2.0 specification, sections 3.6 and 4.4).

The JSON is not validated first: a missing key or an index out of range raises a Python exception, which
`gltf_scene.read_gltf` turns into a `MeshError`.
"""

from __future__ import annotations

import base64
import functools
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.input_files import DATA, json_of, neighbour, own_table, read_data
from mr360uw.composite.mesh.material import MapCoordinates
from mr360uw.composite.mesh.polygons import composed
from mr360uw.composite.mesh.skin import MorphTarget, Skeleton, Skin
from mr360uw.errors import MeshError, install_command, installed, optional
from mr360uw.types import Floats

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
BROKEN = (
    KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, MemoryError,
    struct.error,
)  # fmt: skip
"""What Python raises where a file contradicts itself."""
_VALUE_BYTES = 200
"""Memory [bytes] that a value of JSON may take once it is read: an empty list in a list takes 70, a table more."""
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942

_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_DRACO = "KHR_draco_mesh_compression"
_PACKED = {_DRACO: ("Draco", "DracoPy"), **dict.fromkeys(_MESHOPT, ("meshopt", "meshopt"))}
"""Compressions by extension: what they are called, and the module that undoes them."""


@dataclass(frozen=True, slots=True, eq=False)
class Gltf:
    """An opened file: its JSON as `tree`, and its buffers. outside: images may lie outside of the file's folder."""

    path: Path
    tree: dict[str, Any]
    buffers: tuple[bytes, ...]
    outside: bool = False

    def listed(self, name: str) -> list[Any]:
        """Return one of the top level lists, empty where there is none."""
        return list(self.tree.get(name, []))

    def entry(self, name: str, number: int) -> dict[str, Any]:
        """Return one entry of a top level list."""
        if number < 0:
            raise IndexError(f"{name} {number}")
        return dict(self.tree[name][number])

    def view(self, number: int) -> bytes:
        """Return the bytes of a buffer view."""
        entry = self.entry("bufferViews", number)
        packed = next((entry["extensions"][name] for name in _MESHOPT if name in entry.get("extensions", {})), None)
        if packed is not None:
            return self._unpacked(number, packed)
        return self._stored(number, entry)

    def _stored(self, number: int, entry: dict[str, Any]) -> bytes:
        start, length = entry.get("byteOffset", 0), entry["byteLength"]
        if start < 0 or length < 1:
            raise ValueError(f"buffer view {number} has {length} bytes from {start}")
        data = self.buffers[entry["buffer"]][start : start + length]
        if len(data) < length:
            raise ValueError(f"buffer view {number} ends beyond its buffer")
        return data

    def _unpacked(self, number: int, packed: dict[str, Any]) -> bytes:
        """Return the bytes of a buffer view that meshopt compressed (EXT_meshopt_compression, its properties)."""
        count, stride = int(packed["count"]), int(packed["byteStride"])
        DATA.check(f"{self.path} buffer view {number}", count * stride, MeshError)
        data, kind = self._stored(number, packed), packed.get("filter", "NONE")
        with self._decompressing(number, "meshopt"):
            values = optional("meshopt").decode_gltf_buffer(data, count, stride, packed["mode"], kind)
            return bytes(np.ascontiguousarray(values).data.cast("B"))

    def draco(self, number: int) -> Any:
        """Return the mesh that a buffer view has by Draco."""
        with self._decompressing(number, "Draco"):
            return optional("DracoPy").decode(self.view(number))

    @contextmanager
    def _decompressing(self, number: int, called: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # whatever the decoder raises
            what = f"{type(error).__name__}: {error!s:.80}"
            raise self.broken(f"view {number}, compressed with {called}, is damaged", what) from error

    def broken(self, what: str, got: str, instead: str = "export it again") -> MeshError:
        """Return the error of a part of the file that cannot be used. instead: what to do."""
        return MeshError(f"{self.path} - {what} (got {got}) - {instead}")

    def accessor(self, number: int) -> NDArray[Any]:
        """Return an accessor (count, width): normalised integers as float64, others as they are stored."""
        entry = self.entry("accessors", number)
        width, count = _WIDTHS[entry["type"]], int(entry["count"])
        kind = np.dtype(_COMPONENTS[entry["componentType"]])
        DATA.check(f"{self.path} accessor {number}", count * width * np.dtype(np.float64).itemsize, MeshError)
        if "bufferView" in entry:
            stride = self.entry("bufferViews", entry["bufferView"]).get("byteStride", 0)
            values = self._elements(entry["bufferView"], entry.get("byteOffset", 0), kind, (count, width), stride)
        else:
            values = np.zeros((count, width), kind)
        if "sparse" in entry:
            values = self._sparse(entry["sparse"], values)
        return dequantised(values) if entry.get("normalized", False) else values

    def _elements(self, view: int, offset: int, kind: np.dtype[Any], shape: tuple[int, int], stride: int) -> Any:
        strides, data = (stride or shape[1] * kind.itemsize, kind.itemsize), self.view(view)
        if not data:  # NumPy takes an empty buffer for one of any length, and reads what lies behind it
            raise ValueError(f"buffer view {view} is empty")
        return np.ndarray(shape, kind, data, offset, strides)

    def _sparse(self, entry: dict[str, Any], values: NDArray[Any]) -> NDArray[Any]:
        """Return values with some of them replaced."""
        indices, places, count = entry["indices"], np.array(values), int(entry["count"])
        kind = np.dtype(_COMPONENTS[indices["componentType"]])
        at = self._elements(indices["bufferView"], indices.get("byteOffset", 0), kind, (count, 1), 0)[:, 0]
        shape = (count, values.shape[1])
        new = entry["values"]
        places[at] = self._elements(new["bufferView"], new.get("byteOffset", 0), values.dtype, shape, 0)
        return places

    def image(self, number: int) -> bytes:
        """Return the bytes of an image file."""
        entry = self.entry("images", number)
        if "bufferView" in entry:
            return self.view(entry["bufferView"])
        return _resource(self.path, entry["uri"], "texture", outside=self.outside)


def dequantised(values: NDArray[Any]) -> NDArray[Any]:
    """Return normalised integers as float64, in [0, 1] or [-1, 1] (section 3.6.2.2); floats as they are."""
    if values.dtype.kind == "f":
        return values
    return np.maximum(values.astype(np.float64) / np.iinfo(values.dtype).max, -1.0)


def open_gltf(path: Path, *, outside: bool = False) -> Gltf:
    """Return an opened .gltf or .glb; outside: its buffers and images may lie outside of its folder.

    Raises `MeshError` if it is no glTF, requires an unsupported extension, or names a file that cannot be read.
    """
    try:
        text, binary = _chunks(path)
        DATA.check(f"{path} JSON", _VALUE_BYTES * text.count(b","), MeshError)
        tree = dict(json_of(text))
    except (TypeError, ValueError, struct.error) as error:
        raise MeshError(f"{path} - is not glTF (got: {error!s:.120}) - export it again") from error
    _check_extensions(path, tree)
    for image in tree.get("images", []):
        uri = image.get("uri", "data:")
        if not uri.startswith("data:"):
            neighbour(path, unquote(uri), "texture", outside=outside, shown=uri)
    buffers = [_buffer(path, entry, binary, outside=outside) for entry in tree.get("buffers", [])]
    return Gltf(path, tree, tuple(buffers), outside)


def _chunks(path: Path) -> tuple[bytes, bytes]:
    """Return the JSON and the binary of a file (section 4.4)."""
    data = read_data(path, MeshError)
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):  # whatever the file's ending says
        return data, b""
    magic, version, _ = struct.unpack_from("<4sII", data)
    length, kind = struct.unpack_from("<II", data, 12)
    if magic != b"glTF" or version != 2 or kind != _JSON_CHUNK:
        raise MeshError(f"{path} - is not glTF 2.0 (got header {data[:8]!r}) - export it again")
    text, start = data[20 : 20 + length], 20 + length
    if len(data) < start + 8:
        return text, b""
    size, kind = struct.unpack_from("<II", data, start)
    return text, data[start + 8 : start + 8 + size] if kind == _BINARY_CHUNK else b""


def _resource(path: Path, uri: str, what: str, *, outside: bool) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.split(",", 1)[1])
    return read_data(neighbour(path, unquote(uri), what, outside=outside, shown=uri), MeshError)


def _buffer(path: Path, entry: dict[str, Any], binary: bytes, *, outside: bool) -> bytes:
    """Return the bytes of a buffer; none of one for programs that cannot decompress."""
    if any(entry.get("extensions", {}).get(name, {}).get("fallback", False) for name in _MESHOPT):
        return b""
    return _resource(path, entry["uri"], "buffer", outside=outside) if "uri" in entry else binary


@functools.cache
def _extensions() -> dict[str, dict[str, str]]:
    """Return what is known of extensions, by their names."""
    return {row["extension"]: row for row in own_table("composite/mesh/data/gltf_extensions.csv")}


def _check_extensions(path: Path, tree: dict[str, Any]) -> None:
    used = set(tree.get("extensionsUsed", []))
    for name in sorted(used & _PACKED.keys()):
        called, module = _PACKED[name]
        if not installed(module):
            raise MeshError(
                f"{path} - is compressed with {called}, which needs the package {module} - "
                f"{install_command('gltf')}, or export it without compression"
            )
    for name in sorted(set(tree.get("extensionsRequired", []))):
        known = _extensions().get(name, {})
        if known.get("standing", "shape") == "shape":
            raise MeshError(f"{path} - {known.get('refused') or f'requires the extension {name}'} - export it without")


def extension_notes(gltf: Gltf) -> list[str]:
    """Return a note for every extension that is used and not read."""
    notes = []
    for name in sorted(set(gltf.tree.get("extensionsUsed", []))):
        known = _extensions().get(name, {})
        if known.get("standing") not in ("read", "no effect"):
            what, instead = known.get("what", ""), known.get("instead", "it looks as without")
            notes.append(f"{gltf.path} - the extension {name}{what and f' ({what})'} is not drawn - {instead}")
    return notes


# Primitives, nodes, skins and morph targets of a glTF file (glTF 2.0 specification, sections 3.5 and 3.7).

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_INDICES = "indices"
Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Primitive:
    """Triangles `faces` (T, 3) over vertices (V, ...) in the mesh's own axes; columns: the attributes by name."""

    positions: Floats
    normals: Floats | None
    faces: NDArray[np.int64]
    columns: Columns

    def coordinates(self, of: MapCoordinates) -> Floats | None:
        """Return texture coordinates (V, 2), None where the primitive has none of that name."""
        column = self.columns.get(of.name)
        return None if column is None else of.of(column.astype(np.float64))

    @property
    def colors(self) -> Floats | None:
        """Linear vertex colours (V, 4)."""
        colors = self.columns.get("COLOR_0")
        if colors is None:
            return None
        rgba = np.ones((len(colors), 4))
        rgba[:, : colors.shape[1]] = dequantised(colors)
        if np.any(rgba < 0.0):
            raise ValueError(f"a vertex colour is negative: {rgba.min():g}")
        return rgba


def read_primitive(gltf: Gltf, entry: dict[str, Any]) -> Primitive | None:
    """Return a primitive; None for points and lines."""
    mode = entry.get("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in entry["attributes"]:
        return None
    columns = _columns(gltf, entry)
    positions = columns["POSITION"].astype(np.float64)
    normals = columns["NORMAL"].astype(np.float64) if "NORMAL" in columns else None
    if any(len(column) != len(positions) for name, column in columns.items() if name != _INDICES):
        raise ValueError("attributes of different lengths")
    order = columns.get(_INDICES, np.arange(len(positions))).astype(np.int64).ravel()
    if len(order) and not 0 <= order.min() <= order.max() < len(positions):
        raise IndexError(f"index {order.min() if order.min() < 0 else order.max()} of {len(positions)} vertices")
    return Primitive(positions, normals, _faces(order, mode), columns)


def _columns(gltf: Gltf, entry: dict[str, Any]) -> Columns:
    attributes: dict[str, int] = entry["attributes"]
    draco = entry.get("extensions", {}).get("KHR_draco_mesh_compression")
    if draco is None:
        columns = {name: gltf.accessor(number) for name, number in attributes.items()}
        return columns | ({_INDICES: gltf.accessor(entry["indices"])} if "indices" in entry else {})
    mesh, columns = gltf.draco(draco["bufferView"]), {}
    by_id = {packed["unique_id"]: np.asarray(packed["data"]) for packed in mesh.attributes}
    for name, number in draco["attributes"].items():
        values = by_id[number].reshape(len(mesh.points), -1)
        whole = gltf.entry("accessors", attributes[name]).get("normalized", False)
        columns[name] = dequantised(values) if whole else values
    return columns | {_INDICES: np.asarray(mesh.faces)}


def _faces(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (T, 3) of a list, strip or fan of vertices, with the winding of section 3.7.2.1."""
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    k = np.arange(max(len(order) - 2, 0))
    if mode == _FAN:
        return np.stack([order[k + 1], order[k + 2], np.broadcast_to(order[:1], k.shape)], axis=-1)
    return np.stack([order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]], axis=-1)


_SUM_ERROR = 2e-7
"""Error of the sum of weights, for each joint of a vertex, that is rounding (section 3.7.3.3); larger ones are divided
out. Half of it would touch files that follow the specification."""
_NOTED_SUM_ERROR = 0.01
"""Error of the sum of weights above which the user is told: a hundredth of a limb's movement."""


def read_skeleton(gltf: Gltf) -> Skeleton:
    """Return the nodes of the file's scene, each after its parent, roots in the scene's order."""
    nodes, scenes = gltf.listed("nodes"), gltf.listed("scenes")
    children = {c for node in nodes for c in node.get("children", [])}
    roots = [n for n in range(len(nodes)) if n not in children]
    if scenes:
        roots = gltf.entry("scenes", gltf.tree.get("scene", 0)).get("nodes", [])
    place: dict[int, int] = {}
    parents: list[int] = []
    pending: list[tuple[int, int]] = [(number, -1) for number in reversed(roots)]
    while pending:
        number, parent = pending.pop()
        if number in place:
            raise ValueError(f"node {number} hangs below two others")
        place[number] = len(parents)
        parents.append(parent)
        below = gltf.entry("nodes", number).get("children", [])
        pending += [(child, place[number]) for child in reversed(below)]
    used = [nodes[number] for number in place]
    translation = _column(used, "translation", (0.0, 0.0, 0.0))
    rotation = _column(used, "rotation", (0.0, 0.0, 0.0, 1.0))
    scale = _column(used, "scale", (1.0, 1.0, 1.0))
    local = composed(translation, rotation, scale)
    for number, node in enumerate(used):
        if "matrix" in node:  # stored column by column
            local[number] = np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    if not np.all(np.isfinite(local)):
        raise ValueError("a node is placed by numbers that are not finite")
    return Skeleton(tuple(parents), local, translation, rotation, scale, tuple(place))


def _column(nodes: list[dict[str, Any]], name: str, default: tuple[float, ...]) -> Floats:
    rows = [np.asarray(node.get(name, default), np.float64) for node in nodes]
    if not all(np.all(np.isfinite(row)) for row in rows):
        raise ValueError(f"a node has a {name} that is not finite")
    return np.stack(rows) if rows else np.zeros((0, len(default)))


def read_targets(gltf: Gltf, entry: dict[str, Any], vertices: int) -> tuple[MorphTarget, ...]:
    """Return the morph targets of a primitive; raise `MeshError` where one has not as many vertices as it."""
    targets: list[MorphTarget] = []
    for number, target in enumerate(entry.get("targets", [])):
        deltas: dict[str, Floats | None] = {"POSITION": None, "NORMAL": None}
        for name in deltas.keys() & target.keys():
            values = gltf.accessor(target[name]).astype(np.float64)
            if values.shape != (vertices, 3):
                got = f"{len(values)} rows of {name} for {vertices} vertices"
                raise gltf.broken(f"morph target {number} does not fit its mesh", got)
            if not np.all(np.isfinite(values)):
                raise gltf.broken(f"morph target {number} is broken", f"{name} that is not finite")
            deltas[name] = values
        targets.append((deltas["POSITION"], deltas["NORMAL"]))
    return tuple(targets)


def rest_weights(gltf: Gltf, node: dict[str, Any], mesh: dict[str, Any], targets: int) -> Floats | None:
    """Return the weights (m,) of morph targets at rest: the node's, the mesh's, or zeros; None without targets."""
    weights = np.asarray(node.get("weights", mesh.get("weights", np.zeros(targets))), np.float64)
    if weights.shape != (targets,) or not np.all(np.isfinite(weights)):
        raise gltf.broken("weights do not fit the morph targets", f"{weights.size} weights for {targets} targets")
    return weights if targets else None


def read_skin(gltf: Gltf, number: int, columns: Columns, place: dict[int, int]) -> tuple[Skin, tuple[str, ...]]:
    """Return a skin as the vertices of a primitive follow it, and notes on its weights.

    place: number in the skeleton of each node of the file. Raises `MeshError` where joints or weights are broken.
    """
    entry = gltf.entry("skins", number)
    joints: list[int] = list(entry["joints"])
    if missing := [joint for joint in joints if joint not in place]:
        what, todo = f"skin {number} follows nodes that are not in the scene", "export the armature with the mesh"
        raise gltf.broken(what, f"joint node {missing[0]}", todo)
    inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in entry:
        stored = gltf.accessor(entry["inverseBindMatrices"]).astype(np.float64)
        if len(stored) < len(joints) or stored.shape[1] != 16 or not np.all(np.isfinite(stored)):
            got = f"{len(stored)} for {len(joints)} joints, or entries that are not finite"
            raise gltf.broken(f"skin {number} has broken inverseBindMatrices", got)
        inverse_bind = stored[: len(joints)].reshape(-1, 4, 4).swapaxes(1, 2)  # stored column by column
    chosen, weights = _influences(gltf, number, columns)
    used = weights > 0.0
    if np.any(outside := used & ((chosen < 0) | (chosen >= len(joints)))):
        got = f"joint {int(chosen[outside][0])} of {len(joints)}"
        raise gltf.broken(f"skin {number} is followed by vertices of joints that it has not", got)
    weights, notes = _summing_to_one(gltf, number, weights)
    rows = np.broadcast_to(np.arange(len(weights))[:, None], weights.shape)
    used = weights > 0.0
    from scipy.sparse import csr_matrix

    sparse = csr_matrix((weights[used], (rows[used], chosen[used])), shape=(len(weights), len(joints)))
    return Skin(np.array([place[joint] for joint in joints], np.int64), inverse_bind, sparse), notes


def _influences(gltf: Gltf, number: int, columns: Columns) -> tuple[NDArray[np.int64], Floats]:
    """Return the joints and weights (V, 4 n) of all sets of a primitive."""
    sets = sorted(name.removeprefix("JOINTS_") for name in columns if name.startswith("JOINTS_"))
    chosen = np.concatenate([columns[f"JOINTS_{k}"].astype(np.int64) for k in sets], axis=1)
    values = [columns.get(f"WEIGHTS_{k}") for k in sets]
    present = [dequantised(value).astype(np.float64) for value in values if value is not None]
    weights = np.concatenate([np.zeros((len(chosen), 0)), *present], axis=1)
    if weights.shape != chosen.shape:
        got = f"{weights.shape[1]} weights a vertex for {chosen.shape[1]} joints"
        raise gltf.broken(f"skin {number} has joints without weights", got)
    bad = ~np.isfinite(weights) | (weights < 0.0)
    if np.any(bad):
        got = f"{float(weights[bad][0]):g} at vertex {int(np.nonzero(bad)[0][0])}"
        raise gltf.broken(f"skin {number} has broken weights", got, "paint the weights anew, or export it again")
    return chosen, weights


def _summing_to_one(gltf: Gltf, number: int, weights: Floats) -> tuple[Floats, tuple[str, ...]]:
    """Return weights whose rows sum to 1, and notes where they were far off.

    A vertex without any weight follows the first joint that it names.
    """
    total = weights.sum(axis=1)
    off = np.abs(total - 1.0)
    lost = total <= 0.0
    notes = []
    if np.any(lost):
        notes.append(
            f"{gltf.path} - skin {number} has {np.count_nonzero(lost)} vertices without weights - they follow the "
            "first joint that they name"
        )
    if np.any(far := ~lost & (off > _NOTED_SUM_ERROR)):
        notes.append(
            f"{gltf.path} - skin {number} has weights that do not sum to 1 (got {total[far][np.argmax(off[far])]:.3g}) "
            "- they are scaled to it"
        )
    scaled = ~lost & (off > _SUM_ERROR * np.count_nonzero(weights, axis=1))
    weights = np.where(scaled[:, None], weights / np.where(lost, 1.0, total)[:, None], weights)
    weights[lost, 0] = 1.0
    return weights, tuple(notes)
