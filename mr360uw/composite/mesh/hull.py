# SPDX-License-Identifier: Apache-2.0
"""Per-mesh proxies used every frame: a convex hull for bounds and surfels for ambient occlusion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_MANY = 50_000
"""Distinct points above which the hull is simplified."""
_SHALLOW = 1e-4
_NO_AREA = 1e-300
"""Area of triangles that a pose collapses: mean places of nothing else stay numbers."""
_SLAB_MARGIN = 1e-5
"""What a hull of slabs is larger by on every side, in terms of the extent: it keeps flat bodies from having no inside.
A hundredth of a pixel for a body that fills a frame of 1000 rows."""
SLAB_AXES = np.array([
    (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1),
    (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1),
], np.float64)  # fmt: skip
"""Normals, not unit, of the pairs of planes about a pose: of faces, edges and corners of a cube."""
SURFELS = 32
"""Discs that represent a body in ambient occlusion. Twice as many: finer contact shadows at twice the cost."""


def hull_triangles(positions: Floats, place: NDArray[np.int64]) -> Floats:
    """Return the triangles of the convex hull, or of the bounding box where the mesh is flat.

    place: (3 T,) index of every corner's position. Above `_MANY` positions, points may lie outside the hull by up to
    `_SHALLOW` of the extent: less than the pixel added around an object, with far fewer triangles.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = positions.reshape(-1, 3)
    one = np.empty(place.max() + 1, np.int64)
    one[place] = np.arange(len(place))  # of the corners at a place, any
    points = points[one]
    try:
        shallow = _SHALLOW * float(np.max(np.ptp(points, axis=0)))
        hull = ConvexHull(points, qhull_options=f"Qt W{shallow:.3g}" if len(points) > _MANY else "Qt")
        return points[hull.simplices]
    except QhullError:
        low, high = points.min(axis=0), points.max(axis=0)
        box = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(8, 3)
        sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
        return box[[t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]]


def slabs(points: Floats) -> Floats:
    """Return the least and the greatest coordinate (13, 2) of points (n, 3) along `SLAB_AXES`."""
    along = np.einsum("ak,vk->av", SLAB_AXES, points)
    return np.stack([along.min(axis=1), along.max(axis=1)], axis=-1)


def slab_hull(bounds: Floats, inside: Floats, more: float = 0.0) -> Floats:
    """Return the triangles (h, 3, 3) of the convex body between planes at `bounds` (13, 2), as `slabs` returns them.

    It holds all the points, and its bounding box is theirs but for `_SLAB_MARGIN`: a hull for poses, found in a
    millisecond (Klosowski et al. 1998, 26-DOP). inside: a point (3,) of their convex hull, such as their mean.
    more: what it is larger by on every side.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    margin = _SLAB_MARGIN * float(np.max(bounds[:3, 1] - bounds[:3, 0]))
    wider = (margin + more) * np.linalg.norm(SLAB_AXES, axis=-1, keepdims=True)
    planes = np.concatenate([
        np.append(SLAB_AXES, -bounds[:, 1:] - wider, axis=1), np.append(-SLAB_AXES, bounds[:, :1] - wider, axis=1)
    ])  # fmt: skip
    points = HalfspaceIntersection(planes, inside).intersections
    return np.asarray(points[ConvexHull(points).simplices])


def make_surfels(positions: Floats, piece: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Return at most `SURFELS` discs (position, area vector) of the triangles (T, 3, 3) of pieces (T,)."""
    clusters, weight = surfel_clusters(positions, piece)
    return surfels(positions, clusters, weight)


def surfel_clusters(positions: Floats, piece: NDArray[np.int32]) -> tuple[list[NDArray[np.int64]], Floats]:
    """Return at most `SURFELS` lists of triangles, and the weight (T,) of each triangle's area.

    Halves of equal area along the longest axis, again and again, over place and facing.
    """
    vector = 0.5 * np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    area = np.linalg.norm(vector, axis=-1)
    center = positions.mean(axis=1)
    weight = np.empty(len(area))
    for k in np.unique(piece):
        of = piece == k
        closed = np.linalg.norm(vector[of].sum(axis=0)) < 0.2 * area[of].sum()
        weight[of] = 0.5 if closed else 1.0
    extent = float(np.max(np.ptp(center, axis=0))) or 1.0
    feature = np.concatenate([center.T / extent, 0.5 * vector.T / area])
    clusters = [np.arange(len(area))]
    while len(clusters) < SURFELS:
        halves = []
        for cluster in clusters:
            axis = int(np.argmax([np.ptp(row[cluster]) for row in feature]))
            order = cluster[np.argsort(feature[axis, cluster], kind="stable")]
            cut = int(np.searchsorted(np.cumsum(area[order]), 0.5 * area[order].sum()))
            halves += [part for part in (order[: cut + 1], order[cut + 1 :]) if len(part)]
        if len(halves) == len(clusters):
            break
        clusters = halves
    return clusters, weight


def surfels(positions: Floats, clusters: Sequence[NDArray[np.int64]], weight: Floats) -> tuple[Floats, Floats]:
    """Return a disc (position, area vector) for each cluster of triangles, as `surfel_clusters` returns them."""
    order = np.concatenate(clusters)
    # one row a coordinate: a few times faster than (T, 3) arrays
    ax, ay, az, bx, by, bz, cx, cy, cz = positions.reshape(-1, 9).T.take(order, axis=1)
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    vector = 0.5 * np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
    area = np.maximum(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]), _NO_AREA)
    moment = np.stack([ax + bx + cx, ay + by + cy, az + bz + cz]) / 3.0 * area
    vector, moment, weighted = vector.T.copy(), moment.T.copy(), weight[order] * area
    ends = np.cumsum([len(cluster) for cluster in clusters])
    parts = [slice(end - len(cluster), end) for end, cluster in zip(ends.tolist(), clusters, strict=True)]
    place = np.stack([moment[part].sum(axis=0) / area[part].sum() for part in parts])
    total = np.array([weighted[part].sum() for part in parts])
    facing = np.stack([vector[part].sum(axis=0) for part in parts])
    facing = facing / np.maximum(np.linalg.norm(facing, axis=-1, keepdims=True), 1e-30)
    return place, facing * total[:, None]
