# SPDX-License-Identifier: Apache-2.0
"""Normals for meshes without any, and the partition of triangles into smooth pieces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_CREASE_COSINE = 0.5
"""Edges sharper than 60 degrees stay sharp in meshes without normals."""
_LARGEST = 2**62
_NO_NORMAL = 1e-6
"""Length of a file's normal below which it is none."""


def face_normals(positions: Floats) -> Floats:
    """Return the unit normals (T, 3) of triangles (T, 3, 3) wound anticlockwise, zero for degenerate ones."""
    cross = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=-1, keepdims=True), 1e-30)


def corner_normals(positions: Floats, normals: Floats | None, faces: NDArray[np.int64]) -> Floats:
    """Return unit normals (T, 3, 3) of the corners of triangles (T, 3, 3) from those of vertices (V, 3), of any length.

    faces: (T, 3) vertices of the triangles. Where the normals are None or have no length, the triangle is flat.
    """
    if normals is None:
        return np.broadcast_to(face_normals(positions)[:, None], positions.shape)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = (normals / np.maximum(length, _NO_NORMAL)).take(faces, axis=0)
    if np.all(length > _NO_NORMAL):
        return np.asarray(unit)
    return np.where(length[faces] > _NO_NORMAL, unit, face_normals(positions)[:, None])


def crease_normals(positions: Floats, crease_cosine: float = _CREASE_COSINE) -> Floats:
    """Return unit corner normals (T, 3, 3): the mean, weighted by corner angle, of the faces about a vertex that
    meet this one at less than the crease angle (Thuermer & Wuethrich 1998 for the weights).
    """
    face = face_normals(positions)
    before, after = np.roll(positions, 1, axis=1) - positions, np.roll(positions, -1, axis=1) - positions
    cosine = np.sum(before * after, -1) / np.maximum(
        np.linalg.norm(before, axis=-1) * np.linalg.norm(after, axis=-1), 1e-30
    )
    weight = np.arccos(np.clip(cosine, -1.0, 1.0)).ravel()
    vertex = welded(positions)
    # sorted by vertex, so that the corners of one vertex are adjacent
    order = np.argsort(vertex, kind="stable")
    normal, weight = face[order // 3], weight[order]
    size = np.bincount(vertex)
    first = np.cumsum(size) - size
    total, is_round = _vertex_sums(normal, weight, first, size, crease_cosine)
    start, count = np.repeat(first, size), np.repeat(size, size)
    corner = np.flatnonzero(~is_round)
    total[corner] = 0.0
    for k in range(int(count[corner].max(initial=0))):  # the k-th face of every vertex that has more than k
        corner = corner[count[corner] > k]
        other = start[corner] + k
        n = normal[other]
        near = np.einsum("ij,ij->i", n, normal[corner]) > crease_cosine
        total[corner] += np.where(near, weight[other], 0.0)[:, None] * n
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    normals = np.empty_like(total)
    normals[order] = np.where(length > 1e-12, total / np.maximum(length, 1e-12), normal)
    return normals.reshape(positions.shape)


def _vertex_sums(
    normal: Floats, weight: Floats, first: NDArray[np.int64], size: NDArray[np.int64], crease_cosine: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return for every corner the weighted sum (n, 3) of all normals at its vertex, and whether it is round (n,).

    A vertex is round if all normals are within half the crease angle of one axis: then no two of them make a crease.
    first, size: (v,) of the vertices' runs of corners.
    """
    total = np.add.reduceat(weight[:, None] * normal, first, axis=0)
    axis = np.repeat(total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-30), size, axis=0)
    least = np.minimum.reduceat(np.einsum("ij,ij->i", normal, axis), first)
    is_round = least > np.sqrt(0.5 * (1.0 + crease_cosine))
    return np.repeat(total, size, axis=0), np.repeat(is_round, size)


def smooth_patches(place: NDArray[np.int64], normals: Floats, piece: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the index (T,) of each triangle's smooth piece: those of one piece share a corner's position and normal.

    place: (3 T,) index of every corner's position.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    facing = np.round(normals.reshape(-1, 3) / 0.01).astype(np.int64)
    corner = _labels([place, *facing.T, np.repeat(piece, 3).astype(np.int64)])
    count = len(normals)
    graph = coo_matrix(
        (np.ones(len(corner), np.int8), (np.repeat(np.arange(count), 3), count + corner)),
        shape=(count + corner.max() + 1,) * 2,
    )
    labels = connected_components(graph, directed=False)[1][:count]
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def welded(positions: Floats) -> NDArray[np.int64]:
    """Return the index (3 T,) of every corner's position; positions are equal within a millionth of the extent."""
    points = positions.reshape(-1, 3)
    resolution = 1e-6 * max(float(np.max(np.ptp(points, axis=0))), 1e-30)
    return _labels(list(np.round(points / resolution).astype(np.int64).T))


def _labels(columns: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return a label (n,) for every row of integer columns, from 0 without gaps; equal rows have equal labels.

    Rows are packed into single integers, which sort many times faster.
    """
    label, count = np.zeros(len(columns[0]), np.int64), 1
    for column in columns:
        low = int(column.min())
        span = int(column.max()) - low + 1
        if count * span > _LARGEST:
            label = np.unique(label, return_inverse=True)[1]
            count = int(label.max()) + 1
        label = label * span + (column - low)
        count *= span
    return np.asarray(np.unique(label, return_inverse=True)[1])
