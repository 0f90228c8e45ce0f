# SPDX-License-Identifier: Apache-2.0
"""Polygons of any number of corners as triangles, with the values of faces, points and corners at their corners."""

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
        owner = {
            "constant": np.zeros(len(self.corners), np.int64),
            "uniform": np.repeat(np.arange(len(self.counts)), self.counts),
            "faceVarying": np.arange(len(self.corners)),
        }.get(interpolation, self.corners)
        sizes = {"constant": 1, "uniform": len(self.counts), "faceVarying": len(self.corners)}
        wanted = sizes.get(interpolation, int(self.corners.max(initial=-1)) + 1)
        if len(array) < wanted or (interpolation in sizes and len(array) > wanted > 1):
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
