# SPDX-License-Identifier: Apache-2.0
"""Bodies of a shot over its ground, and what they and the ground see of each other: visibility and form factors.

Near a body the ground is taken as level, at the height of the receiver below it: what the body sees of it depends on
the body's turn and height alone. Poses are rounded far below what shows, and what is found from a rounded pose is kept
under it: the same pose gives the same result to the last bit wherever in a clip it occurs.

Near bodies: rays from the coarse sample points of a body, and from all of its sample points close by, meet the others.
What a body sees of another is kept under their relative pose, and what it sees of the ground under its own turn and
height: where one body moves, what the others see of each other is kept.

Far bodies: what each hides and sends, as its six silhouettes tell it, seen from the middle of another body.

    A'_k = (1 - c_k) A_k + sum_j f_kj B_j        c_k = 1 - prod_j (1 - w_kj)        f_kj = w_kj c_k/sum_j w_kj

with k the directions (mesh_transfer.py), A the environment, B_j the mean radiance that body j sends to the middle,
and w_kj the fraction of the direction's solid angle that it fills: its own is spread over those about its middle.
"""

from __future__ import annotations

import functools
import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf
from mr360uw.base.texels import smoothstep
from mr360uw.composite.ambient.blocked_light import HeightField, Occluders, Occlusion, make_height_field
from mr360uw.composite.ambient.mesh_transfer import (
    COUNT,
    SOLID_ANGLE,
    Transfer,
    directions,
    shape_of,
    shape_transfer,
)
from mr360uw.composite.shot import PlacedObject, scale_of
from mr360uw.jit import exact, exact_making
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
_SLACK = 1e-4
"""Room around the box of a mesh over its radius, for the rounding of rays in single precision."""
_LEAST = 1e-12
"""Least part of a direction along an axis of such a box."""
_FEW = 0.002
"""Share of a node's light below which the mean of what it sees is drawn to that of its neighbours."""
_KEPT = 64
"""Least number of meshes and of turned meshes of which it is kept what they see and show."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A placed mesh. rotation: (3, 3) its axes to the world's, rounded. shades: whether it blocks light of the ground.
    height_m: of its middle above the ground, in the mesh's metres and rounded; None without ground. center (3,),
    radius: of a ball around it at rest, in the world [m]. cache: keeps its field, as many as `keep`; it keeps the body
    too, which does not hold it.

    What it does to its own light, float32. lost: (S, COUNT) irradiance [sr] that its own surface keeps off in each
    direction, None if nothing; inside: (S, C) sparse, what its coarse samples add instead; left: (S, COUNT) irradiance
    [sr] that each direction still adds. plain, direct: (C, COUNT) irradiance that each direction adds at the coarse
    samples, were nothing in the way, and with the mesh itself.
    """

    placed: PlacedObject
    transfer: Transfer
    lost: NDArray[np.float32] | None
    inside: Any
    left: NDArray[np.float32]
    plain: NDArray[np.float32]
    direct: NDArray[np.float32]
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

    @property
    def on_ground(self) -> bool:
        """Whether body and ground see each other: the ground is so near that its shade matters to the body."""
        radius = self.transfer.mesh.radius_m
        if not self.shades or self.height_m is None:
            return False
        return -radius < self.height_m < (1.0 + _NEAR_GROUND) * radius

    @property
    def ground_key(self) -> bytes:
        """Equal for equal ground where it matters to what the body sees, nothing where it does not: where they do not
        see each other, and no sample lies below the ground, or nearly.
        """
        if self.height_m is None:
            return b""
        above = (self.transfer.lattice.position - self.transfer.mesh.center_m) @ self.rotation[1]
        if not self.on_ground and above.min() >= _LIFT * self.transfer.mesh.radius_m - self.height_m:
            return b""
        return self.rotation.tobytes() + np.float64(self.height_m).tobytes()

    def places(self, sample: NDArray[np.int64]) -> Floats:
        """Return where rays from samples (n,) start (n, 3) in the body's axes: those below the ground just above it."""
        position = self.transfer.lattice.position[sample]
        if self.height_m is None:
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
        seen, scale = np.empty((len(position), COUNT), np.int16), np.float32(0.5 * NODES / self._half_m)
        _find_nodes(place, d, np.float32(self.height_m), scale, seen)
        return seen

    def mean_sent(self) -> NDArray[np.float32]:
        """Return the matrix (nodes, C) that maps the radiance of the body's coarse samples to the mean radiance that
        nodes of the ground see of it; (0, C) without nodes.
        """
        transfer, nodes = self.transfer, self.nodes()
        mesh = transfer.mesh
        if len(nodes) == 0:
            return np.zeros((0, len(transfer.coarse)), np.float32)
        d = directions() @ self.rotation.T
        d = d[d[:, 1] > 0.0]
        along = -nodes @ d.T
        off = np.sum(nodes * nodes, axis=-1)[:, None] - along**2
        number, direction = np.nonzero((off < mesh.radius_m**2) & (along > -mesh.radius_m))
        lifted = nodes + np.array([0.0, _LIFT * mesh.radius_m, 0.0])
        origin, rays = (lifted @ self.rotation + mesh.center_m)[number], (d @ self.rotation)[direction]
        met = transfer.met(origin, rays)
        weight = (SOLID_ANGLE * d[direction[met.ray], 1]).astype(np.float32) * met.part
        down = np.zeros((len(nodes), len(transfer.coarse)), np.float32)
        np.add.at(down, (number[met.ray], transfer.nearest_coarse[met.sample]), weight)
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

    nodes: places (n, 3) of each body's nodes in the world, none where it does not see the ground. ground_bodies:
    numbers of the bodies that the ground sees.
    """

    bodies: tuple[Body, ...]
    nodes: tuple[Floats, ...]
    ground_bodies: tuple[int, ...]

    @property
    def occluders(self) -> Occluders:
        """Bodies that the ground sees."""
        bodies = [self.bodies[k] for k in self.ground_bodies]
        return Occluders(tuple(body.field for body in bodies), np.array([b.origin for b in bodies]).reshape(-1, 3))

    def occluders_from(self, point: Floats) -> Occluders:
        """Return the bodies that the ground sees with their places from a point (3,): the same where all move along."""
        bodies = [self.bodies[k] for k in self.ground_bodies]
        origins = [rounded(body.origin - point, body.radius) for body in bodies]
        return Occluders(tuple(body.field for body in bodies), np.array(origins).reshape(-1, 3))

    def below(self, ground_y: float) -> Floats:
        """Return the point (3,) of level ground below the first body that it sees."""
        first = self.bodies[self.ground_bodies[0]].origin if self.ground_bodies else np.zeros(3)
        return np.array([first[0], ground_y, first[2]])

    def bounced(self, blocked: Occlusion, points: Floats, sent: Sequence[Floats]) -> Floats:
        """Return the irradiance (n, 3) that bodies send to places (n, 3) of the ground, where they block `blocked`.

        sent: mean radiance (NODES, NODES, 3) of each body that the ground sees, at its nodes. Between these it is a
        cubic spline within their range, as light has no bends along lines of nodes; that of the edge beyond.
        """
        from scipy.ndimage import map_coordinates

        total = np.zeros((len(points), 3))
        for k, radiance, share in zip(self.ground_bodies, sent, blocked.share, strict=True):
            some = np.flatnonzero(share)
            if len(self.nodes[k]) == 0:
                continue
            low, high = self.nodes[k][[0, -1]][:, [0, 2]]
            place = ((points[some][:, [0, 2]] - low) / (high - low) * (NODES - 1)).clip(0.0, NODES - 1.0).T
            for c, of in enumerate(np.moveaxis(np.asarray(radiance, np.float64), -1, 0)):
                between = map_coordinates(of, place, mode="nearest").clip(of.min(), of.max())
                total[some, c] += np.pi * share[some] * between
        return total

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
                # In the axes of the body, from rounded places as all that is kept
                ray = np.broadcast_to(direction @ body.rotation, (len(near), 3))
                start = (points[group][near] - body.origin) @ body.rotation / body.placed.scale
                lit[group][near] *= body.transfer.passed(rounded(start, body.transfer.mesh.radius_m), ray)
        return lit


def make_layout(
    objects: Sequence[PlacedObject], ground_y: Sequence[float | None], seen_by_ground: bool, cache: Cache
) -> Layout:
    """Return the layout of objects. ground_y: height of the ground below each, or None. cache: keeps what is found."""
    keep = max(_KEPT, 2 * len(objects))
    bodies = tuple(_body(placed, y, seen_by_ground, cache, keep) for placed, y in zip(objects, ground_y, strict=True))
    nodes = tuple(body.world_nodes(NODES) for body in bodies)
    return Layout(bodies, nodes, tuple(k for k, body in enumerate(bodies) if body.shades))


def _body(placed: PlacedObject, ground_y: float | None, seen_by_ground: bool, cache: Cache, keep: int) -> Body:
    # poses share what is found at rest: rays for each of them would cost seconds a frame
    mesh, linear, shadow = placed.mesh.still, placed.world_from_object[:3, :3], placed.casts_shadow
    bare = cache.of(shape_transfer, shape_of(mesh), keep=keep)
    transfer = cache.of(bare.painted, mesh, keep=keep)
    own = cache.of(bare.own_light, shadow, keep=keep)
    rotation, center, height_m = rounded(linear / placed.scale), placed.to_world(mesh.center_m), None
    if ground_y is not None:
        height_m = float(rounded((center[1] - ground_y) / placed.scale, mesh.radius_m))
    shades = seen_by_ground and shadow and transfer.opacity > 0.0
    radius = mesh.radius_m * placed.scale
    return Body(placed, transfer, *own, rotation, shades, height_m, center, radius, weakref.ref(cache), keep)


_EXACT, _INTERPOLATED = 1.0, 2.0
"""Samples nearer to another body than so many spacings of the coarse samples look themselves, and those beyond so many
take what the coarse samples see; between the two they pass from one to the other."""
_SHARE_STEPS = 1 << 16
_SPREAD_RAD = 0.25
"""Angle over which a far body is spread at least: directions lie 0.16 apart, and with a third less light flickers
while it moves from one to the next."""
_LOST, _SEEN = 0.0005, 0.001
"""Squared sine of the radius of a body, seen from the surface of another, from which on it counts, and counts whole."""
_NEAR, _NEAREST = 0.02, 0.03
"""The same of a body that is near, in part and wholly: rays from each coarse sample then find it."""
_LARGE, _LARGEST = 4.0, 3.0
"""Distances of a body from the middle of another over that one's radius, nearer than which it is seen in other
directions from all places and so is near, too, in part and wholly."""
_UNNOTICED, _NOTICED = 0.004, 0.008
"""The squared sine, as above, from which on it is so at those distances, in part and wholly: smaller ones stay far."""


@dataclass(frozen=True, slots=True, eq=False)
class FormFactors:
    """Irradiance at r samples of a body by what they see beside the body itself.

    lost: (r, COUNT) float32, irradiance that each direction's radiance does not add. samples: (r, all coarse samples)
    sparse, what each coarse sample of the layout adds instead; way: the direction of each of its entries. ground: (r,
    nodes) float32, what the nodes below add instead.
    """

    lost: NDArray[np.float32]
    samples: Any
    way: NDArray[np.int16]
    ground: NDArray[np.float32]

    @property
    def nothing(self) -> bool:
        """Whether nothing is seen."""
        return self.samples.nnz == 0 and self.ground.shape[1] == 0

    def of(self, rows: NDArray[np.int64]) -> FormFactors:
        """Return those of some of the samples."""
        first, count = self.samples.indptr[rows], np.diff(self.samples.indptr)[rows]
        entries = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        return FormFactors(self.lost[rows], self.samples[rows], self.way[entries], self.ground[rows])


class Met(NamedTuple):
    """What directions of S samples meet, those of sample s from begin[s] to begin[s + 1]: direction; target, number of
    a coarse sample among all plus 1, or minus that of a node of the ground minus 1; part: of the direction that it
    fills.
    """

    begin: NDArray[np.int64]
    direction: NDArray[np.int32]
    target: NDArray[np.int32]
    part: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class BodyView:
    """What the samples of one body see. coarse: of its coarse samples. near: of samples near other bodies, near_sample
    (e,) their numbers, near_part (e, 1) the part of what they see themselves in what they take.

    down: (nodes, C) float32, mean radiance that nodes see of the body for that of its coarse samples. openness: (C, 1)
    fraction of the irradiance from free directions. met: what all samples of a glossy body meet, None of others.
    """

    coarse: FormFactors
    near: FormFactors
    near_sample: NDArray[np.int64]
    near_part: NDArray[np.float32]
    down: NDArray[np.float32]
    openness: NDArray[np.float32]
    met: Met | None

    def nothing(self, body: Body) -> bool:
        """Return whether nothing is in the way of the body's light."""
        return not body.on_ground and self.coarse.samples.nnz + self.near.samples.nnz == 0 and body.lost is None

    def spread(self, body: Body, at_coarse: Floats, at_near: Floats) -> Floats:
        """Return values (S, n) at all samples from those at the coarse samples (C, n) and at the near samples (e,
        n)."""
        values: Floats = body.transfer.spread @ at_coarse.astype(np.float32)
        values[self.near_sample] += self.near_part * (at_near - values[self.near_sample])
        return values


