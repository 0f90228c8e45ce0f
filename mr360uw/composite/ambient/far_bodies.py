# SPDX-License-Identifier: Apache-2.0
"""Far bodies: what each hides and sends, as its six silhouettes tell it, seen from the middle of another body.

    A'_k = (1 - c_k) A_k + sum_j f_kj B_j        c_k = 1 - prod_j (1 - w_kj)        f_kj = w_kj c_k/sum_j w_kj

with k the directions of `directions.py`, A the environment, B_j the mean radiance that body j sends to the middle, and
w_kj the fraction of the direction's solid angle that it fills: its own is spread over the directions about its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.body import Body
from mr360uw.composite.ambient.directions import COUNT, SOLID_ANGLE, directions
from mr360uw.jit import exact
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

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

    def around(self, number: int) -> bool:
        """Return whether there are any far bodies around one."""
        place = int(np.searchsorted(self.lit, number))
        return place < len(self.lit) and bool(self.lit[place] == number)

    def before(self, light: NDArray[np.float32], sides: Floats) -> NDArray[np.float32]:
        """Return the light (B, COUNT, 3) with the far bodies before it. sides: (B, 6, 3) radiance of their sides."""
        sent = np.einsum("ps,psc->pc", self.part, sides[self.other[:, None], self.side]).astype(np.float32)
        found = light * (1.0 - self.cover[..., None])
        _add_sent(self.lit, self.begin, self.direction, self.weight, sent, found)
        return found


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
    _spread(lit, towards, np.cos(wide), solid_angle / SOLID_ANGLE, directions(), begin, direction, weight, cover)
    used, side = int(begin[-1]), 2 * np.arange(3) + (back < 0.0)
    return FarBodies(lit, other, side, back**2, begin, direction[:used].copy(), weight[:used].copy(), cover)


@exact
def _spread(
    lit: Any, towards: Any, cosine: Any, filled: Any, d: Any, begin: Any, direction: Any, weight: Any, cover: Any
) -> None:
    """Set begin, direction, weight and cover of `FarBodies`.

    towards: (P, 3) in the axes of the body that is lit. cosine: (P,) of the angle that the other is spread over.
    filled: (P,) its solid angle over that of a direction. d: (COUNT, 3).
    """
    used, first = 0, 0
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
