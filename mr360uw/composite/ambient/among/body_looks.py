# SPDX-License-Identifier: Apache-2.0
"""Looks of several bodies at each other and at the ground; what is not kept of pairs is found for all at once."""

from __future__ import annotations

import functools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.among.pair_view import Pair, PairView, may_show, near_sites, pair_views, share_shown
from mr360uw.composite.ambient.among.relative_pose import RelativePose, relative_pose
from mr360uw.composite.ambient.body_view import Body, BodyView, outlook
from mr360uw.composite.ambient.lobe_occlusion import met_by
from mr360uw.composite.ambient.mesh_transfer import Transfer
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Other:
    """Another body as one sees it: where its lookouts begin among all, its pose and the part of it that shows."""

    begin: int
    transfer: Transfer
    pose: RelativePose
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """A body that looks for others. begin: where its lookouts begin among all, `total`. key: of its view."""

    body: Body
    begin: int
    total: int
    others: tuple[_Other, ...]
    key: Hashable


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """Sites (r,) of a body that look, the irradiance (r, COUNT) of their directions, and the keys of their pairs."""

    site: NDArray[np.int64]
    cosine: NDArray[np.float32]
    keys: list[Hashable]


def body_views(bodies: Sequence[Body], first: NDArray[np.int64], cache: Cache, keep: int) -> tuple[BodyView, ...]:
    """Return what bodies see. first: (B + 1,) where the lookouts of each begin among all. keep: how many values of a
    kind stay in the cache.
    """
    center, radius = np.array([body.center for body in bodies]), np.array([body.radius for body in bodies])
    looks = [_look(k, bodies, may_show(center, radius, k), first) for k in range(len(bodies))]
    by_key = {look.key: look for look in looks}

    def make(keys: list[Hashable]) -> list[BodyView]:
        return _seen([by_key[key] for key in keys], cache, keep)

    return tuple(cache.get_all("ambient view", [look.key for look in looks], make, keep))


def _look(number: int, bodies: Sequence[Body], near: NDArray[np.bool_], first: NDArray[np.int64]) -> _Look:
    """Return the look of one of several bodies. near: (B,) those it may see."""
    body, total, begin = bodies[number], int(first[-1]), int(first[number])
    inverse, scale = np.linalg.inv(body.placed.world_from_object), body.placed.scale
    others = []
    for k in np.flatnonzero(near).tolist():
        other = bodies[k]
        if not other.placed.casts_shadow:
            continue
        pose = _pose(body, inverse, scale, other)
        share = share_shown(body.transfer, other.transfer, pose)
        if share > 0.0:
            others.append(_Other(int(first[k]), other.transfer, pose, share))
    of = tuple((other.begin, other.transfer.lattice, other.pose.key) for other in others)
    what = body.transfer.lattice, body.transfer.mesh.glossy, body.placed.casts_shadow
    return _Look(body, begin, total, tuple(others), (*what, body.on_ground, body.ground_key, of, total, begin))


def _pose(body: Body, inverse: Floats, scale: float, other: Body) -> RelativePose:
    """Return where another body lies in the frame of one, with its inverse matrix (4, 4) and scale."""
    least = min(body.radius, other.radius) / scale
    return relative_pose(inverse, other.placed.world_from_object, other.placed.scale / scale, least)


def _seen(looks: Sequence[_Look], cache: Cache, keep: int) -> list[BodyView]:
    """Return what bodies see that look."""
    parts = [_near_parts(look) for look in looks]
    pairs: dict[Hashable, Pair] = {}
    sides = [_sides(look, np.flatnonzero(part), pairs) for look, part in zip(looks, parts, strict=True)]

    def make(keys: list[Hashable]) -> list[PairView]:
        return pair_views([pairs[key] for key in keys])

    found = dict(zip(pairs, cache.get_all("ambient pair", list(pairs), make, keep), strict=True))
    return [
        _view(look, part, of_look, found, functools.partial(cache.get, keep=keep))
        for look, part, of_look in zip(looks, parts, sides, strict=True)
    ]


def _near_parts(look: _Look) -> Floats:
    """Return (S,) how far the sites of a body look themselves, see `near_sites`."""
    transfer = look.body.transfer
    part = np.zeros(len(transfer.cosine))
    for other in look.others:
        of_other = near_sites(transfer, other.transfer, other.pose)
        part = part if of_other is None else np.maximum(part, of_other)
    if transfer.mesh.glossy:
        part[:] = 1.0  # every site has a lobe of its own
    return part


def _sides(look: _Look, near: NDArray[np.int64], pairs: dict[Hashable, Pair]) -> tuple[_Side, _Side]:
    """Return the lookouts of a body and the sites `near` others, and add their pairs by key."""
    body, transfer = look.body, look.body.transfer
    near_cosine = np.where(body.own.open[near], transfer.cosine[near], np.float32(0.0))
    sides = []
    for site, cosine in ((transfer.lookouts.site, body.own.direct), (near, near_cosine)):
        keys: list[Hashable] = []
        if len(site) and look.others:
            place, open_, which = body.places(site), cosine > 0.0, site.tobytes()
            for other in look.others:
                key = transfer.lattice, other.transfer.lattice, other.pose.key, body.placed.casts_shadow, which
                keys.append((*key, body.sunk_key))
                pairs[keys[-1]] = Pair(transfer, place, open_, other.transfer, other.pose, other.share)
        sides.append(_Side(site, cosine, keys))
    return sides[0], sides[1]


def _view(
    look: _Look, part: Floats, sides: tuple[_Side, _Side], found: dict[Hashable, PairView], kept: Any
) -> BodyView:
    """Return what a body sees. part: of `_near_parts`. found: views of pairs. kept: gets a value from the cache."""
    body, transfer, shape = look.body, look.body.transfer, look.body.transfer.lattice
    ground = body.ground if body.on_ground else None
    node, outlooks = None, []
    for side in sides:
        pairs = [
            (found[key], other.begin) for key, other in zip(side.keys, look.others if side.keys else (), strict=True)
        ]
        if ground is not None:
            make_seen = functools.partial(ground.node_seen, transfer, body.places(side.site))
            node = kept("ambient nodes seen", (shape, body.ground_key, side.site.tobytes()), make_seen)
        outlooks.append(outlook(side.cosine, node, pairs, look.total))
    down = np.zeros((0, len(transfer.lookouts.site)), np.float32)
    if ground is not None:
        down = kept("ambient down", (shape, body.ground_key), functools.partial(ground.mean_sent, transfer))
    lost = (body.own.plain - body.own.direct + outlooks[0].lost).sum(axis=1, keepdims=True)
    lost -= outlooks[0].ground.sum(axis=1, keepdims=True)
    openness = 1.0 - lost / transfer.whole[transfer.lookouts.site, None]
    near = sides[1]
    met = met_by(body, outlooks[1], near.cosine, node, look.begin) if transfer.mesh.glossy else None
    return BodyView(outlooks[0], outlooks[1], near.site, part[near.site, None].astype(np.float32), down, openness, met)
