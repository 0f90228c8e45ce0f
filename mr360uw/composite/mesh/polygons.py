# SPDX-License-Identifier: Apache-2.0
"""Polygons of any number of corners as triangles, with the values of faces, points and corners at their corners;
normals for those without any; affine transforms of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import MeshError
from mr360uw.types import Floats

_FLAT = 1e-12
"""Area against the square of the extent below which a triangle of a polygon is taken as none."""


@dataclass(frozen=True, slots=True, eq=False)
class Polygons:
    """Polygons of a mesh. corners: (C,) point of every corner, polygon after polygon; counts: (F,) corners of each.

    faces: (T, 3) triangles by numbers of corners, anticlockwise from outside; polygon: (T,) the polygon of each.
    """

    corners: NDArray[np.int64]
    counts: NDArray[np.int64]
    faces: NDArray[np.int64]
    polygon: NDArray[np.int64]

    def at_corners(self, values: Any, interpolation: str, name: str) -> Floats:
        """Return values (C, ...) by corner; raise `ValueError` where there are too few or too many.

        interpolation: what each belongs to, as USD calls it: the mesh (constant), a polygon (uniform), a point (vertex)
        or a corner (faceVarying).
        """
        array = np.asarray(values, np.float64)
        owner, wanted = {
            "constant": (np.zeros(len(self.corners), np.int64), 1),
            "uniform": (np.repeat(np.arange(len(self.counts)), self.counts), len(self.counts)),
            "faceVarying": (np.arange(len(self.corners)), len(self.corners)),
        }.get(interpolation, (self.corners, int(self.corners.max(initial=-1)) + 1))
        if len(array) < wanted or (owner is not self.corners and len(array) > wanted > 1):
            raise ValueError(f"{len(array)} values of {name} for {wanted}")
        return np.asarray(array[owner])


def check_corners(path: Path, corners: NDArray[np.int64], count: int) -> None:
    """Raise `MeshError` where a polygon of a file has a corner at none of its `count` vertices."""
    wrong = corners[(corners < 0) | (corners >= count)]
    if len(wrong):
        raise MeshError(
            f"{path} - has a face of a vertex that is not there (got {wrong[0]} of {count}, the first is 0)"
            " - export it again"
        )


def polygons_of(points: Floats, counts: Any, corners: Any, *, left_handed: bool, holes: Any = ()) -> Polygons:
    """Return polygons and their triangles; raise `ValueError` where the numbers contradict each other.

    points: (V, 3). counts: (F,) corners of each polygon. corners: (C,) their points. left_handed: polygons are
    clockwise from outside. holes: polygons that are not drawn.
    """
    counts, corners = np.asarray(counts, np.int64), np.asarray(corners, np.int64)
    if counts.sum() != len(corners) or counts.min(initial=0) < 0:
        raise ValueError(f"{len(corners)} corners for polygons of {counts.sum()}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise IndexError(f"point {corners.max()} of {len(points)}")
    first = np.cumsum(counts) - counts
    drawn = np.ones(len(counts), bool)
    drawn[np.asarray(holes, np.int64)] = False
    faces, polygon = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for size in np.unique(counts[counts > 2]).tolist():
        chosen = np.flatnonzero((counts == size) & drawn)
        ring = first[chosen, None] + np.arange(size)
        local = _triangles(points[corners[ring]])
        faces.append(np.take_along_axis(ring, local.reshape(len(chosen), -1), axis=1).reshape(-1, 3))
        polygon.append(np.repeat(chosen, size - 2))
    owner = np.concatenate(polygon)
    order = np.argsort(owner, kind="stable")
    triangles = np.concatenate(faces)[order]
    return Polygons(corners, counts, triangles[:, ::-1] if left_handed else triangles, owner[order])


def _triangles(points: Floats) -> NDArray[np.int64]:
    """Return the triangles (F, n - 2, 3) of polygons (F, n, 3): fans from the first corner, or ears of concave ones."""
    size = points.shape[1]
    k = np.arange(1, size - 1)
    fan = np.stack([0 * k, k, k + 1], axis=-1)
    result = np.broadcast_to(fan, (len(points), *fan.shape)).copy()
    if size == 3:
        return result
    normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell's
    edges = points[:, fan[:, 1:]] - points[:, None, :1]
    area = np.einsum("fkc,fc->fk", np.cross(edges[..., 0, :], edges[..., 1, :]), normal)
    least = -_FLAT * np.einsum("fc,fc->f", normal, normal)
    for concave in np.flatnonzero(np.any(area < least[:, None], axis=1)).tolist():
        result[concave] = _ears(points[concave], normal[concave])
    return result


def _ears(points: Floats, normal: Floats) -> NDArray[np.int64]:
    """Return the triangles (n - 2, 3) of a polygon (n, 3) by cutting off its ears one by one (Meisters 1975)."""
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    flat = points @ np.stack([across, np.cross(normal, across)], axis=-1)
    left, ears = list(range(len(points))), []
    while len(left) > 3:
        k = next((k for k in range(len(left)) if _is_ear(flat, left, k)), 0)  # 0: a polygon that crosses itself
        ears.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    return np.array([*ears, tuple(left)], np.int64)


def _is_ear(flat: Floats, left: list[int], k: int) -> bool:
    """Return whether a corner bends outwards and no other corner lies in its triangle."""
    ring = (left[k - 1], left[k], left[(k + 1) % len(left)])
    a, b, c = flat[list(ring)]
    if _turn(a, b, c) <= 0.0:
        return False
    others = flat[[number for number in left if number not in ring]]
    inside = (_turn(a, b, others) >= 0.0) & (_turn(b, c, others) >= 0.0) & (_turn(c, a, others) >= 0.0)
    return not bool(np.any(inside))


def _turn(a: Floats, b: Floats, c: Floats) -> Any:
    """Return twice the signed area of triangles a, b, c (..., 2): positive where they turn to the left."""
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])


# --- normals --------------------------------------------------------------------------------------------------------


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


# --- affine transforms ----------------------------------------------------------------------------------------------


def placed(
    transform: Floats, positions: Floats, normals: Floats | None, faces: NDArray[np.int64]
) -> tuple[Floats, Floats | None, NDArray[np.int64]]:
    """Return positions, normals and faces under a (4, 4) transform; a mirror turns the faces' winding round."""
    linear = transform[:3, :3]
    mirrored = bool(np.linalg.det(linear) < 0.0)
    if normals is not None:
        normals = normals @ cofactors(linear).T * (-1.0 if mirrored else 1.0)
    return positions @ linear.T + transform[:3, 3], normals, faces[:, ::-1] if mirrored else faces


def cofactors(linear: Floats) -> Floats:
    """Return what normals transform by (..., 3, 3), scaled to norm 1: cofactors, determinant times inverse transpose.

    They exist for transforms that flatten, too.
    """
    a, b, c = (linear[..., k, :] for k in range(3))
    matrix = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    return matrix / np.maximum(np.linalg.norm(matrix, axis=(-2, -1), keepdims=True), 1e-300)


def composed(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """Return the transforms (n, 4, 4) that scale (n, 3), turn by quaternions x, y, z, w (n, 4) and move (n, 3).

    glTF 2.0 specification, section 3.5.3: T R S.
    """
    x, y, z, w = rotation.T
    matrix = np.zeros((len(rotation), 4, 4))
    matrix[:, 3, 3] = 1.0
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:, :3, :3] = np.moveaxis(np.array(rows), -1, 0) * scale[:, None]
    matrix[:, :3, 3] = translation
    return matrix
