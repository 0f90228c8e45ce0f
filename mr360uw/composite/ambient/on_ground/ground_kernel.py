# SPDX-License-Identifier: Apache-2.0
"""Ambient light that bodies block at places: for every azimuth the interval of elevations that a sweep over a body's
lower and upper heights finds, and closed integrals over it.

    E_blocked = sum_a width_a sum_c n_c (P(a, hi) - P(a, lo))_c        P(a, e) = int_{-pi/2}^e L(a, e') d cos(e') de'

with d the unit direction and n the normal; the interval is cut at the place's own horizon. Where bodies stand behind
each other, a later one adds what the earlier ones leave of its interval.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.constants import BRIGHTEST, DARK
from mr360uw.jit import fast, inlined
from mr360uw.types import Floats

UNNOTICED, NOTICED = 0.012, 0.036
"""A body that blocks less than the first fraction of the ambient light leaves it: a code value of 8 bits over metres;
from the second on it shows whole."""

PIECES = 8


def shown(blocked: Floats) -> Floats:
    """Return the part (...,) of a change on the ground that is shown where bodies block a fraction `blocked`.

    It fades to nothing at `UNNOTICED`, so that a body changes a bounded part of the receiver.
    """
    t = np.clip((blocked - UNNOTICED) / (NOTICED - UNNOTICED), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def fraction_left(blocked: Floats, lost: Floats, whole: Floats) -> Floats:
    """Return the fraction (n, 3) of the ambient irradiance `whole` that is left on the ground without `lost`.

    blocked: (n,) fraction of uniform light that bodies block. `lost` and `whole` are sums over different pixels, so
    that under bodies that block all of a spotted sky more may be lost than there was: nothing is left then. Bodies that
    shine add `BRIGHTEST` times the plate's light at most.
    """
    left = 1.0 - shown(blocked)[:, None] * lost / np.maximum(whole, DARK)
    return np.asarray(np.clip(left, 0.0, BRIGHTEST))


@inlined
def _at_azimuth(begins: Any, azimuth: Any) -> Any:
    """Return the number of a body's azimuth within which another lies, -1 for none."""
    turn = azimuth - begins[0]
    turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi))
    place = turn / begins[1] if begins[1] > 0.0 else 1e9
    return int(place) if place < begins[2] else -1


@inlined
def _add_sums(table: Any, azimuth: Any, elevation: Any, weights: Any, factor: Any, out: Any) -> None:
    """Add factor times weights.P at an azimuth and an elevation to `out` (channels,)."""
    rows, columns = table.shape[0], table.shape[1] - 1
    across = azimuth / (2.0 * np.pi) * rows - 0.5
    i = int(np.floor(across))
    u = across - i
    i = i % rows
    j = i + 1 if i + 1 < rows else 0
    along = min(max((elevation / np.pi + 0.5) * columns, 0.0), columns - 1e-6)
    k = int(along)
    v = along - k
    for c in range(table.shape[2]):
        w = factor * weights[c]
        w00, w01, w10, w11 = w * (1.0 - u) * (1.0 - v), w * (1.0 - u) * v, w * u * (1.0 - v), w * u * v
        for channel in range(table.shape[3]):
            here = w00 * table[i, k, c, channel] + w01 * table[i, k + 1, c, channel]
            out[channel] += here + w10 * table[j, k, c, channel] + w11 * table[j, k + 1, c, channel]


@inlined
def cut(piece: Any, low: Any, high: Any, begins: Any, blocked: Any, m: Any, azimuth: Any) -> Any:
    """Set the pieces of an interval that the bodies before the m-th leave at an azimuth; return how many there are."""
    piece[0, 0], piece[0, 1] = low, high
    pieces = 1
    for j in range(m):
        q = _at_azimuth(begins[j], azimuth) if begins[j, 2] > 0.0 else -1
        for i in range(2 if q >= 0 else 0):
            taken, until, share = blocked[j, q, 2 * i], blocked[j, q, 2 * i + 1], blocked[j, q, 4]
            middle = 0.5 * (taken + until)
            taken, until = middle + share * (taken - middle), middle + share * (until - middle)
            if until <= taken:
                continue
            for p in range(pieces):
                a, b = piece[p, 0], piece[p, 1]
                if taken < b and until > a:
                    if taken > a:
                        piece[p, 1] = taken
                        if until < b and pieces < PIECES:
                            piece[pieces, 0], piece[pieces, 1] = until, b
                            pieces += 1
                    else:
                        piece[p, 0] = min(until, b)
    return pieces


@inlined
def _horizon(normal: Any, azimuth: Any, low: Any, high: Any) -> Any:
    """Return the part of an interval of elevations above the horizon of a place with a normal (3,)."""
    level = normal[0] * np.cos(azimuth) + normal[2] * np.sin(azimuth)
    if normal[1] > 1e-9:
        low = max(low, np.arctan(-level / normal[1]))
    elif normal[1] < -1e-9:
        high = min(high, np.arctan(-level / normal[1]))
    elif level <= 0.0:
        high = low
    return low, high


@fast
def gather(normal: Any, weights: Any, begins: Any, blocked: Any, table: Any, out: Any) -> None:
    """Add what bodies block at places with normals (n, 3) to `out` (bodies, n, channels).

    begins, blocked: (bodies, n, ...) of `sweep`. table: (azimuths, elevations + 1, 3, channels), P of the light, and
    weights (n, 3) the normals; or both of one component, where the normals are the same and P is taken along them.
    """
    piece = np.empty((PIECES, 2))
    for k in range(len(normal)):
        upright = normal[k, 0] == 0.0 and normal[k, 2] == 0.0 and normal[k, 1] > 0.0
        for m in range(len(begins)):
            first, step = begins[m, k, 0], begins[m, k, 1]
            for q in range(2 * int(begins[m, k, 2])):
                i = 2 * (q & 1)
                low, high, share = blocked[m, k, q // 2, i], blocked[m, k, q // 2, i + 1], blocked[m, k, q // 2, 4]
                if share <= 0.0 or high <= low:
                    continue
                azimuth = first + (q // 2 + 0.5) * step
                if upright:
                    low = max(low, 0.0)
                else:
                    low, high = _horizon(normal[k], azimuth, low, high)
                if high <= low:
                    continue
                pieces = cut(piece, low, high, begins[:, k], blocked[:, k], m, azimuth)
                for p in range(pieces):
                    if piece[p, 1] > piece[p, 0]:
                        _add_sums(table, azimuth, piece[p, 1], weights[k], share * step, out[m, k])
                        _add_sums(table, azimuth, piece[p, 0], weights[k], -share * step, out[m, k])
