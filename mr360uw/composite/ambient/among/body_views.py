# SPDX-License-Identifier: Apache-2.0
"""What each of several bodies sees of the near ones and of the ground: a function of their places to each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf
from mr360uw.composite.ambient.among.near_bodies import Neighbour
from mr360uw.composite.ambient.among.relative_pose import relative_pose
from mr360uw.composite.ambient.body_view import Body, BodyView, Outlook, outlook
from mr360uw.composite.ambient.lobe_occlusion import met_by
from mr360uw.types import Floats

_SHARE_STEPS = 1 << 16


def body_views(bodies: Sequence[Body], first: NDArray[np.int64], shares: Floats, cache: Cache) -> tuple[BodyView, ...]:
    """Return what bodies see. first: (B + 1,) where the lookouts of each begin among all. shares: (B, B), how much of
    each body is near to that of a row. A view is kept while all that it shows stay where they are to the body.
    """
    views = []
    for k, body in enumerate(bodies):
        near = _neighbours(body, [(int(first[m]), bodies[m], shares[k, m]) for m in np.flatnonzero(shares[k]).tolist()])
        begin, total = int(first[k]), int(first[-1])
        of = tuple((other.begin, other.transfer.lattice, other.pose.key, other.share) for other in near)
        of_body = body.transfer.lattice, body.transfer.mesh.glossy, body.placed.casts_shadow
        seen = PartOf((body, near), of_body, body.on_ground, body.ground_key, of)
        views.append(cache.of(_view, seen, begin, total, keep=2 * len(bodies)))
    return tuple(views)


def _neighbours(body: Body, others: Sequence[tuple[int, Body, float]]) -> list[Neighbour]:
    inverse, scale = np.linalg.inv(body.placed.world_from_object), body.placed.scale
    found = []
    for begin, other, share in others:
        least = min(body.radius, other.radius) / scale
        pose = relative_pose(inverse, other.placed.world_from_object, other.placed.scale / scale, least)
        found.append(Neighbour(begin, other.transfer, pose, round(float(share) * _SHARE_STEPS) / _SHARE_STEPS))
    return found


def _view(seen: PartOf[tuple[Body, list[Neighbour]]], begin: int, total: int) -> BodyView:
    """Return what a body sees of near ones. begin: where its own lookouts begin among all, `total`."""
    body, near = seen.whole
    transfer, site = body.transfer, body.transfer.lookouts.site
    close = np.max([np.zeros(len(transfer.cosine)), *(other.close_sites(transfer) for other in near)], axis=0)
    if transfer.mesh.glossy:
        close[:] = 1.0  # every site has a lobe of its own
    near_site = np.flatnonzero(close)
    at_lookouts, _ = _outlook(body, near, site, body.own.direct, total)
    cosine = np.where(body.own.open[near_site], transfer.cosine[near_site], np.float32(0.0))
    at_near, node = _outlook(body, near, near_site, cosine, total)
    down = np.zeros((0, len(site)), np.float32)
    if body.ground is not None and body.on_ground:
        down = body.ground.mean_sent(transfer)
    lost = (body.own.plain - body.own.direct + at_lookouts.lost).sum(axis=1, keepdims=True)
    lost -= at_lookouts.ground.sum(axis=1, keepdims=True)
    openness = 1.0 - lost / transfer.whole[site, None]
    met = met_by(body, at_near, cosine, node, begin) if transfer.mesh.glossy else None
    part = close[near_site, None].astype(np.float32)
    return BodyView(at_lookouts, at_near, near_site, part, down, openness, met)


def _outlook(
    body: Body, near: Sequence[Neighbour], site: NDArray[np.int64], cosine: NDArray[np.float32], total: int
) -> tuple[Outlook, NDArray[np.int16] | None]:
    """Return what sites (r,) see where directions add `cosine` (r, COUNT), and the node of the ground in each."""
    place, open_ = body.places(site), cosine > 0.0
    node = body.ground.node_seen(body.transfer, place) if body.ground is not None and body.on_ground else None
    hits = [other.seen_from(body.transfer, place, open_) for other in near if len(site)]
    return outlook(cosine, node, hits, total), node
