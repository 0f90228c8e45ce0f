# SPDX-License-Identifier: Apache-2.0
"""What one placed body sees of itself, of other bodies and of the ground, put together from what is kept of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.among.relative_pose import rounded
from mr360uw.composite.ambient.directions import COUNT
from mr360uw.composite.ambient.mesh_transfer import OwnView, Transfer
from mr360uw.composite.ambient.on_ground.ground_view import NODES, LevelGround
from mr360uw.composite.ambient.on_ground.height_field import HeightField
from mr360uw.composite.ambient.sparse_product import product
from mr360uw.composite.shot import PlacedObject
from mr360uw.jit import exact
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A placed mesh. own: what it does to its own light. rotation: (3, 3) its axes to the world's. field: what the
    ground sees of it; None if nothing. ground: level ground below it, or None.

    center (3,), radius: of a ball around it at rest, in the world [m].
    """

    placed: PlacedObject
    transfer: Transfer
    own: OwnView
    rotation: Floats
    field: HeightField | None
    ground: LevelGround | None
    center: Floats
    radius: float

    @property
    def origin(self) -> Floats:
        """Place (3,) of the body's origin in the world."""
        return self.placed.world_from_object[:3, 3]

    def inside(self, points: Floats) -> Floats:
        """Return points (n, 3) of the world in the body's axes, rounded: what is found there may be kept under them."""
        local = (points - self.origin) @ self.rotation / self.placed.scale
        return rounded(local, self.transfer.mesh.radius_m)

    def places(self, sample: NDArray[np.int64]) -> Floats:
        """Return where rays from samples (n,) start (n, 3) in the body's axes: not below the ground."""
        position = self.transfer.lattice.position[sample]
        return position if self.ground is None else self.ground.lifted(self.transfer, position)

    @property
    def sunk_key(self) -> bytes:
        """Key of the ground where it covers a part of the body, nothing otherwise."""
        ground = self.ground
        return b"" if ground is None or not ground.covers(self.transfer) else ground.key

    @property
    def ground_key(self) -> bytes:
        """Key of the ground where it matters to what the body sees, nothing otherwise."""
        return self.ground.key if self.ground is not None and self.on_ground else self.sunk_key

    @property
    def on_ground(self) -> bool:
        """Whether body and ground see each other."""
        return self.field is not None and self.ground is not None and self.ground.near(self.transfer)


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


@dataclass(frozen=True, slots=True, eq=False)
class Met:
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
    """What the samples of one body see. coarse: of its coarse samples. near: of samples near other bodies, near_site
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
        return not body.on_ground and self.coarse.samples.nnz + self.near.samples.nnz == 0 and body.own.lost is None

    def spread(self, body: Body, at_coarse: Floats, at_near: Floats) -> Floats:
        """Return values (S, n) at all samples from those at the coarse samples (C, n) and at the near samples (e,
        n)."""
        values = product(body.transfer.coarse.spread, at_coarse.astype(np.float32))
        values[self.near_sample] += self.near_part * (at_near - values[self.near_sample])
        return values


def form_factors(
    cosine: NDArray[np.float32], node: NDArray[np.int16] | None, hits: list[tuple[NDArray[Any], ...]], total: int
) -> FormFactors:
    """Return what r samples of a body see. cosine: (r, COUNT) irradiance that open directions add; node: (r, COUNT) the
    node of the ground behind each, -1 for none, or None without nodes; hits: of `Neighbour.seen_from` for each other
    body; total: number of all coarse samples.
    """
    from scipy.sparse import csr_matrix

    none = *(np.zeros(0, np.int32) for _ in range(3)), *(np.zeros(0, np.float32) for _ in range(2))
    sample, direction, met, distance, share = (np.concatenate(columns) for columns in zip(none, *hits, strict=True))
    rows = len(cosine)
    lost, ground = np.zeros((rows, COUNT), np.float32), np.zeros((rows, 0 if node is None else NODES**2), np.float32)
    begin, column = np.zeros(rows + 1, np.int64), np.zeros(len(sample), np.int32)
    weight, way = np.zeros(len(sample), np.float32), np.zeros(len(sample), np.int16)
    if node is not None or len(sample):
        behind = np.full(cosine.shape, -1, np.int16) if node is None else node
        _resolve(
            cosine, behind, sample, direction, met, distance, share, lost, ground, begin, column, weight, way
        )  # fmt: skip
    used = int(begin[-1])
    samples = csr_matrix((weight[:used], column[:used], begin), shape=(rows, total))
    return FormFactors(lost, samples, way[:used], ground)


@exact
def _resolve(
    cosine: Any, node: Any, sample: Any, direction: Any, met: Any, distance: Any, share: Any,
    lost: Any, ground: Any, begin: Any, column: Any, weight: Any, way: Any,
) -> None:  # fmt: skip
    """Share the light of each direction among what rays (m,) meet there, the nearest first, and the ground behind.

    cosine, node: (r, COUNT). lost, ground, way, and begin, column, weight of a sparse matrix: as `FormFactors` has
    them.
    """
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