@dataclass(frozen=True, slots=True, eq=False)
class Neighbour:
    """Another body as one sees it. begin: where its coarse samples begin among all. share: the part of it that is
    near. linear: (3, 3), shift: (3,): where its axes lie in those of the body that looks, in whose metres, rounded;
    scale: size of the linear part. key: equal for equal poses.
    """

    begin: int
    transfer: Transfer
    share: float
    linear: Floats
    shift: Floats
    scale: float
    key: bytes

    @property
    def ball(self) -> tuple[Floats, float]:
        """Middle (3,) and radius of a ball around it, in the frame and the metres of the body that looks."""
        mesh = self.transfer.mesh
        return self.linear @ mesh.center_m + self.shift, mesh.radius_m * self.scale

    def seen_from(self, transfer: Transfer, place: Floats, open_: NDArray[np.bool_]) -> tuple[NDArray[Any], ...]:
        """Return where rays from places (r, 3) of a mesh in their open directions (r, COUNT) meet the body: numbers of
        the place and the direction, the coarse sample among all, distance in metres of the mesh, and the share, each
        (m,).
        """
        # In the axes of the body, take the rays that lead into the box around it
        back = np.linalg.inv(self.linear).T
        start, along = (place - self.shift) @ back, directions() @ back
        near, found = self._directions_near(transfer), np.empty((2, len(place) * COUNT), np.int32)
        low, high = self.transfer.box
        slack = _SLACK * self.transfer.mesh.radius_m
        box = low - slack, high + slack
        used = _into_box(start, open_, 1.0 / np.where(np.abs(along) < _LEAST, _LEAST, along), near, *box, found)
        sample, direction = found[:, :used]
        origin, rays = start[sample], along[direction]
        met = self.transfer.met(origin, rays)
        coarse_sample = (self.transfer.nearest_coarse[met.sample] + self.begin).astype(np.int32)
        share = np.float32(self.share) * met.part
        return sample[met.ray], direction[met.ray], coarse_sample, met.distance.astype(np.float32), share

    def _directions_near(self, transfer: Transfer) -> NDArray[np.int64]:
        """Return the directions that lead from some place of a mesh into the ball around the body."""
        center, radius = self.ball
        to = center - transfer.mesh.center_m
        apart = math.hypot(*to)
        sine = (transfer.mesh.radius_m + radius) / max(apart, 1e-12)
        if sine >= 1.0:
            return np.arange(COUNT)
        return np.flatnonzero(directions() @ to >= apart * np.sqrt(1.0 - sine * sine))

    def close_samples(self, transfer: Transfer) -> Floats:
        """Return (S,) how far the samples of a mesh have passed from interpolating (0) to looking themselves (1)."""
        spacing, position = transfer.spacing_m, transfer.lattice.position
        (center, radius), reach = self.ball, _INTERPOLATED * spacing
        close = np.flatnonzero(np.linalg.norm(position - center, axis=-1) < radius + reach)
        there = (position[close] - self.shift) @ np.linalg.inv(self.linear).T
        near, _ = self.transfer.tree.query(there, distance_upper_bound=reach / self.scale)
        part = np.zeros(len(position))
        part[close] = smoothstep(near * self.scale / spacing, _INTERPOLATED, _EXACT)
        return part


