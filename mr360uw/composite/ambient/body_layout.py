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
from mr360uw.composite.ambient.body_view import Body, BodyView, outlook
from mr360uw.composite.ambient.lobe_occlusion import met_by
from mr360uw.composite.ambient.mesh_transfer import Transfer, make_transfer
from mr360uw.composite.ambient.on_ground.ground_view import COARSE_NODES, NODES, Ground
from mr360uw.composite.ambient.on_ground.height_field import make_height_field
from mr360uw.composite.ambient.on_ground.height_sweep import AZIMUTHS, sweep
from mr360uw.composite.ambient.on_ground.node_kernel import between_nodes
from mr360uw.composite.ambient.pair_view import near_sites, pair_view, share_shown
from mr360uw.composite.ambient.relative_pose import RelativePose, relative_pose, rounded
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

_KEPT_TRANSFERS, _KEPT_FIELDS, _KEPT_VIEWS = 64, 64, 64
Swept = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Bodies of a shot, what each sees, and where its lookouts begin (B + 1,) among all. sites: (all, all) sparse, the
    irradiance that each lookout's radiance adds to each. nodes, coarse_nodes: places (n, 3) of each body's nodes in the
    world, none where it does not see the ground.
    """

    bodies: tuple[Body, ...]
    views: tuple[BodyView, ...]
    first: NDArray[np.int64]
    sites: Any
    nodes: tuple[Floats, ...]
    coarse_nodes: tuple[Floats, ...]

    @property
    def ground_bodies(self) -> tuple[int, ...]:
        """Numbers of the bodies that the ground sees."""
        return tuple(k for k, body in enumerate(self.bodies) if body.field is not None)

    @property
    def nothing(self) -> bool:
        """Whether nothing is in the way of any light."""
        free = all(view.nothing(body) for body, view in zip(self.bodies, self.views, strict=True))
        return free and not self.ground_bodies

    def sweep(self, points: Floats) -> Swept:
        """Return what bodies block at places (n, 3) of the world, as `ground_kernel.gather` takes it."""
        places = np.ascontiguousarray(points, np.float64)
        begins, blocked = self._empty(len(places))
        for m, k in enumerate(self.ground_bodies):
            _sweep(self.bodies[k], places, self.bodies[k].origin, begins[m], blocked[m])
        return begins, blocked

    def at_coarse_nodes(self, number: int, cache: Cache) -> tuple[Swept, NDArray[np.float32]]:
        """Return what bodies block at coarse nodes of a body, as `sweep` does, kept of each for its place; and matrices
        (ground bodies, coarse nodes, nodes) that give there the values of the nodes of each body, bilinear.
        """
        points = self.coarse_nodes[number]
        begins, blocked = self._empty(len(points))
        for m, k in enumerate(self.ground_bodies):
            body = self.bodies[k]
            assert body.field is not None
            places = rounded(points - body.origin, body.radius)
            make = functools.partial(_swept, body, places)
            key = (body.field, places.tobytes())
            begins[m], blocked[m] = cache.get("ambient nodes", key, make, keep=_kept(len(self.bodies)))
        return (begins, blocked), self._from_nodes(points)

    def _empty(self, points: int) -> Swept:
        count = len(self.ground_bodies)
        return np.zeros((count, points, 3), np.float32), np.zeros((count, points, AZIMUTHS, 5), np.float32)

    def at_nodes(self, number: int, values: Floats, points: Floats) -> Floats:
        """Return values (NODES, NODES, c) at a body's nodes at places (n, 3): cubic, those of the edge beyond."""
        out = np.zeros((len(points), values.shape[-1]))
        if len(self.nodes[number]):
            place = self._among_nodes(number, points)
            between_nodes(np.clip(place, 0.0, NODES - 1.0), np.ascontiguousarray(values, np.float64), out)
        return out

    def _from_nodes(self, points: Floats) -> NDArray[np.float32]:
        matrices = np.zeros((len(self.ground_bodies), len(points), NODES**2), np.float32)
        for matrix, k in zip(matrices, self.ground_bodies, strict=True):
            if len(self.nodes[k]):
                place = np.clip(self._among_nodes(k, points), 0.0, NODES - 1.001)
                (i, j), (u, v) = place.astype(np.int64).T, (place - np.floor(place)).T
                row, node = np.arange(len(points)), i * NODES + j
                matrix[row, node], matrix[row, node + 1] = (1.0 - u) * (1.0 - v), (1.0 - u) * v
                matrix[row, node + NODES], matrix[row, node + NODES + 1] = u * (1.0 - v), u * v
        return matrices

    def _among_nodes(self, number: int, points: Floats) -> Floats:
        """Return where points (n, 3) of the world lie among a body's nodes (n, 2), counted along both sides."""
        low, high = self.nodes[number][[0, -1]]
        return np.asarray((points - low)[:, [0, 2]] / (high - low)[[0, 2]] * (NODES - 1))

    def shaded(self, points: Floats, direction: Floats, cache: Cache) -> NDArray[np.bool_]:
        """Return whether a body that casts shadows lies from points (n, 3) of the world towards a direction (3,): kept
        of each body under where the points are in its axes.
        """
        shaded = np.zeros(len(points), np.bool_)
        for body in self.bodies:
            if not body.placed.casts_shadow:
                continue
            to = body.center - points
            along = to @ direction
            off = np.sum(to * to, axis=-1) - along**2
            near = np.flatnonzero((off < body.radius**2) & (along > -body.radius))
            if len(near) == 0:
                continue
            local, ray = body.inside(points[near]), rounded(direction @ body.rotation)
            make = functools.partial(_occluded, body, local, ray)
            key = (body.transfer.mesh, local.tobytes(), ray.tobytes())
            shaded[near] |= cache.get("ambient sun", key, make, keep=_kept(len(self.bodies)))
        return shaded


