# SPDX-License-Identifier: Apache-2.0
"""One primitive of a glTF mesh: its triangles and vertices (glTF 2.0 specification, sections 3.7.2 and 3.7.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.gltf import Gltf, dequantised
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
