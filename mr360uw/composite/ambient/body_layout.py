# SPDX-License-Identifier: Apache-2.0
"""How placed bodies and the ground see each other: a function of where they are alone, kept while they stand still."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body_view import NODES, Body, BodyView, body_view
from mr360uw.composite.ambient.height_field import make_height_field
from mr360uw.composite.ambient.height_sweep import AZIMUTHS, sweep
from mr360uw.composite.ambient.mesh_transfer import make_transfer
from mr360uw.composite.ambient.node_kernel import between_nodes
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

_KEPT_TRANSFERS, _KEPT_FIELDS = 64, 64


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Bodies of a shot, what each sees, and where its sites begin (B + 1,) among all."""

    bodies: tuple[Body, ...]
    views: tuple[BodyView, ...]
    first: NDArray[np.int64]

    @property
    def ground_bodies(self) -> tuple[int, ...]:
        """Numbers of the bodies that the ground sees."""
        return tuple(k for k, body in enumerate(self.bodies) if body.field is not None)

    def sweep(self, points: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return what bodies block at places (n, 3) of the world, as `ground_kernel.gather` takes it."""
        places = np.ascontiguousarray(points, np.float64)
        count = len(self.ground_bodies)
        begins = np.zeros((count, len(places), 3), np.float32)
        blocked = np.zeros((count, len(places), AZIMUTHS, 5), np.float32)
        for m, k in enumerate(self.ground_bodies):
            body = self.bodies[k]
            field = body.field
            assert field is not None
            sweep(places, body.origin, field.frame, field.outline, field.squares, begins[m], blocked[m])
        return begins, blocked

    def at_nodes(self, number: int, values: Floats, points: Floats) -> Floats:
        """Return values (NODES, NODES, c) at a body's nodes at places (n, 3): cubic, those of the edge beyond."""
        out = np.zeros((len(points), values.shape[-1]))
        node = self.views[number].node
        if len(node):
            place = (points - node[0])[:, [0, 2]] / (node[-1] - node[0])[[0, 2]] * (NODES - 1)
            between_nodes(np.clip(place, 0.0, NODES - 1.0), np.ascontiguousarray(values, np.float64), out)
        return out

    def shaded(self, points: Floats, direction: Floats) -> NDArray[np.bool_]:
        """Return whether a body that casts shadows lies from points (n, 3) of the world towards a direction (3,)."""
        shaded = np.zeros(len(points), np.bool_)
        for body in self.bodies:
            if not body.placed.casts_shadow:
                continue
            to = body.center - points
            along = to @ direction
            off = np.linalg.norm(to - along[:, None] * direction, axis=-1)
            near = np.flatnonzero(~shaded & (off < body.radius) & (along > -body.radius))
            rays = np.broadcast_to(direction @ body.rotation, (len(near), 3))
            shaded[near] = body.transfer.scene.occluded(body.inside(points[near]), rays)
        return shaded


def make_layout(
    objects: Sequence[PlacedObject], ground_y: Sequence[float | None], seen_by_ground: bool, cache: Cache
) -> Layout:
    """Return the layout of objects. ground_y: height of the ground below each, or None. cache: keeps transfers."""
    bodies = tuple(_body(placed, seen_by_ground, cache) for placed in objects)
    first = np.concatenate([[0], np.cumsum([len(body.transfer.cosine) for body in bodies])]).astype(np.int64)
    views = tuple(body_view(k, bodies, first, ground_y[k]) for k in range(len(bodies)))
    return Layout(bodies, views, first)


def _body(placed: PlacedObject, seen_by_ground: bool, cache: Cache) -> Body:
    # poses share what is found at rest: rays for each of them would cost seconds a frame
    mesh, linear = placed.mesh.still, placed.world_from_object[:3, :3]
    transfer = cache.get("ambient transfer", mesh, lambda: make_transfer(mesh), keep=_KEPT_TRANSFERS)
    field = None
    if seen_by_ground and placed.casts_shadow and len(transfer.solid):
        key = (mesh, linear.tobytes())
        field = cache.get("height field", key, lambda: make_height_field(transfer, linear), keep=_KEPT_FIELDS)
    shape = placed.mesh
    return Body(
        placed, transfer, linear / placed.scale, field, placed.to_world(shape.center_m), shape.radius_m * placed.scale
    )