@exact_making
def _find_nodes(place: Any, d: Any, height_m: Any, scale: Any, seen: Any) -> None:
    """Set `seen` (n, k) as `Body.node_seen` returns it. place: (n, 3) from the middle, d: (k, 3), in axes of the world.

    height_m: of the middle above the ground. scale: nodes in a metre of it.
    """
    half, side, never = np.float32(0.5 * NODES), np.float32(NODES), np.float32(np.inf)
    x, z = np.empty(len(d), np.float32), np.empty(len(d), np.float32)
    for k in range(len(d)):
        down = d[k, 1] < np.float32(-1e-6)
        x[k], z[k] = (d[k, 0] / -d[k, 1], d[k, 2] / -d[k, 1]) if down else (never, never)
    for n in range(len(place)):
        far = (place[n, 1] + height_m) * scale
        for k in range(len(d)):
            i, j = place[n, 0] * scale + far * x[k] + half, place[n, 2] * scale + far * z[k] + half
            inside = i >= 0.0 and i < side and j >= 0.0 and j < side
            seen[n, k] = np.int16(i) * NODES + np.int16(j) if inside else -1


@exact
def _into_box(start: Any, open_: Any, inverse: Any, near: Any, low: Any, high: Any, found: Any) -> Any:
    """Write sample and direction of the open rays into a box to `found` (2, most); return how many there are.

    start: (r, 3) of rays from the samples. inverse: (COUNT, 3) one over their directions. near: numbers of these.
    """
    total = 0
    for s in range(len(start)):
        for k in near:
            if open_[s, k]:
                enter, leave = 0.0, np.inf
                for c in range(3):
                    one, other = (low[c] - start[s, c]) * inverse[k, c], (high[c] - start[s, c]) * inverse[k, c]
                    enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
                if enter <= leave:
                    found[0, total], found[1, total] = s, k
                    total += 1
    return total


