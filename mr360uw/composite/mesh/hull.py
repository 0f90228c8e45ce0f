# SPDX-License-Identifier: Apache-2.0
"""The convex hull of a mesh: what is asked every frame for where it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_MANY = 50_000
_SHALLOW = 1e-4


def hull_triangles(positions: Floats, place: NDArray[np.int64]) -> Floats:
    """Return the triangles of the convex hull, or of the bounding box where the mesh is flat.

    place: (3 T,) the number of every corner's place. Of meshes with very many, points may stand out of the hull by as
    much as `_SHALLOW` of the extent: less than the pixel that is added about an object, and far fewer triangles.
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