def _kept(bodies: int) -> int:
    """Return how many values of pairs of bodies are kept: those of two frames."""
    return max(_KEPT_VIEWS, 4 * bodies * bodies)


def _sweep(body: Body, places: Floats, origin: Floats, begins: Any, blocked: Any) -> None:
    field = body.field
    assert field is not None, "the ground sees it"
    sweep(places, origin, field.frame, field.outline, field.squares, begins, blocked)


def _swept(body: Body, places: Floats) -> Swept:
    begins, blocked = np.zeros((len(places), 3), np.float32), np.zeros((len(places), AZIMUTHS, 5), np.float32)
    _sweep(body, places, np.zeros(3), begins, blocked)
    return begins, blocked


def _occluded(body: Body, points: Floats, direction: Floats) -> NDArray[np.bool_]:
    return body.transfer.scene.occluded(points, np.broadcast_to(direction, points.shape))


def make_layout(
    objects: Sequence[PlacedObject], ground_y: Sequence[float | None], seen_by_ground: bool, cache: Cache
) -> Layout:
    """Return the layout of objects. ground_y: height of the ground below each, or None. cache: keeps what is found."""
    from scipy.sparse import block_diag, vstack

    bodies = tuple(_body(placed, y, seen_by_ground, cache) for placed, y in zip(objects, ground_y, strict=True))
    first = np.concatenate([[0], np.cumsum([len(body.transfer.lookouts.site) for body in bodies])]).astype(np.int64)
    views = tuple(_view(k, bodies, first, cache) for k in range(len(bodies)))
    own = block_diag([body.own.sites[body.transfer.lookouts.site] for body in bodies], format="csr")
    sites = vstack([view.lookouts.sites for view in views], format="csr") + own
    nodes = (tuple(_nodes(body, side) for body in bodies) for side in (NODES, COARSE_NODES))
    return Layout(bodies, views, first, sites, *nodes)


def _nodes(body: Body, side: int) -> Floats:
    """Return the places (side^2, 3) of a body's nodes in the world, none where it does not see the ground."""
    if body.ground is None or not body.on_ground:
        return np.zeros((0, 3))
    return body.center + body.ground.nodes(body.transfer, side) * body.placed.scale


