# SPDX-License-Identifier: Apache-2.0
"""Bodies where they are over the ground, and the level ground below each as its sample points see it.

Near a body the ground is taken as level, at the height of the receiver below it: what the body sees of it depends on
the body's turn and height alone. Poses are rounded far below what shows, and what is found from a rounded pose is kept
under it: the same pose gives the same result to the last bit wherever in a clip it occurs.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.blocked_light import BlockedLight, Occluders
from mr360uw.composite.ambient.height_field import HeightField, make_height_field
from mr360uw.composite.ambient.mesh_transfer import (
    COUNT,
    SOLID_ANGLE,
    OwnView,
    Transfer,
    directions,
    shape_of,
    shape_transfer,
)
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

BITS = 20
"""Places are rounded to 2^-20 of the smaller body's radius, turns to as much of a radian."""
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
_KEPT = 64
"""Least number of meshes and of turned meshes of which it is kept what they see and show."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A placed mesh. own: what it does to its own light. rotation: (3, 3) its axes to the world's, rounded. shades:
    whether it blocks light of the ground. height_m: of its middle above the ground, in the mesh's metres and rounded;
    None without ground. center (3,), radius: of a ball around it at rest, in the world [m]. cache: keeps its field, as
    many as `keep`; it keeps the body too, which does not hold it.
    """

    placed: PlacedObject
    transfer: Transfer
    own: OwnView
    rotation: Floats
    shades: bool
    height_m: float | None
    center: Floats
    radius: float
    cache: weakref.ref[Cache]
    keep: int

    @property
    def field(self) -> HeightField:
        """What the ground sees of the body; found when it is asked for."""
        inputs = self.transfer, self.placed.world_from_object[:3, :3]
        cache = self.cache()
        return make_height_field(*inputs) if cache is None else cache.of(make_height_field, *inputs, keep=self.keep)

    @property
    def origin(self) -> Floats:
        """Place (3,) of the body's origin in the world."""
        return self.placed.world_from_object[:3, 3]

    def inside(self, points: Floats) -> Floats:
        """Return points (n, 3) of the world in the body's axes, rounded: what is found there may be kept under them."""
        local = (points - self.origin) @ self.rotation / self.placed.scale
        return rounded(local, self.transfer.mesh.radius_m)

    @property
    def on_ground(self) -> bool:
        """Whether body and ground see each other: the ground is so near that its shade matters to the body."""
        radius = self.transfer.mesh.radius_m
        if not self.shades or self.height_m is None:
            return False
        return -radius < self.height_m < (1.0 + _NEAR_GROUND) * radius

    @property
    def ground_key(self) -> bytes:
        """Equal for equal ground where it matters to what the body sees, nothing where it does not."""
        if self.height_m is None or not (self.on_ground or self._covered()):
            return b""
        return self.rotation.tobytes() + np.float64(self.height_m).tobytes()

    def _covered(self) -> bool:
        """Return whether a sample lies below the ground, or nearly."""
        if self.height_m is None or not self._at_ground():
            return False
        above = (self.transfer.lattice.position - self.transfer.mesh.center_m) @ self.rotation[1]
        return bool(above.min() < _LIFT * self.transfer.mesh.radius_m - self.height_m)

    def _at_ground(self) -> bool:
        """Return whether a sample, all of which lie hardly outside the body's ball, can be near the ground."""
        return self.height_m is not None and self.height_m <= 1.01 * self.transfer.mesh.radius_m

    def places(self, sample: NDArray[np.int64]) -> Floats:
        """Return where rays from samples (n,) start (n, 3) in the body's axes: those below the ground just above it."""
        position = self.transfer.lattice.position[sample]
        if self.height_m is None or not self._at_ground():
            return position
        up, least = self.rotation[1], _LIFT * self.transfer.mesh.radius_m - self.height_m
        below = np.maximum(least - (position - self.transfer.mesh.center_m) @ up, 0.0)
        return np.asarray(position + below[:, None] * up)

    def nodes(self, side: int = NODES) -> Floats:
        """Return the places (side^2, 3) of nodes of the ground from the body's middle, in axes of the world and the
        metres of the mesh; none where body and ground do not see each other.
        """
        if self.height_m is None or not self.on_ground:
            return np.zeros((0, 3))
        line = ((np.arange(side) + 0.5) / side * 2.0 - 1.0) * self._half_m
        x, z = np.meshgrid(line, line, indexing="ij")
        return np.stack([x, np.full_like(x, -self.height_m), z], axis=-1).reshape(-1, 3)

    def world_nodes(self, side: int) -> Floats:
        """Return the places (side^2, 3) of the nodes in the world, none where body and ground do not see each other."""
        middle = self.placed.world_from_object[:3, :3] @ self.transfer.mesh.center_m
        return middle + self.nodes(side) * self.placed.scale + self.origin

    @property
    def _half_m(self) -> float:
        """Half the side of the square of nodes, in the mesh's metres."""
        radius = self.transfer.mesh.radius_m
        return _NODE_REACH * radius + _REACH_WITH_HEIGHT * max((self.height_m or 0.0) - radius, 0.0)

    def node_seen(self, position: Floats) -> NDArray[np.int16] | None:
        """Return the number (n, COUNT) of the node that places (n, 3) of the body see in each direction, -1 for none;
        None where there are no nodes.
        """
        if self.height_m is None or not self.on_ground:
            return None
        d = (directions() @ self.rotation.T).astype(np.float32)
        place = ((position - self.transfer.mesh.center_m) @ self.rotation.T).astype(np.float32)
        down = np.flatnonzero(d[:, 1] < -1e-6)
        scale = np.float32(0.5 * NODES / self._half_m)
        far = (place[:, 1] + np.float32(self.height_m))[:, None] * scale
        slope = d[down] / -d[down, 1:2]
        i, j = (place[:, a, None] * scale + far * slope[:, a] + np.float32(0.5 * NODES) for a in (0, 2))
        inside = (i >= 0.0) & (i < NODES) & (j >= 0.0) & (j < NODES)
        seen = np.full((len(position), COUNT), -1, np.int16)
        seen[:, down] = np.where(inside, np.where(inside, i, 0.0).astype(np.int16) * NODES
                                 + np.where(inside, j, 0.0).astype(np.int16), -1)  # fmt: skip
        return seen

    def mean_sent(self) -> NDArray[np.float32]:
        """Return the matrix (nodes, C) that maps the radiance of the body's coarse samples to the mean radiance that
        nodes of the ground see of it; (0, C) without nodes.
        """
        transfer, nodes = self.transfer, self.nodes()
        mesh = transfer.mesh
        if len(nodes) == 0:
            return np.zeros((0, len(transfer.coarse.sample)), np.float32)
        d = directions() @ self.rotation.T
        d = d[d[:, 1] > 0.0]
        along = -nodes @ d.T
        off = np.sum(nodes * nodes, axis=-1)[:, None] - along**2
        number, direction = np.nonzero((off < mesh.radius_m**2) & (along > -mesh.radius_m))
        lifted = nodes + np.array([0.0, _LIFT * mesh.radius_m, 0.0])
        origin, rays = (lifted @ self.rotation + mesh.center_m)[number], (d @ self.rotation)[direction]
        met = transfer.blocking.met(transfer.lattice, origin, rays)
        weight = (SOLID_ANGLE * d[direction[met.ray], 1]).astype(np.float32) * met.part
        down = np.zeros((len(nodes), len(transfer.coarse.sample)), np.float32)
        np.add.at(down, (number[met.ray], transfer.coarse.of[met.sample]), weight)
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