def body_views(bodies: Sequence[Body], first: NDArray[np.int64], shares: Floats, cache: Cache) -> tuple[BodyView, ...]:
    """Return what bodies see. first: (B + 1,) where the coarse samples of each begin among all. shares: (B, B), how
    much of each body is near to that of a row. A view is kept while all that it shows stay where they are to the body.
    """
    views = []
    for k, body in enumerate(bodies):
        near = _neighbours(body, [(int(first[m]), bodies[m], shares[k, m]) for m in np.flatnonzero(shares[k]).tolist()])
        begin, total = int(first[k]), int(first[-1])
        of = tuple((other.begin, other.transfer.lattice, other.key, other.share) for other in near)
        of_body = body.transfer.lattice, body.transfer.mesh.glossy, body.placed.casts_shadow
        seen = PartOf((body, near), of_body, body.on_ground, body.ground_key, of)
        views.append(cache.of(_view, seen, begin, total, keep=2 * len(bodies)))
    return tuple(views)


def _neighbours(body: Body, others: Sequence[tuple[int, Body, float]]) -> list[Neighbour]:
    inverse, scale = np.linalg.inv(body.placed.world_from_object), body.placed.scale
    found = []
    for begin, other, share in others:
        pose = inverse @ other.placed.world_from_object
        steps = np.rint(np.log2([other.placed.scale / scale, min(body.radius, other.radius) / scale])) - BITS
        linear, shift = np.rint(pose[:3, :3] / np.exp2(steps[0])) + 0.0, np.rint(pose[:3, 3] / np.exp2(steps[1])) + 0.0
        key, linear = linear.tobytes() + shift.tobytes() + steps.tobytes(), linear * np.exp2(steps[0])
        near = round(float(share) * _SHARE_STEPS) / _SHARE_STEPS
        found.append(Neighbour(begin, other.transfer, near, linear, shift * np.exp2(steps[1]), scale_of(linear), key))
    return found


