# SPDX-License-Identifier: Apache-2.0
"""Light that bodies block at places of level ground, as weights on the sky: new light then costs one product.

    E_blocked = sum_(a, e) w_(a, e) Q(a, e)        Q(a, e) = int_0^e L(a, e') |sin e'| cos e' de'

with a, e the nodes of a table and w from the intervals of ground_kernel.py: +1 at the end of an interval that is
farther from the horizon, -1 at the other, times the width of the azimuth, bilinear between nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.on_ground.ground_kernel import PIECES, cut
from mr360uw.composite.ambient.on_ground.standing import Standing, Swept
from mr360uw.jit import fast
from mr360uw.types import Floats

_AT_ONCE = 1 << 16
"""Places times bodies whose intervals, 650 bytes each, are held at once."""


@dataclass(frozen=True, slots=True, eq=False)
class SkyWeights:
    """What bodies block at n places of level ground. weights: (n, nodes) of a table of `level_table`, float32, all
    bodies together. share: (bodies, n) fraction of uniform light that each blocks.
    """

    weights: NDArray[np.float32]
    share: Floats


def sky_weights(bodies: Standing, points: Floats, uniform: Floats, *, up: bool) -> SkyWeights:
    """Return what bodies block at places (n, 3), as `Standing.sweep` takes them.

    uniform: (azimuths, elevations + 1) of `level_table` for a radiance of 1. up: whether the ground is seen from above.
    """
    step = max(_AT_ONCE // max(len(bodies.fields), 1), 1)
    parts = [points[start : start + step] for start in range(0, max(len(points), 1), step)]
    found = [weights_of(bodies.sweep(part), uniform, up=up) for part in parts]
    weights = np.concatenate([one.weights for one in found])
    return SkyWeights(weights, np.concatenate([one.share for one in found], axis=1))


def weights_of(swept: Swept, uniform: Floats, *, up: bool) -> SkyWeights:
    """Return what bodies block at n places where `swept` is known; the others are those of `sky_weights`."""
    bodies, points = swept[0].shape[:2]
    weights, share = np.zeros((points, *uniform.shape), np.float32), np.zeros((bodies, points))
    _weigh(up, *swept, uniform[0] / np.pi, weights, share)
    return SkyWeights(weights.reshape(points, uniform.size), share)


@fast
def _weigh(up: Any, begins: Any, blocked: Any, uniform: Any, weights: Any, share: Any) -> None:
    """Add the weights (n, rows, columns + 1) of intervals (bodies, n, ...) of `sweep`, and the shares (bodies, n)."""
    piece = np.empty((PIECES, 2))
    rows, columns = weights.shape[1], weights.shape[2] - 1
    side = 1.0 if up else -1.0
    for k in range(len(weights)):
        for m in range(len(begins)):
            first, step = begins[m, k, 0], begins[m, k, 1]
            for number in range(2 * int(begins[m, k, 2])):
                q, part = number // 2, 2 * (number & 1)
                low, high, filled = blocked[m, k, q, part], blocked[m, k, q, part + 1], blocked[m, k, q, 4]
                low, high = (max(low, 0.0), high) if up else (low, min(high, 0.0))
                if filled <= 0.0 or high <= low:
                    continue
                azimuth = first + (q + 0.5) * step
                across = azimuth / (2.0 * np.pi) * rows - 0.5
                i = int(np.floor(across))
                u = across - i
                i = i % rows
                j = i + 1 if i + 1 < rows else 0
                pieces = cut(piece, low, high, begins[:, k], blocked[:, k], m, azimuth)
                for p in range(pieces):
                    if piece[p, 1] <= piece[p, 0]:
                        continue
                    for end in range(2):
                        w = filled * step * (side if end else -side)
                        along = min(abs(piece[p, end]) / (0.5 * np.pi) * columns, columns - 1e-6)
                        e = int(along)
                        v = along - e
                        weights[k, i, e] += w * (1.0 - u) * (1.0 - v)
                        weights[k, i, e + 1] += w * (1.0 - u) * v
                        weights[k, j, e] += w * u * (1.0 - v)
                        weights[k, j, e + 1] += w * u * v
                        share[m, k] += w * (uniform[e] * (1.0 - v) + uniform[e + 1] * v)
