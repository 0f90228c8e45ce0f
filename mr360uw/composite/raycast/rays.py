# SPDX-License-Identifier: Apache-2.0
"""Ray-triangle intersection of the reference renderer.

embree finds the triangle in single precision; the point on it is computed again in double precision. On platforms
without a wheel of embree, trimesh's own (slow) intersector is used.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats


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

    def first_hit(self, origins: Floats, directions: Floats) -> NDArray[np.int64]:
        """Return the index (n,) of the nearest triangle along each ray, -1 for none."""
        return self._query(origins, directions, "INTERSECT")

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) hits anything nearer than `reach_m`, (n,) or a number for all."""
        if np.all(np.isinf(reach_m)):
            return self._query(origins, directions, "OCCLUDED") >= 0
        triangle = self.first_hit(origins, directions)
        hit = np.flatnonzero(triangle >= 0)
        corners = self.triangles[triangle[hit]] - np.asarray(origins)[hit, None]
        _, distance = barycentric(corners, np.asarray(directions)[hit])
        blocked = np.zeros(len(origins), np.bool_)
        blocked[hit] = distance < np.broadcast_to(reach_m, len(origins))[hit]
        return blocked

    def _query(self, origins: Floats, directions: Floats, query: str) -> NDArray[np.int64]:
        if len(self.triangles) == 0 or len(origins) == 0:
            return np.full(len(origins), -1, np.int64)
        if self._embree is not None:
            o, d = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
            return self._embree.run(o, d, query=query).astype(np.int64)
        return np.asarray(self._trimesh.intersects_first(origins, directions), np.int64)


def barycentric(triangles: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return barycentric weights (n, 3) and distances (n,) at which rays from the origin hit the planes of triangles.

    By triple products: the ray d is the sum of a, b, c weighted by d.(b x c), d.(c x a), d.(a x b).
    On the device: gl/shaders/rays.glsl.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    bc, ca, ab = np.cross(b, c - b), np.cross(c, a - c), np.cross(a, b - a)
    weights = np.stack([np.sum(directions * w, -1) for w in (bc, ca, ab)], axis=-1)
    total = weights.sum(axis=-1)
    total = np.where(np.abs(total) < 1e-300, 1e-300, total)
    return weights / total[:, None], np.sum(a * bc, -1) / total
