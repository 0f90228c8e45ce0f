# SPDX-License-Identifier: Apache-2.0
"""How placed bodies and the ground see each other: a function of where they are alone.

What a body sees of another is kept under their relative pose, and what it sees of the ground under its own turn and
height: where one body moves, what the others see of each other is kept.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.among.body_looks import body_views
from mr360uw.composite.ambient.among.relative_pose import rounded
from mr360uw.composite.ambient.body_view import Body, BodyView
from mr360uw.composite.ambient.mesh_transfer import make_transfer, shape_key
from mr360uw.composite.ambient.on_ground.coarse_nodes import CoarseNodes, Nodes, among_nodes, make_coarse_nodes
from mr360uw.composite.ambient.on_ground.ground_view import COARSE_NODES, NODES, LevelGround
from mr360uw.composite.ambient.on_ground.height_field import HeightField, make_height_field
from mr360uw.composite.ambient.on_ground.node_kernel import between_nodes
from mr360uw.composite.ambient.on_ground.standing import Standing, Swept
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

_KEPT_TRANSFERS, _KEPT_FIELDS, _KEPT_VIEWS = 64, 64, 64


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Bodies of a shot, what each sees, and where its lookouts begin (B + 1,) among all. sites: (all, all) sparse, the
    irradiance that each lookout's radiance adds to each. nodes: places (n, 3) of each body's nodes in the world, none
    where it does not see the ground.
    """

    bodies: tuple[Body, ...]
    views: tuple[BodyView, ...]
    first: NDArray[np.int64]
    sites: Any
    nodes: tuple[Floats, ...]

    @property
    def ground_bodies(self) -> tuple[int, ...]:
        """Numbers of the bodies that the ground sees."""
        return tuple(k for k, body in enumerate(self.bodies) if body.field is not None)

    @property
    def _fields(self) -> tuple[HeightField, ...]:
        return tuple(body.field for body in self.bodies if body.field is not None)

    @property
    def nothing(self) -> bool:
        """Whether nothing is in the way of any light."""
        free = all(view.nothing(body) for body, view in zip(self.bodies, self.views, strict=True))
        return free and not self.ground_bodies

    def standing(self, ground_y: float) -> tuple[Standing, Floats]:
        """Return the bodies that level ground at a height sees, and the point (3,) of the ground below the first of
        them from which their places are.
        """
        bodies = [self.bodies[k] for k in self.ground_bodies]
        point = np.array([bodies[0].origin[0], ground_y, bodies[0].origin[2]]) if bodies else np.zeros(3)
        origin = np.array([rounded(body.origin - point, body.radius) for body in bodies]).reshape(-1, 3)
        return Standing(self._fields, origin), point

    def sweep(self, points: Floats) -> Swept:
        """Return what bodies block at places (n, 3) of the world, as `ground_kernel.gather` takes it."""
        origin = np.array([body.origin for body in self.bodies if body.field is not None]).reshape(-1, 3)
        return Standing(self._fields, origin).sweep(points)

    def coarse_nodes(self, cache: Cache) -> CoarseNodes:
        """Return what bodies block at the coarse nodes of all; kept while all stand as they do to each other."""
        standing, _ = self.standing(0.0)
        seeing = tuple((m, self.bodies[k]) for m, k in enumerate(self.ground_bodies) if len(self.nodes[k]))
        key = (standing.key, tuple((m, body.ground_key) for m, body in seeing))
        places = [Nodes(m, _nodes(body, NODES), _nodes(body, COARSE_NODES)) for m, body in seeing]
        radii = tuple(self.bodies[k].radius for k in self.ground_bodies)
        kept = functools.partial(cache.get, "ambient nodes", keep=_kept(len(self.bodies)))
        return cache.get("ambient coarse nodes", key, lambda: make_coarse_nodes(standing, places, radii, kept), keep=2)

    def at_nodes(self, number: int, values: Floats, points: Floats) -> Floats:
        """Return values (NODES, NODES, c) at a body's nodes at places (n, 3): cubic, those of the edge beyond."""
        out = np.zeros((len(points), values.shape[-1]))
        if len(self.nodes[number]):
            place = among_nodes(self.nodes[number], points)
            between_nodes(np.clip(place, 0.0, NODES - 1.0), np.ascontiguousarray(values, np.float64), out)
        return out

    def sent_down(self, number: int, sent: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean radiance (NODES^2, 3) of what the nodes of a body see of it, spread to all of them.

        sent: (all lookouts, 3) radiance that they send.
        """
        down = self.views[number].down
        if len(down) == 0:
            return np.zeros((NODES**2, 3), np.float32)
        return np.asarray(down @ sent[self.first[number] : self.first[number + 1]])

    def shaded(self, points: Floats, direction: Floats, cache: Cache) -> NDArray[np.bool_]:
        """Return whether a body that casts shadows lies from points (n, 3) of the world towards a direction (3,): kept
        of each body under where the points are in its axes.
        """
        shaded, casting = np.zeros(len(points), np.bool_), [b for b in self.bodies if b.placed.casts_shadow]
        if len(points) == 0 or not casting:
            return shaded
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = np.array([b.radius for b in casting]) + np.sqrt(np.sum((points - middle) ** 2, axis=-1).max())
        way = np.array([b.center for b in casting]) - middle
        ahead = way @ direction
        beside = np.sum(way * way, axis=-1) - ahead**2
        for number in np.flatnonzero((beside < reach**2) & (ahead > -reach)):
            body = casting[number]
            to = body.center - points
            along = to @ direction
            off = np.sum(to * to, axis=-1) - along**2
            near = np.flatnonzero((off < body.radius**2) & (along > -body.radius))
            if len(near) == 0:
                continue
            local, ray = body.inside(points[near]), rounded(direction @ body.rotation)
            make = functools.partial(_occluded, body, local, ray)
            key = (body.transfer.lattice, local.tobytes(), ray.tobytes())
            shaded[near] |= cache.get("ambient sun", key, make, keep=_kept(len(self.bodies)))
        return shaded


def _kept(bodies: int) -> int:
    """Return how many values of pairs of bodies are kept: those of two frames."""
    return max(_KEPT_VIEWS, 4 * bodies * bodies)


def _occluded(body: Body, points: Floats, direction: Floats) -> NDArray[np.bool_]:
    return body.transfer.scene.occluded(points, np.broadcast_to(direction, points.shape))


def make_layout(
    objects: Sequence[PlacedObject], ground_y: Sequence[float | None], seen_by_ground: bool, cache: Cache
) -> Layout:
    """Return the layout of objects. ground_y: height of the ground below each, or None. cache: keeps what is found."""
    from scipy.sparse import block_diag, vstack

    bodies = tuple(_body(placed, y, seen_by_ground, cache) for placed, y in zip(objects, ground_y, strict=True))
    first = np.concatenate([[0], np.cumsum([len(body.transfer.lookouts.site) for body in bodies])]).astype(np.int64)
    views = body_views(bodies, first, cache, _kept(len(bodies)))
    own = block_diag([body.own.sites[body.transfer.lookouts.site] for body in bodies], format="csr")
    sites = vstack([view.lookouts.sites for view in views], format="csr") + own
    nodes = tuple(_nodes(body, NODES) + body.origin for body in bodies)
    return Layout(bodies, views, first, sites, nodes)


def _nodes(body: Body, side: int) -> Floats:
    """Return the places (side^2, 3) of a body's nodes from its origin, none where it does not see the ground."""
    if body.ground is None or not body.on_ground:
        return np.zeros((0, 3))
    placed, center = body.placed, body.transfer.mesh.center_m
    return placed.world_from_object[:3, :3] @ center + body.ground.nodes(body.transfer, side) * placed.scale


def _body(placed: PlacedObject, ground_y: float | None, seen_by_ground: bool, cache: Cache) -> Body:
    # poses share what is found at rest: rays for each of them would cost seconds a frame
    mesh, linear, shadow = placed.mesh.still, placed.world_from_object[:3, :3], placed.casts_shadow
    bare = cache.get("ambient shape", shape_key(mesh), lambda: make_transfer(mesh), keep=_KEPT_TRANSFERS)
    transfer = cache.get("ambient transfer", (mesh, bare), lambda: bare.painted(mesh), keep=_KEPT_TRANSFERS)
    shape = transfer.lattice
    own = cache.get("ambient own", (shape, shadow), lambda: transfer.own_view(shadow), keep=_KEPT_TRANSFERS)
    field, ground = None, None
    if seen_by_ground and shadow and len(transfer.solid):
        key = (shape, linear.tobytes())
        field = cache.get("height field", key, lambda: make_height_field(transfer, linear), keep=_KEPT_FIELDS)
    rotation, center = linear / placed.scale, placed.to_world(mesh.center_m)
    if ground_y is not None:
        height = rounded((center[1] - ground_y) / placed.scale, mesh.radius_m)
        ground = LevelGround(rounded(rotation), float(height))
    return Body(placed, transfer, own, rotation, field, ground, center, mesh.radius_m * placed.scale)
