# SPDX-License-Identifier: Apache-2.0
"""Where bodies are over the ground, and how all of these see each other: functions of where they are alone.

What a body sees of another is kept under their relative pose, and what it sees of the ground under its own turn and
height: where one body moves, what the others see of each other is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.blocked_light import BlockedLight, Occluders
from mr360uw.composite.ambient.body import COARSE_NODES, NODES, Body, rounded
from mr360uw.composite.ambient.far_bodies import FarBodies, far_bodies, near_shares
from mr360uw.composite.ambient.form_factors import BodyView, body_views
from mr360uw.composite.ambient.mesh_transfer import shape_of, shape_transfer
from mr360uw.composite.shot import PlacedObject
from mr360uw.jit import fast
from mr360uw.types import Floats


@fast
def between_nodes(place: Any, values: Any, out: Any) -> None:
    """Set `out` (n, c) to values (k, k, c) of a grid of nodes at places (n, 2), 0 to k - 1.

    A cubic spline through the nodes whose slopes there are half the differences of their neighbours: light has no bends
    along lines of nodes. It is cut to the range of the four nodes around.
    """
    last = values.shape[0] - 1
    weight, index = np.zeros((2, 4)), np.zeros((2, 4), np.int64)
    for n in range(len(place)):
        for axis in range(2):
            i = min(int(place[n, axis]), last - 1)
            t = place[n, axis] - i
            weight[axis, 0] = 0.5 * t * (t * (2.0 - t) - 1.0)
            weight[axis, 1] = 0.5 * (t * t * (3.0 * t - 5.0) + 2.0)
            weight[axis, 2] = 0.5 * t * (t * (4.0 - 3.0 * t) + 1.0)
            weight[axis, 3] = 0.5 * t * t * (t - 1.0)
            for k in range(4):
                index[axis, k] = min(max(i + k - 1, 0), last)
        for c in range(out.shape[1]):
            total, least, most = 0.0, 1e30, -1e30
            for k in range(4):
                for m in range(4):
                    value = values[index[0, k], index[1, m], c]
                    total += weight[0, k] * weight[1, m] * value
                    if 0 < k < 3 and 0 < m < 3:
                        least, most = min(least, value), max(most, value)
            out[n, c] = min(max(total, least), most)


_KEPT = 64
"""Least number of meshes and of turned meshes of which it is kept what they see and show."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Bodies of a shot where they are, and what the ground sees of them.

    nodes: places (n, 3) of each body's nodes in the world, none where it does not see the ground.
    """

    bodies: tuple[Body, ...]
    nodes: tuple[Floats, ...]

    @property
    def ground_bodies(self) -> tuple[int, ...]:
        """Numbers of the bodies that the ground sees."""
        return tuple(k for k, body in enumerate(self.bodies) if body.shades)

    @property
    def occluders(self) -> Occluders:
        """Bodies that the ground sees."""
        bodies = [self.bodies[k] for k in self.ground_bodies]
        return Occluders(tuple(body.field for body in bodies), np.array([b.origin for b in bodies]).reshape(-1, 3))

    def occluders_from(self, point: Floats) -> Occluders:
        """Return the bodies that the ground sees with their places from a point (3,): the same where all move along."""
        bodies = [self.bodies[k] for k in self.ground_bodies]
        origin = [rounded(body.origin - point, body.radius) for body in bodies]
        return Occluders(tuple(body.field for body in bodies), np.array(origin).reshape(-1, 3))

    def below(self, ground_y: float) -> Floats:
        """Return the point (3,) of level ground below the first body that it sees."""
        first = self.bodies[self.ground_bodies[0]].origin if self.ground_bodies else np.zeros(3)
        return np.array([first[0], ground_y, first[2]])

    def bounced(self, blocked: BlockedLight, points: Floats, sent: Sequence[Floats]) -> Floats:
        """Return the irradiance (n, 3) that bodies send to places (n, 3) of the ground, where they block `blocked`.

        sent: mean radiance (NODES, NODES, 3) of each body that the ground sees, at its nodes.
        """
        total = np.zeros((len(points), 3))
        for k, radiance, share in zip(self.ground_bodies, sent, blocked.share, strict=True):
            some = np.flatnonzero(share)
            total[some] += np.pi * share[some, None] * self.at_nodes(k, radiance, points[some])
        return total

    def at_nodes(self, number: int, values: Floats, points: Floats) -> Floats:
        """Return values (NODES, NODES, c) at a body's nodes at places (n, 3): cubic, those of the edge beyond."""
        out = np.zeros((len(points), values.shape[-1]))
        if len(self.nodes[number]):
            low, high = self.nodes[number][[0, -1]]
            place = (points - low)[:, [0, 2]] / (high - low)[[0, 2]] * (NODES - 1)
            between_nodes(np.clip(place, 0.0, NODES - 1.0), np.ascontiguousarray(values, np.float64), out)
        return out

    def lit(self, points: Sequence[Floats], direction: Floats) -> list[Floats]:
        """Return for groups of points (n, 3) of the world the fraction of the light from a direction (3,) that bodies
        which cast shadows leave.
        """
        lit: list[Floats] = [np.ones(len(group)) for group in points]
        casting, some = [b for b in self.bodies if b.placed.casts_shadow], [k for k, of in enumerate(points) if len(of)]
        if not some or not casting:
            return lit
        low, high = (np.array([at(points[k], axis=0) for k in some]) for at in (np.min, np.max))
        reach = 0.5 * np.linalg.norm(high - low, axis=-1)[:, None] + np.array([b.radius for b in casting])
        way = np.array([b.center for b in casting]) - 0.5 * (low + high)[:, None]
        ahead = way @ direction
        beside = np.sum(way * way, axis=-1) - ahead**2
        for row, number in zip(*np.nonzero((beside < reach**2) & (ahead > -reach)), strict=True):
            body, group = casting[number], some[row]
            to = body.center - points[group]
            along = to @ direction
            off = np.sum(to * to, axis=-1) - along**2
            near = np.flatnonzero((off < body.radius**2) & (along > -body.radius))
            if len(near):
                ray = np.broadcast_to(direction @ body.rotation, (len(near), 3))
                lit[group][near] *= body.transfer.blocking.passed(body.inside(points[group][near]), ray)
        return lit


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """What the bodies of a layout and the ground see of each other.

    views: of near bodies and the ground, far: of the others. first: (B + 1,) where the coarse samples of each body
    begin among all. samples: (all, all) sparse, the irradiance that each coarse sample's radiance adds to each. coarse,
    blocked: coarse nodes (n, 3) of all bodies in turn, and what bodies block there.
    """

    layout: Layout
    views: tuple[BodyView, ...]
    far: FarBodies
    first: NDArray[np.int64]
    samples: Any
    coarse: Floats
    blocked: BlockedLight

    def untouched(self, number: int) -> bool:
        """Return whether nothing is in the way of a body's light."""
        return not self.far.around(number) and self.views[number].nothing(self.layout.bodies[number])

    @property
    def nothing(self) -> bool:
        """Whether nothing is in the way of any light."""
        return not self.layout.ground_bodies and all(map(self.untouched, range(len(self.views))))

    def sent_down(self, sent: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """Return for each body that the ground sees the mean radiance (NODES, NODES, 3) of what its nodes see of it.

        sent: (all coarse samples, 3) radiance that they send.
        """
        found = []
        for k in self.layout.ground_bodies:
            down = self.views[k].down
            seen = down @ sent[self.first[k] : self.first[k + 1]] if len(down) else np.zeros((NODES**2, 3), np.float32)
            found.append(np.asarray(seen).reshape(NODES, NODES, 3))
        return tuple(found)

    def sent_sides(self, sent: NDArray[np.float32]) -> Floats:
        """Return the mean radiance (B, 6, 3) of the sides of all bodies. sent: (all coarse samples, 3)."""
        ends = zip(self.layout.bodies, self.first[:-1], self.first[1:], strict=True)
        return np.array([body.transfer.sides @ sent[begin:end] for body, begin, end in ends])


def make_layout(
    objects: Sequence[PlacedObject], ground_y: Sequence[float | None], seen_by_ground: bool, cache: Cache
) -> Layout:
    """Return the layout of objects. ground_y: height of the ground below each, or None. cache: keeps what is found."""
    keep = max(_KEPT, 2 * len(objects))
    bodies = tuple(_body(placed, y, seen_by_ground, cache, keep) for placed, y in zip(objects, ground_y, strict=True))
    return Layout(bodies, tuple(_nodes(body, NODES) + body.origin for body in bodies))


def make_exchange(layout: Layout, cache: Cache) -> Exchange:
    """Return what the bodies of a layout and the ground see of each other. cache: keeps what is found."""
    from scipy.sparse import block_diag, vstack

    bodies = layout.bodies
    first = np.concatenate([[0], np.cumsum([len(body.transfer.coarse.sample) for body in bodies])]).astype(np.int64)
    near, far = near_shares(bodies)
    views = body_views(bodies, first, near, cache)
    own = block_diag([body.own.samples[body.transfer.coarse.sample] for body in bodies], format="csr")
    samples = vstack([view.coarse.samples for view in views], format="csr") + own
    places = np.concatenate([_nodes(body, COARSE_NODES) + body.origin for body in bodies])
    blocked = layout.occluders.blocked(places, np.tile([0.0, 1.0, 0.0], (len(places), 1)))
    return Exchange(layout, views, far_bodies(bodies, far), first, samples, places, blocked)


def _nodes(body: Body, side: int) -> Floats:
    """Return the places (side^2, 3) of a body's nodes from its origin, none where it does not see the ground."""
    placed = body.placed
    return placed.world_from_object[:3, :3] @ body.transfer.mesh.center_m + body.nodes(side) * placed.scale


def _body(placed: PlacedObject, ground_y: float | None, seen_by_ground: bool, cache: Cache, keep: int) -> Body:
    # poses share what is found at rest: rays for each of them would cost seconds a frame
    mesh, linear, shadow = placed.mesh.still, placed.world_from_object[:3, :3], placed.casts_shadow
    bare = cache.of(shape_transfer, shape_of(mesh), keep=keep)
    transfer = cache.of(bare.painted, mesh, keep=keep)
    own = cache.of(bare.own_view, shadow, keep=keep)
    rotation, center, height_m = rounded(linear / placed.scale), placed.to_world(mesh.center_m), None
    if ground_y is not None:
        height_m = float(rounded((center[1] - ground_y) / placed.scale, mesh.radius_m))
    shades = seen_by_ground and shadow and transfer.opacity > 0.0
    radius = mesh.radius_m * placed.scale
    return Body(placed, transfer, own, rotation, shades, height_m, center, radius, cache, keep)