def _view(seen: PartOf[tuple[Body, list[Neighbour]]], begin: int, total: int) -> BodyView:
    """Return what a body sees of near ones. begin: where its own coarse samples begin among all, `total`."""
    body, near = seen.whole
    transfer, sample = body.transfer, body.transfer.coarse
    close = np.max([np.zeros(len(transfer.cosine)), *(other.close_samples(transfer) for other in near)], axis=0)
    if transfer.mesh.glossy:
        close[:] = 1.0  # every sample has a lobe of its own
    near_sample = np.flatnonzero(close)
    cosine = body.left[near_sample]
    at_near, node = _form_factors(body, near, near_sample, cosine, total)
    at_coarse = (
        at_near.of(sample) if transfer.mesh.glossy
        else _form_factors(body, near, sample, body.direct, total)[0]
    )  # fmt: skip
    lost = (body.plain - body.direct + at_coarse.lost).sum(axis=1, keepdims=True)
    lost -= at_coarse.ground.sum(axis=1, keepdims=True)
    openness = 1.0 - lost / body.plain.sum(axis=1, keepdims=True)
    met = _met_by(body, at_near, cosine, node, begin) if transfer.mesh.glossy else None
    part = close[near_sample, None].astype(np.float32)
    return BodyView(at_coarse, at_near, near_sample, part, body.mean_sent(), openness, met)


