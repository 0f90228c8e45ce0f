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

from mr360uw.composite.ambient.body_view import Body
from mr360uw.composite.ambient.directions import SOLID_ANGLE, directions
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
directions from all places and so is near, too, in part and wholly, if it hides the following."""
_UNNOTICED, _NOTICED = 0.004, 0.008


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """Far bodies around one. cover: (COUNT,) fraction of each direction that they fill. weights: (COUNT, J) sparse, f
    above. body: (J,) their numbers; side, part: (J, 3) the sides of each that are seen, and how much they count.
    """

    cover: NDArray[np.float32]
    weights: Any
    body: NDArray[np.int64]
    side: NDArray[np.int64]
    part: Floats

    def before(self, light: Floats, sides: Floats) -> Floats:
        """Return the light (COUNT, 3) with the bodies before it. sides: (bodies, 6, 3) radiance of the sides of all."""
        sent = np.einsum("js,jsc->jc", self.part, sides[self.body[:, None], self.side])
        return np.asarray(light * (1.0 - self.cover[:, None]) + self.weights @ sent, np.float32)


def near_shares(bodies: Sequence[Body]) -> tuple[Floats, Floats]:
    """Return how much of each body (n, n) is near to the body of a row and found by rays; and how much is far."""
    center, radius = np.array([body.center for body in bodies]), np.array([body.radius for body in bodies])
    apart = np.linalg.norm(center[:, None] - center, axis=-1)
    hidden = (radius / np.maximum(apart - radius[:, None], np.maximum(radius, 1e-12))) ** 2
    casting = np.array([body.placed.casts_shadow for body in bodies]) & ~np.eye(len(bodies), dtype=bool)
    around = smoothstep(apart / radius[:, None], _LARGE, _LARGEST) * smoothstep(hidden, _UNNOTICED, _NOTICED)
    near = np.maximum(smoothstep(hidden, _NEAR, _NEAREST), around)
    return np.where(casting, near, 0.0), np.where(casting, (1.0 - near) * smoothstep(hidden, _LOST, _SEEN), 0.0)


def far_field(number: int, bodies: Sequence[Body], share: Floats) -> FarField | None:
    """Return the far bodies around one, of which shares (n,) count; None where there are none."""
    from scipy.sparse import csr_matrix

    others = np.flatnonzero(share > 0.0)
    if len(others) == 0:
        return None
    body, far = bodies[number], [bodies[k] for k in others.tolist()]
    to = np.array([other.center for other in far]) - body.center
    apart = np.linalg.norm(to, axis=-1)
    to /= apart[:, None]
    back = np.array([-way @ other.rotation for way, other in zip(to, far, strict=True)])
    area = np.array([other.transfer.sides.area_m2 * other.placed.scale**2 for other in far])
    solid_angle = share[others] * np.sum(back**2 * area, axis=-1) / apart**2
    wide = np.maximum(np.arcsin(np.minimum(np.array([other.radius for other in far]) / apart, 1.0)), _SPREAD_RAD)
    filled = np.maximum((to @ body.rotation) @ directions().T - np.cos(wide)[:, None], 0.0)
    filled = np.minimum(filled * (solid_angle / (SOLID_ANGLE * filled.sum(axis=1)))[:, None], 1.0)
    cover = 1.0 - np.prod(1.0 - filled, axis=0)
    weights = csr_matrix((filled * (cover / np.maximum(filled.sum(axis=0), 1e-12))).T.astype(np.float32))
    side = 2 * np.arange(3) + (back < 0.0)
    return FarField(cover.astype(np.float32), weights, others, side, back**2)
