# SPDX-License-Identifier: Apache-2.0
"""Visibility of near bodies and of the ground from the sample points of each body, at their relative poses.

Rays from the coarse sample points of a body, and from all of its sample points close by, meet the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf
from mr360uw.composite.ambient.among.relative_pose import RelativePose, relative_pose
from mr360uw.composite.ambient.body_view import Body, BodyView, FormFactors, form_factors
from mr360uw.composite.ambient.directions import COUNT, directions
from mr360uw.composite.ambient.lobe_occlusion import met_by
from mr360uw.composite.ambient.mesh_transfer import Transfer, met_samples
from mr360uw.jit import exact
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

_EXACT, _INTERPOLATED = 1.0, 2.0
"""Samples nearer to another body than so many spacings of the coarse samples look themselves, and those beyond so many
take what the coarse samples see; between the two they pass from one to the other."""


@dataclass(frozen=True, slots=True, eq=False)
class Neighbour:
    """Another body as one sees it. begin: where its coarse samples begin among all. share: the part of it that is
    near."""

    begin: int
    transfer: Transfer
    pose: RelativePose
    share: float

    @property
    def ball(self) -> tuple[Floats, float]:
        """Middle (3,) and radius of a ball around it, in the frame and the metres of the body that looks."""
        mesh = self.transfer.mesh
        return self.pose.linear @ mesh.center_m + self.pose.shift, mesh.radius_m * self.pose.scale

    def seen_from(self, transfer: Transfer, place: Floats, open_: NDArray[np.bool_]) -> tuple[NDArray[Any], ...]:
        """Return where rays from places (r, 3) of a mesh in their open directions (r, COUNT) meet the body: numbers of
        the place and the direction, the coarse sample among all, distance in metres of the mesh, and the share, each
        (m,).
        """
        found = np.empty((2, len(place) * COUNT), np.int32)
        used = _into_ball(place, open_, directions(), self._directions_near(transfer), *self.ball, found)
        sample, direction = found[:, :used]
        back = np.linalg.inv(self.pose.linear).T
        origin, rays = ((place - self.pose.shift) @ back)[sample], (directions() @ back)[direction]
        triangle = self.transfer.scene.first_hit(origin, rays)
        hit = np.flatnonzero(triangle >= 0)
        met, distance, _ = met_samples(self.transfer, origin[hit], rays[hit], triangle[hit])
        coarse_sample = (self.transfer.coarse.of[met] + self.begin).astype(np.int32)
        share = np.full(len(hit), self.share, np.float32)
        return sample[hit], direction[hit], coarse_sample, distance.astype(np.float32), share

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
        spacing, position = transfer.coarse.spacing_m, transfer.lattice.position
        (center, radius), reach = self.ball, _INTERPOLATED * spacing
        close = np.flatnonzero(np.linalg.norm(position - center, axis=-1) < radius + reach)
        there = (position[close] - self.pose.shift) @ np.linalg.inv(self.pose.linear).T
        near, _ = self.transfer.tree.query(there, distance_upper_bound=reach / self.pose.scale)
        part = np.zeros(len(position))
        part[close] = smoothstep(near * self.pose.scale / spacing, _INTERPOLATED, _EXACT)
        return part


@exact
def _into_ball(place: Any, open_: Any, d: Any, near: Any, center: Any, radius: Any, found: Any) -> Any:
    """Write sample and direction of the open rays into a ball to `found` (2, most); return how many there are."""
    total = 0
    for s in range(len(place)):
        x, y, z = center[0] - place[s, 0], center[1] - place[s, 1], center[2] - place[s, 2]
        squared = x * x + y * y + z * z
        outside = squared - radius * radius
        for k in near:
            if open_[s, k]:
                along = x * d[k, 0] + y * d[k, 1] + z * d[k, 2]
                if along * along >= outside and (along > 0.0 or outside < 0.0):
                    found[0, total], found[1, total] = s, k
                    total += 1
    return total


_SHARE_STEPS = 1 << 16


def body_views(bodies: Sequence[Body], first: NDArray[np.int64], shares: Floats, cache: Cache) -> tuple[BodyView, ...]:
    """Return what bodies see. first: (B + 1,) where the coarse samples of each begin among all. shares: (B, B), how
    much of each body is near to that of a row. A view is kept while all that it shows stay where they are to the body.
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
    """Return what a body sees of near ones. begin: where its own coarse samples begin among all, `total`."""
    body, near = seen.whole
    transfer, sample = body.transfer, body.transfer.coarse.sample
    close = np.max([np.zeros(len(transfer.cosine)), *(other.close_samples(transfer) for other in near)], axis=0)
    if transfer.mesh.glossy:
        close[:] = 1.0  # every sample has a lobe of its own
    near_sample = np.flatnonzero(close)
    at_coarse, _ = _form_factors(body, near, sample, body.own.direct, total)
    cosine = np.where(body.own.open[near_sample], transfer.cosine[near_sample], np.float32(0.0))
    at_near, node = _form_factors(body, near, near_sample, cosine, total)
    down = np.zeros((0, len(sample)), np.float32)
    if body.ground is not None and body.on_ground:
        down = body.ground.mean_sent(transfer)
    lost = (body.own.plain - body.own.direct + at_coarse.lost).sum(axis=1, keepdims=True)
    lost -= at_coarse.ground.sum(axis=1, keepdims=True)
    openness = 1.0 - lost / transfer.whole[sample, None]
    met = met_by(body, at_near, cosine, node, begin) if transfer.mesh.glossy else None
    part = close[near_sample, None].astype(np.float32)
    return BodyView(at_coarse, at_near, near_sample, part, down, openness, met)


def _form_factors(
    body: Body, near: Sequence[Neighbour], sample: NDArray[np.int64], cosine: NDArray[np.float32], total: int
) -> tuple[FormFactors, NDArray[np.int16] | None]:
    """Return what samples (r,) see where directions add `cosine` (r, COUNT), and the node of the ground in each."""
    place, open_ = body.places(sample), cosine > 0.0
    node = body.ground.node_seen(body.transfer, place) if body.ground is not None and body.on_ground else None
    hits = [other.seen_from(body.transfer, place, open_) for other in near if len(sample)]
    return form_factors(cosine, node, hits, total), node
