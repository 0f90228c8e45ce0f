# SPDX-License-Identifier: Apache-2.0
"""Form factors between the sample points of a body and the ground below it, by the body's turn and height alone.

Near a body the ground is taken as level, at the height of the receiver below it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.directions import COUNT, SOLID_ANGLE, directions
from mr360uw.composite.ambient.mesh_transfer import Transfer, met_samples
from mr360uw.composite.receiver.shape import ReceiverShape, kept_shape
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.rays import RayScene, barycentric
from mr360uw.types import Floats


def ground_heights(shot: Shot, objects: Sequence[PlacedObject], cache: Cache) -> list[float | None]:
    """Return the height [m] of the ground below each object in the world, None where there is none.

    Of a mesh straight below the body's middle; of a distance map where the camera sees the middle of its underside.
    """
    receiver = shot.receiver
    if receiver is None or not receiver.occlusion:
        return [None] * len(objects)
    if receiver.plane_y is not None:
        return [receiver.plane_y] * len(objects)
    mesh = receiver.mesh
    if mesh is not None:
        scene = cache.of(RayScene, mesh)
        return [_below(scene, placed) for placed in objects]
    shape = kept_shape(receiver, shot.view.position, cache)
    return [_seen(shot, shape, placed) for placed in objects]


def _below(scene: RayScene, placed: PlacedObject) -> float | None:
    start, down = placed.to_world(placed.mesh.center_m)[None], np.array([[0.0, -1.0, 0.0]])
    triangle = scene.first_hit(start, down)
    if triangle[0] < 0:
        return None
    _, distance = barycentric(scene.triangles[triangle] - start[:, None], down)
    return float(start[0, 1] - distance[0])


def _seen(shot: Shot, shape: ReceiverShape, placed: PlacedObject) -> float | None:
    points = placed.to_world(placed.mesh.hull.reshape(-1, 3))
    middle = placed.to_world(placed.mesh.center_m)
    middle[1] = points[:, 1].min()
    ray = middle - shot.view.position
    x, y = shot.view.places(ray[None])
    distance, _ = shape.meet(shot, x, y)
    if not np.isfinite(distance[0]):
        return None
    return float(shot.view.position[1] + shot.view.points(shot.view.directions(x, y), distance)[0, 1])


NODES, COARSE_NODES = 16, 8
"""Points along each side of the square of ground that a body sees in its own shade; ambient light, which has no edges,
is found at fewer."""
_NODE_REACH, _REACH_WITH_HEIGHT = 2.0, 1.0
"""Half side of that square over the body's radius, and how it grows with the gap below the body: beyond it the body
blocks less than a twentieth, and shadows of a sun above 45 degrees end."""
_NEAR_GROUND = 9.0
"""Bodies higher above the ground than this many radii block less than a hundredth of its light."""
_LIFT = 1e-3
"""Height of samples and nodes above the ground over the body's radius, at least."""
_FEW = 0.002
"""Share of a node's light below which the mean of what it sees is drawn to that of its neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelGround:
    """Level ground below a body. rotation: (3, 3) the mesh's axes to the world's; height_m: of the mesh's middle above
    the ground, in the mesh's metres.
    """

    rotation: Floats
    height_m: float

    @property
    def key(self) -> bytes:
        """Equal for equal ground."""
        return self.rotation.tobytes() + np.float64(self.height_m).tobytes()

    def covers(self, transfer: Transfer) -> bool:
        """Return whether a sample of a mesh lies below the ground, or nearly."""
        if self._far_below(transfer):
            return False
        above = (transfer.lattice.position - transfer.mesh.center_m) @ self.rotation[1]
        return bool(above.min() < _LIFT * transfer.mesh.radius_m - self.height_m)

    def _far_below(self, transfer: Transfer) -> bool:
        """Return whether no sample of a mesh, all of which lie hardly outside its ball, can be near the ground."""
        return self.height_m > 1.01 * transfer.mesh.radius_m

    def lifted(self, transfer: Transfer, position: Floats) -> Floats:
        """Return positions (n, 3) of a mesh, those below the ground just above it."""
        if self._far_below(transfer):
            return position
        up, least = self.rotation[1], _LIFT * transfer.mesh.radius_m - self.height_m
        below = np.maximum(least - (position - transfer.mesh.center_m) @ up, 0.0)
        return np.asarray(position + below[:, None] * up)

    def near(self, transfer: Transfer) -> bool:
        """Return whether a body is so near that the ground in its shade matters to it."""
        radius = transfer.mesh.radius_m
        return -radius < self.height_m < (1.0 + _NEAR_GROUND) * radius

    def nodes(self, transfer: Transfer, side: int = NODES) -> Floats:
        """Return the places (side^2, 3) of nodes from the mesh's middle, in axes of the world [m of the mesh]."""
        line = ((np.arange(side) + 0.5) / side * 2.0 - 1.0) * self.half_m(transfer)
        x, z = np.meshgrid(line, line, indexing="ij")
        return np.stack([x, np.full_like(x, -self.height_m), z], axis=-1).reshape(-1, 3)

    def half_m(self, transfer: Transfer) -> float:
        """Return half the side of the square of nodes, in the mesh's metres."""
        radius = transfer.mesh.radius_m
        return _NODE_REACH * radius + _REACH_WITH_HEIGHT * max(self.height_m - radius, 0.0)

    def node_seen(self, transfer: Transfer, position: Floats) -> NDArray[np.int16]:
        """Return the number (n, COUNT) of the node that places (n, 3) of a mesh see in each direction, -1 for none."""
        d = (directions() @ self.rotation.T).astype(np.float32)
        place = ((position - transfer.mesh.center_m) @ self.rotation.T).astype(np.float32)
        down = np.flatnonzero(d[:, 1] < -1e-6)
        scale = np.float32(0.5 * NODES / self.half_m(transfer))
        far = (place[:, 1] + np.float32(self.height_m))[:, None] * scale
        slope = d[down] / -d[down, 1:2]
        i, j = (place[:, a, None] * scale + far * slope[:, a] + np.float32(0.5 * NODES) for a in (0, 2))
        inside = (i >= 0.0) & (i < NODES) & (j >= 0.0) & (j < NODES)
        seen = np.full((len(position), COUNT), -1, np.int16)
        seen[:, down] = np.where(inside, np.where(inside, i, 0.0).astype(np.int16) * NODES
                                 + np.where(inside, j, 0.0).astype(np.int16), -1)  # fmt: skip
        return seen

    def mean_sent(self, transfer: Transfer) -> NDArray[np.float32]:
        """Return the mean radiance (NODES^2, C) that nodes see of a body for that of each of its coarse samples."""
        mesh, nodes = transfer.mesh, self.nodes(transfer)
        d = directions() @ self.rotation.T
        d = d[d[:, 1] > 0.0]
        along = -nodes @ d.T
        off = np.sum(nodes * nodes, axis=-1)[:, None] - along**2
        number, direction = np.nonzero((off < mesh.radius_m**2) & (along > -mesh.radius_m))
        lifted = nodes + np.array([0.0, _LIFT * mesh.radius_m, 0.0])
        origin, rays = (lifted @ self.rotation + mesh.center_m)[number], (d @ self.rotation)[direction]
        triangle = transfer.scene.first_hit(origin, rays)
        hit = np.flatnonzero(triangle >= 0)
        met, _, _ = met_samples(transfer, origin[hit], rays[hit], triangle[hit])
        weight = (SOLID_ANGLE * d[direction[hit], 1]).astype(np.float32)
        down = np.zeros((len(nodes), len(transfer.coarse.sample)), np.float32)
        np.add.at(down, (number[hit], transfer.coarse.of[met]), weight)
        grid = down.reshape(NODES, NODES, -1)
        return _spread_from(grid, grid.sum(axis=-1, keepdims=True)).reshape(NODES**2, -1)


def _spread_from(total: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return means (n, n, c) of a grid of sums and weights; where there is no weight, those of coarser cells."""
    if len(total) == 1:
        return np.asarray(total / np.maximum(weight, 1e-12), np.float32)
    rows = len(total) // 2
    coarse = _spread_from(*(a.reshape(rows, 2, rows, 2, -1).sum(axis=(1, 3)) for a in (total, weight)))
    around = coarse.repeat(2, axis=0).repeat(2, axis=1)
    few = np.float32(_FEW * np.pi)
    return np.asarray((total + few * around) / (weight + few), np.float32)


@functools.cache
def from_coarse() -> NDArray[np.float32]:
    """Return the matrix (NODES^2, COARSE_NODES^2) that interpolates values of coarse nodes, bilinear."""
    at = np.clip((np.arange(NODES) + 0.5) * COARSE_NODES / NODES - 0.5, 0.0, COARSE_NODES - 1.0)
    line = np.maximum(1.0 - np.abs(at[:, None] - np.arange(COARSE_NODES)), 0.0)
    return np.kron(line, line).astype(np.float32)