def _body(placed: PlacedObject, ground_y: float | None, seen_by_ground: bool, cache: Cache) -> Body:
    # poses share what is found at rest: rays for each of them would cost seconds a frame
    mesh, linear, shadow = placed.mesh.still, placed.world_from_object[:3, :3], placed.casts_shadow
    transfer = cache.get("ambient transfer", mesh, lambda: make_transfer(mesh), keep=_KEPT_TRANSFERS)
    own = cache.get("ambient own", (mesh, shadow), lambda: transfer.own_view(shadow), keep=_KEPT_TRANSFERS)
    field, ground = None, None
    if seen_by_ground and shadow and len(transfer.solid):
        key = (mesh, linear.tobytes())
        field = cache.get("height field", key, lambda: make_height_field(transfer, linear), keep=_KEPT_FIELDS)
    rotation, center = linear / placed.scale, placed.to_world(mesh.center_m)
    if ground_y is not None:
        height = rounded((center[1] - ground_y) / placed.scale, mesh.radius_m)
        ground = Ground(rounded(rotation), float(height))
    return Body(placed, transfer, own, rotation, field, ground, center, mesh.radius_m * placed.scale)


def _view(number: int, bodies: tuple[Body, ...], first: NDArray[np.int64], cache: Cache) -> BodyView:
    """Return what one of several bodies sees. first: where the lookouts of each begin."""
    body, total, keep = bodies[number], int(first[-1]), _kept(len(bodies))
    others = [
        (int(first[k]), other.transfer, _pose(body, other))
        for k, other in enumerate(bodies)
        if k != number and other.placed.casts_shadow
    ]
    shown = [(begin, other, pose) for begin, other, pose in others if share_shown(body.transfer, other, pose) > 0.0]
    of = tuple((begin, other.mesh, pose.key) for begin, other, pose in shown)
    key = (body.transfer.mesh, body.placed.casts_shadow, body.on_ground, body.ground_key, of, total, first[number])
    make = functools.partial(_look, body, int(first[number]), shown, total, functools.partial(cache.get, keep=keep))
    return cache.get("ambient view", key, make, keep=keep)


def _pose(body: Body, other: Body) -> RelativePose:
    inverse = np.linalg.inv(body.placed.world_from_object)
    least = min(body.radius, other.radius) / body.placed.scale
    return relative_pose(inverse, other.placed.world_from_object, other.placed.scale / body.placed.scale, least)


def _look(body: Body, begin: int, others: list[tuple[int, Transfer, RelativePose]], total: int, kept: Any) -> BodyView:
    """Return what a body sees. begin: where its lookouts begin among all, `total`; others: the same of each other, and
    its pose. kept: gets a value from the cache.
    """
    transfer, mesh = body.transfer, body.transfer.mesh
    part = np.zeros(len(transfer.cosine))
    for _, other, pose in others:
        part = np.maximum(part, near_sites(transfer, other, pose))
    if mesh.glossy:
        part[:] = 1.0  # every site has a lobe of its own
    near, looks = np.flatnonzero(part), []
    near_cosine = np.where(body.own.open[near], transfer.cosine[near], np.float32(0.0))
    for site, cosine in ((transfer.lookouts.site, body.own.direct), (near, near_cosine)):
        place, pairs, node = body.places(site), [], None
        for first, other, pose in others:
            key = (mesh, other.mesh, pose.key, body.placed.casts_shadow, site.tobytes(), body.sunk_key)
            make = functools.partial(pair_view, transfer, place, cosine > 0.0, other, pose)
            pairs.append((kept("ambient pair", key, make), first))
        if body.ground is not None and body.on_ground:
            make_seen = functools.partial(body.ground.node_seen, transfer, place)
            node = kept("ambient nodes seen", (mesh, body.ground_key, site.tobytes()), make_seen)
        looks.append(outlook(cosine, node, pairs, total))
    down = np.zeros((0, len(transfer.lookouts.site)), np.float32)
    if body.ground is not None and body.on_ground:
        down = kept("ambient down", (mesh, body.ground_key), functools.partial(body.ground.mean_sent, transfer))
    lost = body.own.plain - body.own.direct + looks[0].lost
    openness = 1.0 - lost.sum(axis=1, keepdims=True) / transfer.whole[transfer.lookouts.site, None]
    met = met_by(body, looks[1], near_cosine, node, begin) if mesh.glossy else None
    return BodyView(looks[0], looks[1], near, part[near, None].astype(np.float32), down, openness, met)