def _form_factors(
    body: Body, near: Sequence[Neighbour], sample: NDArray[np.int64], cosine: NDArray[np.float32], total: int
) -> tuple[FormFactors, NDArray[np.int16] | None]:
    """Return what samples (r,) see where directions add `cosine` (r, COUNT), and the node of the ground in each."""
    place, open_ = body.places(sample), cosine > 0.0
    node = body.node_seen(place)
    hits = [other.seen_from(body.transfer, place, open_) for other in near if len(sample)]
    return form_factors(cosine, node, hits, total), node


def form_factors(
    cosine: NDArray[np.float32], node: NDArray[np.int16] | None, hits: list[tuple[NDArray[Any], ...]], total: int
) -> FormFactors:
    """Return what r samples of a body see. cosine: (r, COUNT) irradiance that open directions add; node: (r, COUNT) the
    node of the ground behind each, -1 for none, or None without nodes; hits: of `Neighbour.seen_from` for each other
    body; total: number of all coarse samples.
    """
    from scipy.sparse import csr_matrix

    none = *(np.zeros(0, np.int32) for _ in range(3)), *(np.zeros(0, np.float32) for _ in range(2))
    sample, *others = (np.concatenate(columns) for columns in zip(none, *hits, strict=True))
    rows = len(cosine)
    lost, ground = np.zeros((rows, COUNT), np.float32), np.zeros((rows, 0 if node is None else NODES**2), np.float32)
    begin, column = np.zeros(rows + 1, np.int64), np.empty(len(sample), np.int32)
    weight, way = np.empty(len(sample), np.float32), np.empty(len(sample), np.int16)
    if node is not None or len(sample):
        behind = np.full(cosine.shape, -1, np.int16) if node is None else node
        _resolve(cosine, behind, (sample, *others), lost, ground, (begin, column, weight, way))
    used = int(begin[-1])
    samples = csr_matrix((weight[:used], column[:used], begin), shape=(rows, total))
    return FormFactors(lost, samples, way[:used], ground)


@exact_making
def _resolve(cosine: Any, node: Any, hits: Any, lost: Any, ground: Any, matrix: Any) -> None:
    """Share the light of each direction among what rays (m,) meet there, the nearest first, and the ground behind.

    cosine, node: (r, COUNT). hits: of `Neighbour.seen_from`. lost, ground, and begin, column and weight of a sparse
    matrix with the way of each entry: as `FormFactors` has them.
    """
    (sample, direction, met, distance, share), (begin, column, weight, way) = hits, matrix
    # List what each sample meets in a direction, the nearest first
    head = np.full(cosine.shape, -1, np.int32)
    after = np.full(len(sample), -1, np.int32)
    for m in range(len(sample)):
        s, k = sample[m], direction[m]
        before, now = -1, head[s, k]
        while now >= 0 and distance[now] <= distance[m]:
            before, now = now, after[now]
        after[m] = now
        if before < 0:
            head[s, k] = m
        else:
            after[before] = m
    # Share the direction's light along its list; what is left falls on the ground, if that lies there
    used = 0
    for s in range(cosine.shape[0]):
        for k in range(cosine.shape[1]):
            left = cosine[s, k]
            if left <= 0.0:
                continue
            m = head[s, k]
            while m >= 0:
                column[used], weight[used], way[used] = met[m], left * share[m], k
                left -= weight[used]
                used += 1
                m = after[m]
            lost[s, k] = cosine[s, k] - left
            if node[s, k] >= 0:
                ground[s, node[s, k]] += left
                lost[s, k] = cosine[s, k]
        begin[s + 1] = used


def _met_by(
    body: Body, factors: FormFactors, cosine: NDArray[np.float32], node: NDArray[np.int16] | None, begin: int
) -> Met:
    """Return what all samples of a body meet: others and the ground as in their form factors, then the body itself.

    cosine: (S, COUNT) irradiance that directions add which the body leaves open, at least in part. node: (S, COUNT) of
    the ground, -1 for none. begin: where the body's coarse samples begin among all.
    """
    samples, seen = factors.samples, np.full(cosine.shape, -1, np.int16) if node is None else node
    # Sort what the body blocks itself by sample
    order = np.argsort(body.transfer.own[0], kind="stable") if body.lost is not None else np.zeros(0, np.int64)
    of_sample, own_way, hit = body.transfer.own[:, order]
    own_target = (body.transfer.nearest_coarse[hit] + begin + 1).astype(np.int32)
    own = np.searchsorted(of_sample, np.arange(len(cosine) + 1)), own_way, own_target, body.transfer.own_part[order]
    # Room for whatever may be met: memory that is not written is not taken
    first, most = np.zeros(len(cosine) + 1, np.int64), len(samples.data) + seen.size + len(order)
    direction, target, part = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.float32)
    others = samples.indptr, factors.way, samples.indices, samples.data
    _list_met(body.transfer.cosine, cosine, seen, others, own, Met(first, direction, target, part))
    used = int(first[-1])
    return Met(first, direction[:used].copy(), target[:used].copy(), part[:used].copy())


