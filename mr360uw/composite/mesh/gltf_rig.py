# SPDX-License-Identifier: Apache-2.0
"""Primitives, nodes, skins and morph targets of a glTF file (glTF 2.0 specification, sections 3.5 and 3.7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.affine import composed
from mr360uw.composite.mesh.gltf import Gltf, dequantised
from mr360uw.composite.mesh.material import MapCoordinates
from mr360uw.composite.mesh.skin import MorphTarget, Skeleton, Skin
from mr360uw.errors import MeshError
from mr360uw.types import Floats

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
    columns = {name: gltf.accessor(number) for name, number in attributes.items()} if draco is None else {}
    if draco is None and "indices" in entry:
        columns[_INDICES] = gltf.accessor(entry["indices"])
    if draco is not None:
        mesh = gltf.draco(draco["bufferView"])
        by_id = {packed["unique_id"]: np.asarray(packed["data"]) for packed in mesh.attributes}
        for name, number in draco["attributes"].items():
            values = by_id[number].reshape(len(mesh.points), -1)
            whole = gltf.entry("accessors", attributes[name]).get("normalized", False)
            columns[name] = dequantised(values) if whole else values
        columns[_INDICES] = np.asarray(mesh.faces)
    return columns


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
                raise MeshError(
                    f"{gltf.path} - morph target {number} does not fit its mesh (got {len(values)} rows of {name} for "
                    f"{vertices} vertices) - export it again"
                )
            if not np.all(np.isfinite(values)):
                raise MeshError(
                    f"{gltf.path} - morph target {number} is broken (got {name} that is not finite) - export it again"
                )
            deltas[name] = values
        targets.append((deltas["POSITION"], deltas["NORMAL"]))
    return tuple(targets)


def rest_weights(gltf: Gltf, node: dict[str, Any], mesh: dict[str, Any], targets: int) -> Floats | None:
    """Return the weights (m,) of morph targets at rest: the node's, the mesh's, or zeros; None without targets."""
    weights = np.asarray(node.get("weights", mesh.get("weights", np.zeros(targets))), np.float64)
    if weights.shape != (targets,) or not np.all(np.isfinite(weights)):
        raise MeshError(
            f"{gltf.path} - weights do not fit the morph targets (got {weights.size} weights for {targets} targets) - "
            "export it again"
        )
    return weights if targets else None


def read_skin(gltf: Gltf, number: int, columns: Columns, place: dict[int, int]) -> tuple[Skin, tuple[str, ...]]:
    """Return a skin as the vertices of a primitive follow it, and notes on its weights.

    place: number in the skeleton of each node of the file. Raises `MeshError` where joints or weights are broken.
    """
    entry = gltf.entry("skins", number)
    joints: list[int] = list(entry["joints"])
    if missing := [joint for joint in joints if joint not in place]:
        raise MeshError(
            f"{gltf.path} - skin {number} follows nodes that are not in the scene (got joint node {missing[0]}) - "
            "export the armature with the mesh"
        )
    inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in entry:
        stored = gltf.accessor(entry["inverseBindMatrices"]).astype(np.float64)
        if len(stored) < len(joints) or stored.shape[1] != 16 or not np.all(np.isfinite(stored)):
            raise MeshError(
                f"{gltf.path} - skin {number} has broken inverseBindMatrices (got {len(stored)} for {len(joints)} "
                "joints, or entries that are not finite) - export it again"
            )
        inverse_bind = stored[: len(joints)].reshape(-1, 4, 4).swapaxes(1, 2)  # stored column by column
    chosen, weights = _influences(gltf, number, columns)
    used = weights > 0.0
    if np.any(outside := used & ((chosen < 0) | (chosen >= len(joints)))):
        raise MeshError(
            f"{gltf.path} - skin {number} is followed by vertices of joints that it has not (got joint "
            f"{int(chosen[outside][0])} of {len(joints)}) - export it again"
        )
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
        raise MeshError(
            f"{gltf.path} - skin {number} has joints without weights (got {weights.shape[1]} weights a vertex for "
            f"{chosen.shape[1]} joints) - export it again"
        )
    bad = ~np.isfinite(weights) | (weights < 0.0)
    if np.any(bad):
        raise MeshError(
            f"{gltf.path} - skin {number} has broken weights (got {float(weights[bad][0]):g} at vertex "
            f"{int(np.nonzero(bad)[0][0])}) - paint the weights anew, or export it again"
        )
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
