# SPDX-License-Identifier: Apache-2.0
"""What the sites of one placed body see of other bodies and of the ground, and the ground of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.directions import COUNT, SOLID_ANGLE, directions
from mr360uw.composite.ambient.height_field import HeightField
from mr360uw.composite.ambient.mesh_transfer import Transfer, met_sites
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

_LEAST_SHARE = 0.004
"""Bodies that block less of each other's ambient light than this, about a code value, are not looked at."""
NODES = 16
"""Points along each side of the square of ground that a body sees in its own shade."""
_NODE_REACH, _REACH_WITH_HEIGHT = 2.0, 1.0
"""Half side of that square over the body's radius, and how it grows with the gap below the body: beyond it the body
blocks less than a twentieth, and shadows of a sun above 45 degrees end."""
_NEAR_GROUND = 9.0
"""Bodies higher above the ground than this many radii block less than a hundredth of its light."""
_LIFT = 1e-3
"""Height of the nodes above the ground over the body's radius."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A placed mesh. rotation: (3, 3) its axes to the world's. field: what the ground sees of it; None if nothing.

    center (3,), radius: of a ball around it, in the world [m].
    """

    placed: PlacedObject
    transfer: Transfer
    rotation: Floats
    field: HeightField | None
    center: Floats
    radius: float

    @property
    def origin(self) -> Floats:
        """Place (3,) of the body's origin in the world."""
        return self.placed.world_from_object[:3, 3]

    def inside(self, points: Floats) -> Floats:
        """Return points (n, 3) of the world in the body's axes."""
        return (points - self.origin) @ self.rotation / self.placed.scale


@dataclass(frozen=True, slots=True, eq=False)
class BodyView:
    """What the sites of one body see.

    lost: (S, COUNT) sparse, irradiance that each direction's radiance does not add. sites: (S, all sites) sparse, what
    each site of the layout adds instead. ground: (S, NODES^2) sparse, how the nodes below add. back: (NODES^2, S)
    sparse, irradiance that radiance of the body's own sites adds to the nodes. visible: (S,) fraction of the
    irradiance from free directions. node: (NODES^2, 3) places of the nodes in the world, or none. met: (S, COUNT)
    sparse int32 of glossy bodies, None of others, numbers of what directions meet: site plus 1, or minus node minus 1.
    """

    lost: Any
    sites: Any
    ground: Any
    back: Any
    visible: Floats
    node: Floats
    met: Any

    @property
    def nothing(self) -> bool:
        """Whether nothing is in the way."""
        return self.lost.nnz == 0 and self.ground.nnz == 0


def body_view(number: int, bodies: tuple[Body, ...], first: NDArray[np.int64], ground_y: float | None) -> BodyView:
    """Return what the sites of one of several bodies see. first: where the sites of each begin; ground_y: height."""
    from scipy.sparse import csr_matrix

    body = bodies[number]
    transfer = body.transfer
    count = len(transfer.cosine)
    free = transfer.cosine > 0.0
    parts: list[tuple[NDArray[np.int64], ...]] = []
    if body.placed.casts_shadow:
        own = transfer.own
        free[own.site, own.direction] = False
        parts.append((own.site, own.direction, own.hit + first[number]))
    place = body.placed.to_world(transfer.lattice.position)
    if ground_y is not None:
        place = np.maximum(place, [-np.inf, ground_y + 1e-3 * body.radius, -np.inf])
    parts += _others(number, bodies, first, place, free)
    site, direction, hit = (np.concatenate([np.zeros(0, np.int64), *column]) for column in zip(*parts, strict=True)) \
        if parts else np.zeros((3, 0), np.int64)  # fmt: skip
    weight = transfer.cosine[site, direction]
    node, onto, back = _ground(body, place, free, ground_y)
    below = csr_matrix((transfer.cosine[onto[0], onto[1]], (onto[0], onto[2])), shape=(count, len(node)))
    met: Any = None
    if body.placed.mesh.glossy:
        number_met = np.concatenate([hit + 1, -onto[2] - 1]).astype(np.int32)
        rows, columns = (np.concatenate([a, b]) for a, b in ((site, onto[0]), (direction, onto[1])))
        met = csr_matrix((number_met, (rows, columns)), shape=(count, COUNT))
    return BodyView(
        lost=csr_matrix((weight, (site, direction)), shape=(count, COUNT)),
        sites=csr_matrix((weight, (site, hit)), shape=(count, int(first[-1]))),
        ground=below,
        back=back,
        visible=1.0 - np.bincount(site, weight, count) / np.maximum(transfer.whole, 1e-12),
        node=node,
        met=met,
    )


