# SPDX-License-Identifier: Apache-2.0
"""Bodies of the dives as triangles with normals, and as files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from benchmarks.closed.dives import Dive
from mr360uw.base.rays import RayScene, barycentric
from mr360uw.base.sphere import yaw_matrix
from mr360uw.sample.dive import write_whale
from mr360uw.types import Floats

_BOX_CELLS = 8
_LIFT_M = 2e-3
"""Distance from the surface at which rays from it start."""


@dataclass(frozen=True, eq=False)
class Body:
    """Points (V, 3) in the world, their unit normals, faces (F, 3), corners counter-clockwise from outside."""

    points: Floats
    normals: Floats
    faces: NDArray[np.int64]

    @cached_property
    def rays(self) -> RayScene:
        """Its triangles."""
        return RayScene(self.points[self.faces])

    @property
    def starts(self) -> Floats:
        """Points (V, 3) just outside of the vertices."""
        return self.points + _LIFT_M * self.normals

    def hit(self, origin: Floats, direction: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Return which rays hit, with the face's corners' numbers (h, 3) and their weights (h, 3)."""
        triangle = self.rays.first_hit(origin, direction)
        met = np.flatnonzero(triangle >= 0)
        corners = self.faces[triangle[met]]
        weights, _ = barycentric(self.points[corners] - origin[met, None], direction[met])
        return met, corners, weights


def body_of(dive: Dive) -> Body:
    """Return the body of a dive in its place."""
    points, normals, faces = _shape(dive)
    turn = yaw_matrix(dive.yaw_rad)
    return Body(points @ turn.T + dive.center, normals @ turn.T, faces)


def write_body(dive: Dive, path: Path) -> None:
    """Write the body about its own centre as binary glTF."""
    import trimesh

    points, normals, faces = _shape(dive)
    trimesh.Trimesh(points, faces, vertex_normals=normals, process=False).export(path, include_normals=True)


def _shape(dive: Dive) -> tuple[Floats, Floats, NDArray[np.int64]]:
    if dive.shape == "ball":
        return _ball(dive.size_m)
    return _box(dive.size_m) if dive.shape == "box" else _whale(dive.size_m)


def _ball(radius_m: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    import trimesh

    mesh = trimesh.creation.icosphere(4, 1.0)
    normals = np.asarray(mesh.vertices)
    return radius_m * normals, normals, np.asarray(mesh.faces)


def _box(half_m: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return a box (1, 0.8, 1.2) half sides, each face with vertices of its own."""
    place = np.linspace(-1.0, 1.0, _BOX_CELLS + 1)
    a, b = (g.ravel() for g in np.meshgrid(place, place))
    corner = np.arange((_BOX_CELLS + 1) ** 2).reshape(_BOX_CELLS + 1, -1)
    p, q, r, s = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    cells = np.concatenate([np.stack([p, q, r], -1).reshape(-1, 3), np.stack([p, r, s], -1).reshape(-1, 3)])
    points, normals, faces = [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            face = np.empty((len(a), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, a, b
            faces.append((cells if side > 0.0 else cells[:, ::-1]) + len(a) * len(points))
            points.append(face)
            normals.append(np.tile(side * np.eye(3)[axis], (len(a), 1)))
    return half_m * np.array([1.0, 0.8, 1.2]) * np.concatenate(points), np.concatenate(normals), np.concatenate(faces)


def _whale(half_m: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the sample whale."""
    import trimesh

    with TemporaryDirectory() as folder:
        write_whale(Path(folder) / "whale.glb", 2.0 * half_m, detail="low", swims=False)
        mesh = trimesh.load(Path(folder) / "whale.glb", force="mesh", process=False)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.vertex_normals, np.float64), np.asarray(mesh.faces)
