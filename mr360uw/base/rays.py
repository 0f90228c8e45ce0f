# SPDX-License-Identifier: Apache-2.0
"""Ray-triangle intersection: first hits and occlusion of rays by triangles, and grids of parallel rays.

embree finds the triangle in single precision; the point on it is computed again in double precision. On platforms
without a wheel of embree, trimesh's own (slow) intersector is used.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact, exact_making
from mr360uw.types import Floats

_OVERLAP = 1e-9
"""Barycentric weight by which neighbouring triangles overlap, so that no ray of a grid passes between two."""


class RayScene:
    """Triangles (T, 3, 3), possibly none, with an acceleration structure for ray queries."""

    def __init__(self, triangles: Floats) -> None:
        self.triangles = np.asarray(triangles, np.float64)
        self._embree: Any = None
        self._trimesh: Any = None
        if len(self.triangles) == 0:
            return
        try:
            from embreex import rtcore_scene
            from embreex.mesh_construction import TriangleMesh

            self._embree = rtcore_scene.EmbreeScene()
            self._keep = TriangleMesh(self._embree, np.ascontiguousarray(self.triangles, np.float32))
        except ImportError:
            import trimesh

            faces = np.arange(3 * len(self.triangles)).reshape(-1, 3)
            self._trimesh = trimesh.Trimesh(self.triangles.reshape(-1, 3), faces, process=False).ray

    @cached_property
    def normals(self) -> Floats:
        """Normals (T, 3) of the triangles, to the side from which their corners run counter-clockwise; not unit."""
        a, b, c = (self.triangles[:, k] for k in range(3))
        return np.cross(b - a, c - a)

    def first_hit(self, origins: Floats, directions: Floats) -> NDArray[np.int64]:
        """Return the index (n,) of the nearest triangle along each ray, -1 for none."""
        return self._query(origins, directions, "INTERSECT")

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) hits anything nearer than `reach_m`, (n,) or a number for all."""
        if np.all(np.isinf(reach_m)):
            return self._query(origins, directions, "OCCLUDED") >= 0
        return np.asarray(self.distance(origins, directions) < reach_m)

    def distance(self, origins: Floats, directions: Floats) -> Floats:
        """Return the distance (n,) of each ray's nearest triangle in units of its direction, infinity for none."""
        triangle = self.first_hit(origins, directions)
        hit = np.flatnonzero(triangle >= 0)
        corners = self.triangles[triangle[hit]] - np.asarray(origins)[hit, None]
        found = np.full(len(origins), np.inf)
        found[hit] = barycentric(corners, np.asarray(directions)[hit])[1]
        return found

    def _query(self, origins: Floats, directions: Floats, query: str) -> NDArray[np.int64]:
        if len(self.triangles) == 0 or len(origins) == 0:
            return np.full(len(origins), -1, np.int64)
        if self._embree is not None:
            o, d = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
            return self._embree.run(o, d, query=query).astype(np.int64)
        return np.asarray(self._trimesh.intersects_first(origins, directions), np.int64)


class PlacedScene:
    """A scene of triangles moved by `matrix` (4, 4), a rotation, a scale and a translation: it is not built anew.

    linear: (3, 3) of the matrix.
    """

    def __init__(self, scene: RayScene, matrix: Floats) -> None:
        self.scene, self.linear, self._shift = scene, np.ascontiguousarray(matrix[:3, :3]), matrix[:3, 3]
        self._back = np.linalg.inv(self.linear)

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) hits anything nearer than `reach_m`, (n,) or a number for all."""
        return self.scene.occluded(self.inside(origins), np.asarray(directions) @ self._back.T, reach_m)

    def distance(self, origins: Floats, directions: Floats) -> Floats:
        """Return the distance (n,) of each ray's nearest triangle in units of its direction, infinity for none."""
        return self.scene.distance(self.inside(origins), np.asarray(directions) @ self._back.T)

    def inside(self, points: Floats) -> Floats:
        """Return points (..., 3) of the world in the scene's own axes."""
        return (np.asarray(points) - self._shift) @ self._back.T


def barycentric(triangles: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return barycentric weights (n, 3) and distances (n,) at which rays from the origin hit the planes of triangles.

    By triple products: the ray d is the sum of a, b, c weighted by d.(b x c), d.(c x a), d.(a x b).
    On the device: gl/shaders/geometry.glsl.
    """
    weights, distance = np.empty((len(triangles), 3)), np.empty(len(triangles))
    _intersect(np.asarray(triangles, np.float64), np.asarray(directions, np.float64), weights, distance)
    return weights, distance


@exact
def triple(d: Any, p: Any, q: Any) -> Any:
    """Return d.(p x (q - p))."""
    x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    return d[0] * (p[1] * z - p[2] * y) + d[1] * (p[2] * x - p[0] * z) + d[2] * (p[0] * y - p[1] * x)


@exact
def _intersect(triangles: Any, directions: Any, weights: Any, distance: Any) -> None:
    for n in range(len(triangles)):
        a, b, c, d = triangles[n, 0], triangles[n, 1], triangles[n, 2], directions[n]
        weights[n, 0], weights[n, 1], weights[n, 2] = triple(d, b, c), triple(d, c, a), triple(d, a, b)
        total = weights[n, 0] + weights[n, 1] + weights[n, 2]
        if abs(total) < 1e-300:
            total = 1e-300
        for k in range(3):
            weights[n, k] /= total
        distance[n] = triple(a, b, c) / total


@exact_making
def raise_to_triangles(triangles: Any, origin: Any, axes: Any, low: Any, step: Any, top: Any) -> None:
    """Raise heights `top` (m, n) to the highest triangle (T, 3, 3) at each place of a grid, as a depth buffer does.

    Places and heights are products with the rows of `axes` (3, 3) from an origin (3,), heights with the third. A place
    (i, j) of the grid lies at low + (i, j) step along the first two; low, step: (2,).
    """
    corner = np.empty((3, 3))
    for t in range(len(triangles)):
        # Turn the corners into the grid's axes
        for c in range(3):
            x, y, z = (triangles[t, c, 0] - origin[0], triangles[t, c, 1] - origin[1], triangles[t, c, 2] - origin[2])
            for k in range(3):
                corner[c, k] = x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2]
        # Express the triangle by a corner and two edges; one seen edge on covers nothing
        ax, ay, az = corner[0, 0] - low[0], corner[0, 1] - low[1], corner[0, 2]
        bx, by, bz = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - az
        cx, cy, cz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - az
        area = bx * cy - by * cx
        if area == 0.0:
            continue
        # Visit the places within its bounds, and compare by barycentric coordinates
        first_i = max(math.ceil((ax + min(bx, cx, 0.0)) / step[0] - _OVERLAP), 0)
        first_j = max(math.ceil((ay + min(by, cy, 0.0)) / step[1] - _OVERLAP), 0)
        last_i = min(math.floor((ax + max(bx, cx, 0.0)) / step[0] + _OVERLAP), top.shape[0] - 1)
        last_j = min(math.floor((ay + max(by, cy, 0.0)) / step[1] + _OVERLAP), top.shape[1] - 1)
        bx, by, cx, cy = bx / area, by / area, cx / area, cy / area
        for i in range(first_i, last_i + 1):
            x = i * step[0] - ax
            for j in range(first_j, last_j + 1):
                y = j * step[1] - ay
                b, c = x * cy - y * cx, bx * y - by * x
                if b >= -_OVERLAP and c >= -_OVERLAP and b + c <= 1.0 + _OVERLAP:
                    top[i, j] = max(top[i, j], az + b * bz + c * cz)
