# SPDX-License-Identifier: Apache-2.0
"""Height of the receiver below bodies: near a body the ground is taken as level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.receiver.plate_distance import kept_shape
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.rays import RayScene, barycentric


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
