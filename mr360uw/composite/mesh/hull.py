# SPDX-License-Identifier: Apache-2.0
"""Convex hulls: bounds of meshes, and of their poses, in every frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_MANY = 50_000
"""Distinct points above which the hull is simplified."""
_SHALLOW = 1e-4
_SLAB_MARGIN = 1e-5
"""What a hull of slabs is larger by on every side, in terms of the extent: it keeps flat bodies from having no inside.
A hundredth of a pixel for a body that fills a frame of 1000 rows."""
SLAB_AXES = np.array([
    (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1),
    (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1),
], np.float64)  # fmt: skip
"""Normals, not unit, of the pairs of planes about a pose: of faces, edges and corners of a cube."""


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