@exact_making
def _list_met(whole: Any, cosine: Any, node: Any, others: Any, own: Any, found: Any) -> None:
    """Set the arrays of `Met`, found, sample by sample.

    whole, cosine: (S, COUNT) irradiance that directions add, and that which the body leaves. node: (S, COUNT). others:
    begin of each sample, directions, coarse samples and weights of `FormFactors`. own: the same with targets and parts,
    of what the body blocks itself.
    """
    (begin, way, met, weight), (place, own_way, own_target, own_part) = others, own
    first, direction, target, part = found
    used, taken = 0, np.zeros(whole.shape[1])
    for s in range(len(whole)):
        # Others, then the ground behind them, then the body itself
        taken[:] = 0.0
        for m in range(begin[s], begin[s + 1]):
            direction[used], target[used], part[used] = way[m], met[m] + 1, weight[m] / whole[s, way[m]]
            taken[way[m]] += weight[m]
            used += 1
        for k in range(whole.shape[1]):
            left = cosine[s, k] - taken[k]
            if node[s, k] >= 0 and cosine[s, k] > 0.0 and left > 0.0:
                direction[used], target[used], part[used] = k, -node[s, k] - 1, left / whole[s, k]
                used += 1
        for m in range(place[s], place[s + 1]):
            direction[used], target[used], part[used] = own_way[m], own_target[m], own_part[m]
            used += 1
        first[s + 1] = used


@dataclass(frozen=True, slots=True, eq=False)
class FarBodies:
    """Far bodies around each of B bodies, in P pairs sorted by the body that is lit.

    lit, other: (P,) the numbers of both. side, part: (P, 3) the sides of the other that are seen, and how much they
    count. begin: (P + 1,) where the directions of each pair begin; direction, weight: of them, f above. cover: (B,
    COUNT) fraction of each direction that far bodies fill.
    """

    lit: NDArray[np.int64]
    other: NDArray[np.int64]
    side: NDArray[np.int64]
    part: Floats
    begin: NDArray[np.int64]
    direction: NDArray[np.int16]
    weight: NDArray[np.float32]
    cover: NDArray[np.float32]


def near_shares(bodies: Sequence[Body]) -> tuple[Floats, Floats]:
    """Return how much of each body (n, n) is near to the body of a row and found by rays; and how much is far."""
    center, radius = np.array([body.center for body in bodies]), np.array([body.radius for body in bodies])
    apart = np.linalg.norm(center[:, None] - center, axis=-1)
    hidden = (radius / np.maximum(apart - radius[:, None], np.maximum(radius, 1e-12))) ** 2
    casting = np.array([body.placed.casts_shadow for body in bodies]) & ~np.eye(len(bodies), dtype=bool)
    around = smoothstep(apart / radius[:, None], _LARGE, _LARGEST) * smoothstep(hidden, _UNNOTICED, _NOTICED)
    near = np.maximum(smoothstep(hidden, _NEAR, _NEAREST), around)
    return np.where(casting, near, 0.0), np.where(casting, (1.0 - near) * smoothstep(hidden, _LOST, _SEEN), 0.0)


def far_bodies(bodies: Sequence[Body], share: Floats) -> FarBodies:
    """Return the far bodies around each, of which shares (B, B) count for the body of a row."""
    lit, other = np.nonzero(share)
    center, radius = np.array([body.center for body in bodies]), np.array([body.radius for body in bodies])
    rotation = np.array([body.rotation for body in bodies])
    area = np.array([body.transfer.area_m2 * body.placed.scale**2 for body in bodies])
    to = center[other] - center[lit]
    apart = np.linalg.norm(to, axis=-1)
    to /= apart[:, None]
    back = -np.einsum("pk,pkj->pj", to, rotation[other])
    solid_angle = share[lit, other] * np.sum(back**2 * area[other], axis=-1) / apart**2
    wide = np.maximum(np.arcsin(np.minimum(radius[other] / apart, 1.0)), _SPREAD_RAD)
    # room for all directions of each pair: memory that is not written to is not taken
    begin, direction = np.zeros(len(lit) + 1, np.int64), np.empty(len(lit) * COUNT, np.int16)
    weight, cover = np.empty(len(direction), np.float32), np.zeros((len(bodies), COUNT), np.float32)
    towards = np.einsum("pk,pkj->pj", to, rotation[lit])
    of_direction = solid_angle / SOLID_ANGLE
    _spread(lit, towards, np.cos(wide), of_direction, directions(), (begin, direction, weight, cover))
    used, side = int(begin[-1]), 2 * np.arange(3) + (back < 0.0)
    return FarBodies(lit, other, side, back**2, begin, direction[:used].copy(), weight[:used].copy(), cover)


