# SPDX-License-Identifier: Apache-2.0
"""Normals of triangles that have none, and the smooth pieces that triangles with normals make."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_CREASE_COSINE = 0.5
"""Edges sharper than 60 degrees stay sharp in meshes without normals."""


def face_normals(positions: Floats) -> Floats:
    """Return the unit normals (T, 3) of triangles (T, 3, 3) wound anticlockwise, zero for degenerate ones."""
    cross = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=-1, keepdims=True), 1e-30)


def crease_normals(positions: Floats) -> Floats:
    """Return unit corner normals (T, 3, 3): the mean, weighted by corner angle, of the faces about a vertex that
    meet this one at less than 60 degrees (Thuermer & Wuethrich 1998 for the weights).
    """
    face = face_normals(positions)
    before, after = np.roll(positions, 1, axis=1) - positions, np.roll(positions, -1, axis=1) - positions
    cosine = np.sum(before * after, -1) / np.maximum(
        np.linalg.norm(before, axis=-1) * np.linalg.norm(after, axis=-1), 1e-30
    )
    weight = np.arccos(np.clip(cosine, -1.0, 1.0)).ravel()
    extent = max(float(np.max(np.ptp(positions.reshape(-1, 3), axis=0))), 1e-30)
    vertex = _welded(positions.reshape(-1, 3), 1e-6 * extent)
    order = np.argsort(vertex, kind="stable")
    start = np.searchsorted(vertex[order], np.arange(vertex.max() + 2))
    count = np.diff(start)
    triangle = np.repeat(np.arange(len(positions)), 3)
    total = np.zeros((len(vertex), 3))
    for k in range(int(count.max())):  # the k-th face about every vertex
        has = count[vertex] > k
        other = order[start[vertex[has]] + k]
        n = face[triangle[other]]
        near = np.sum(n * face[triangle[has]], -1) > _CREASE_COSINE
        total[has] += np.where(near, weight[other], 0.0)[:, None] * n
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    total = np.where(length > 1e-12, total / np.maximum(length, 1e-12), face[triangle])
    return total.reshape(positions.shape)


def smooth_patches(positions: Floats, normals: Floats, piece: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number the smooth pieces: triangles are of one piece where they share a corner's place and normal."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    extent = float(np.max(np.ptp(positions.reshape(-1, 3), axis=0)))
    key = np.concatenate(
        [
            positions.reshape(-1, 3) / (1e-6 * extent),
            normals.reshape(-1, 3) / 0.01,
            np.repeat(piece, 3)[:, None].astype(np.float64),
        ],
        axis=1,
    )
    corner = _welded(key, 1.0)
    count = len(positions)
    graph = coo_matrix(
        (np.ones(len(corner), np.int8), (np.repeat(np.arange(count), 3), count + corner)),
        shape=(count + corner.max() + 1,) * 2,
    )
    labels = connected_components(graph, directed=False)[1][:count]
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def _welded(points: Floats, resolution: float) -> NDArray[np.int64]:
    """Return the number (n,) of the place that each point (n, k) is at, places being `resolution` apart."""
    grid = np.round(points / resolution).astype(np.int64)
    order = np.lexsort(grid.T)
    different = np.any(np.diff(grid[order], axis=0) != 0, axis=1)
    label = np.empty(len(grid), np.int64)
    label[order] = np.concatenate([[0], np.cumsum(different)])
    return label