def rounded(values: Floats, unit: float = 1.0) -> Floats:
    """Return values of the order of `unit` rounded as poses are."""
    step = float(np.exp2(np.rint(np.log2(unit)) - BITS))
    return np.rint(np.asarray(values) / step) * step + 0.0


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
        """Return values (NODES, NODES, c) at a body's nodes at places (n, 3): a cubic spline within their range, as
        light has no bends along lines of nodes; those of the edge beyond.
        """
        from scipy.ndimage import map_coordinates

        out = np.zeros((len(points), values.shape[-1]))
        if len(self.nodes[number]):
            low, high = self.nodes[number][[0, -1]][:, [0, 2]]
            place = ((points[:, [0, 2]] - low) / (high - low) * (NODES - 1)).clip(0.0, NODES - 1.0).T
            for c, of in enumerate(np.moveaxis(np.asarray(values, np.float64), -1, 0)):
                out[:, c] = map_coordinates(of, place, mode="nearest").clip(of.min(), of.max())
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


def make_layout(
    objects: Sequence[PlacedObject], ground_y: Sequence[float | None], seen_by_ground: bool, cache: Cache
) -> Layout:
    """Return the layout of objects. ground_y: height of the ground below each, or None. cache: keeps what is found."""
    keep = max(_KEPT, 2 * len(objects))
    bodies = tuple(_body(placed, y, seen_by_ground, cache, keep) for placed, y in zip(objects, ground_y, strict=True))
    return Layout(bodies, tuple(body.world_nodes(NODES) for body in bodies))


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
    return Body(placed, transfer, own, rotation, shades, height_m, center, radius, weakref.ref(cache), keep)