def _others(
    number: int, bodies: tuple[Body, ...], first: NDArray[np.int64], place: Floats, free: NDArray[np.bool_]
) -> list[tuple[NDArray[np.int64], ...]]:
    """Return (site, direction, site that is met) of what other bodies block; take it off what is free (S, COUNT)."""
    body = bodies[number]
    d = directions() @ body.rotation.T
    nearest = np.full(free.shape, np.inf, np.float32)
    met = np.full(free.shape, -1, np.int64) if len(bodies) > 1 else np.zeros(0, np.int64)
    found = False
    for k, other in enumerate(bodies):
        apart = float(np.linalg.norm(other.center - body.center))
        gap = max(apart - body.radius, other.radius)
        if k == number or not other.placed.casts_shadow or (other.radius / gap) ** 2 < _LEAST_SHARE:
            continue
        site, direction = _towards(body, other, place, d, free)
        origin, rays = other.inside(place[site]), d[direction] @ other.rotation
        triangle = other.transfer.scene.first_hit(origin, rays)
        hit = np.flatnonzero(triangle >= 0)
        site, direction = site[hit], direction[hit]
        seen, along, _ = met_sites(other.transfer, origin[hit], rays[hit], triangle[hit])
        nearer = along * other.placed.scale < nearest[site, direction]
        site, direction = site[nearer], direction[nearer]
        nearest[site, direction] = along[nearer] * other.placed.scale
        met[site, direction] = seen[nearer] + first[k]
        found |= len(site) > 0
    if not found:
        return []
    site, direction = np.nonzero(met >= 0)
    free[site, direction] = False
    return [(site, direction, met[site, direction])]


def _towards(
    body: Body, other: Body, place: Floats, d: Floats, free: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the free directions, as pairs of site and direction, into the ball around another body."""
    apart = float(np.linalg.norm(other.center - body.center))
    sine = (body.radius + other.radius) / max(apart, 1e-12)
    # directions that lead into it from some site: few of a body that stands apart
    near = np.arange(len(d))
    if sine < 1.0:
        near = np.flatnonzero(d @ (other.center - body.center) >= apart * np.sqrt(1.0 - sine * sine))
    to = (other.center - place).astype(np.float32)
    along = to @ d[near].T.astype(np.float32)
    squared = np.sum(to * to, axis=-1)[:, None]
    into = (squared - along * along <= other.radius**2) & ((along > 0.0) | (squared < other.radius**2))
    site, direction = np.nonzero(into & free[:, near])
    return site, near[direction]


def _ground(
    body: Body, place: Floats, free: NDArray[np.bool_], ground_y: float | None
) -> tuple[Floats, tuple[NDArray[np.int64], ...], Any]:
    """Return the nodes (NODES^2, 3) on the ground below a body, (site, direction, node) of what sites see of them, and
    how the body's sites add to them.
    """
    from scipy.sparse import csr_matrix

    count, center, radius = len(place), body.center, body.radius
    if ground_y is None or body.field is None or not -radius < center[1] - ground_y < (1.0 + _NEAR_GROUND) * radius:
        none = np.zeros(0, np.int64)
        return np.zeros((0, 3)), (none, none, none), csr_matrix((0, count))
    half = _NODE_REACH * radius + _REACH_WITH_HEIGHT * max(center[1] - radius - ground_y, 0.0)
    line = ((np.arange(NODES) + 0.5) / NODES * 2.0 - 1.0) * half
    x, z = np.meshgrid(center[0] + line, center[2] + line, indexing="ij")
    node = np.stack([x, np.full_like(x, ground_y), z], axis=-1).reshape(-1, 3)
    d = directions() @ body.rotation.T
    down = np.where(d[:, 1] < -1e-6, -1.0 / np.minimum(d[:, 1], -1e-6), 0.0)
    site, direction = np.nonzero(free & (down > 0.0))
    # in cells, one axis a row
    scale = 0.5 * NODES / half
    start, run = ((place - center) * scale).astype(np.float32).T.copy(), (d * down[:, None] * scale).astype(np.float32)
    far = ((place[:, 1] - ground_y).astype(np.float32))[site]
    i, j = (start[axis][site] + far * run[:, axis][direction] + 0.5 * NODES for axis in (0, 2))
    inside = (i >= 0.0) & (i < NODES) & (j >= 0.0) & (j < NODES)
    site, direction, i, j = site[inside], direction[inside], i[inside], j[inside]
    number = i.astype(np.int64) * NODES + j.astype(np.int64)
    return node, (site, direction, number), _sent_down(body, node)


def _sent_down(body: Body, node: Floats) -> Any:
    """Return the irradiance that radiance of a body's sites adds to level nodes (n, 3), (n, S) sparse."""
    from scipy.sparse import csr_matrix

    d = directions() @ body.rotation.T
    d = d[d[:, 1] > 0.0]
    to = body.center - node
    along = to @ d.T
    off = np.sum(to * to, axis=-1)[:, None] - along**2
    number, direction = np.nonzero((off < body.radius**2) & (along > -body.radius))
    lifted = node[number] + [0.0, _LIFT * body.radius, 0.0]
    origin, rays = body.inside(lifted), d[direction] @ body.rotation
    triangle = body.transfer.scene.first_hit(origin, rays)
    hit = np.flatnonzero(triangle >= 0)
    site, _, _ = met_sites(body.transfer, origin[hit], rays[hit], triangle[hit])
    weight = (SOLID_ANGLE * d[direction[hit], 1]).astype(np.float32)
    return csr_matrix((weight, (number[hit], site)), shape=(len(node), len(body.transfer.cosine)))
