# SPDX-License-Identifier: Apache-2.0
"""Per-mesh proxies used every frame: a convex hull for bounds and surfels for ambient occlusion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_MANY = 50_000
"""Distinct points above which the hull is simplified."""
_SHALLOW = 1e-4
"""Distance by which points may lie outside a simplified hull, as a fraction of the extent."""
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


def make_surfels(positions: Floats, piece: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Return at most `SURFELS` discs (position (s, 3), area vector (s, 3)) of triangles, clustered by recursive halving
    of the area along the longest axis of (position, normal).
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
    place = np.stack([np.average(center[c], axis=0, weights=area[c]) for c in clusters])
    total = np.array([np.sum(weight[c] * area[c]) for c in clusters])
    facing = np.stack([vector[c].sum(axis=0) for c in clusters])
    facing = facing / np.maximum(np.linalg.norm(facing, axis=-1, keepdims=True), 1e-30)
    return place, facing * total[:, None]