@exact_making
def _spread(lit: Any, towards: Any, cosine: Any, filled: Any, d: Any, found: Any) -> None:
    """Set begin, direction, weight and cover of `FarBodies`, found.

    towards: (P, 3) in the axes of the body that is lit. cosine: (P,) of the angle that the other is spread over.
    filled: (P,) its solid angle over that of a direction. d: (COUNT, 3).
    """
    (begin, direction, weight, cover), used, first = found, 0, 0
    left, total = np.ones(len(d)), np.zeros(len(d))
    for p in range(len(lit)):
        whole, start = 0.0, used
        for k in range(len(d)):
            within = towards[p, 0] * d[k, 0] + towards[p, 1] * d[k, 1] + towards[p, 2] * d[k, 2] - cosine[p]
            if within > 0.0:
                direction[used], weight[used] = k, within
                used += 1
                whole += within
        for e in range(start, used):
            weight[e] = min(weight[e] * filled[p] / whole, 1.0)
            left[direction[e]] *= 1.0 - weight[e]
            total[direction[e]] += weight[e]
        begin[p + 1] = used
        if p + 1 == len(lit) or lit[p + 1] != lit[p]:
            for e in range(begin[first], used):
                weight[e] *= (1.0 - left[direction[e]]) / max(total[direction[e]], 1e-12)
            for k in range(len(d)):
                cover[lit[p], k] = 1.0 - left[k]
            left[:], total[:], first = 1.0, 0.0, p + 1


@exact
def _add_sent(lit: Any, begin: Any, direction: Any, weight: Any, sent: Any, light: Any) -> None:
    """Add what the others of pairs send (P, 3) to the light (B, COUNT, 3)."""
    for p in range(len(lit)):
        for e in range(begin[p], begin[p + 1]):
            for c in range(3):
                light[lit[p], direction[e], c] += weight[e] * sent[p, c]


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
    blocked: Occlusion

    def untouched(self, number: int) -> bool:
        """Return whether nothing is in the way of a body's light."""
        return number not in self.far.lit and self.views[number].nothing(self.layout.bodies[number])

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

    def with_far(self, light: NDArray[np.float32], sent: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the light (B, COUNT, 3) around bodies with the far bodies before it. sent: as of `sent_down`."""
        far = self.far
        if len(far.lit) == 0:
            return light
        ends = zip(self.layout.bodies, self.first[:-1], self.first[1:], strict=True)
        sides = np.array([body.transfer.sides @ sent[begin:end] for body, begin, end in ends])
        of_pairs = np.einsum("ps,psc->pc", far.part, sides[far.other[:, None], far.side]).astype(np.float32)
        found = light * (1.0 - far.cover[..., None])
        _add_sent(far.lit, far.begin, far.direction, far.weight, of_pairs, found)
        return found


def make_exchange(layout: Layout, cache: Cache) -> Exchange:
    """Return what the bodies of a layout and the ground see of each other. cache: keeps what is found."""
    from scipy.sparse import block_diag, vstack

    bodies = layout.bodies
    first = np.concatenate([[0], np.cumsum([len(body.transfer.coarse) for body in bodies])]).astype(np.int64)
    near, far = near_shares(bodies)
    views = body_views(bodies, first, near, cache)
    own = block_diag([body.inside[body.transfer.coarse] for body in bodies], format="csr")
    samples = vstack([view.coarse.samples for view in views], format="csr") + own
    places = np.concatenate([body.world_nodes(COARSE_NODES) for body in bodies])
    blocked = layout.occluders.blocked(places, np.tile([0.0, 1.0, 0.0], (len(places), 1)))
    return Exchange(layout, views, far_bodies(bodies, far), first, samples, places, blocked)
