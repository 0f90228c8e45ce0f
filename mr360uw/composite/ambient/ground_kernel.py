# SPDX-License-Identifier: Apache-2.0
"""Ambient light that bodies block at places: for every azimuth the interval of elevations that a sweep over a body's
lower and upper heights finds, and closed integrals over it.

    E_blocked = sum_a width_a sum_c n_c (P(a, hi) - P(a, lo))_c        P(a, e) = int_{-pi/2}^e L(a, e') d cos(e') de'

with d the unit direction and n the normal; the interval is cut at the place's own horizon. Where bodies stand behind
each other, a later one adds what the earlier ones leave of its interval.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from mr360uw.composite.ambient.body_bound import most_blocked
from mr360uw.types import Floats

AZIMUTHS = 32
"""Azimuths over the width of a body, from a place. A wall's end is off by half a step: a hundredth at its foot."""
UNNOTICED, NOTICED = 0.012, 0.036
"""A body that blocks less than the first fraction of the ambient light leaves it: a code value of 8 bits over metres;
from the second on it shows whole."""
_HALF = 0.5
PIECES = 8
_UNSEEN = 0.003
"""A body that cannot block more than this fraction is passed over: far less than what is shown of one."""
_HALVED, _QUARTERED, _STRIDE_HALVED = 2.0, 4.5, 4.0
"""From so many half widths on, half and a quarter of the azimuths do, and half of the steps along them."""


def shown(blocked: Floats) -> Floats:
    """Return the part (...,) of a change on the ground that is shown where bodies block a fraction `blocked`.

    It fades to nothing at `UNNOTICED`, so that a body changes a bounded part of the receiver.
    """
    t = np.clip((blocked - UNNOTICED) / (NOTICED - UNNOTICED), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


_compiled = numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
_inlined = numba.njit(fastmath=True, error_model="numpy", inline="always")


@_inlined  # type: ignore[untyped-decorator, unused-ignore]
def _width_at(a: Any, b: Any, hu: Any, hv: Any) -> Any:
    """Return the first azimuth of a rectangle about the origin, and its width, as seen from a place in its plane."""
    first, width = -np.pi, 2.0 * np.pi
    if abs(a) > hu or abs(b) > hv:
        middle = np.arctan2(-b, -a)
        least, most = 0.0, 0.0
        for c in range(4):
            away = np.arctan2((hv if c & 1 else -hv) - b, (hu if c & 2 else -hu) - a) - middle
            away -= 2.0 * np.pi * np.floor(away / (2.0 * np.pi) + 0.5)
            least, most = min(least, away), max(most, away)
        first, width = middle + least, most - least
    return first, width


@_inlined  # type: ignore[untyped-decorator, unused-ignore]
def _slopes(cells: Any, y: Any, begin: Any, end: Any, stride: Any, at: Any, steps: Any) -> Any:
    """Return the least and the greatest slope at which a place at height y meets a body along a ray, and how much of
    a cell is covered at most; at, steps: the ray's begin and stride in cells.
    """
    n = cells.shape[0] - 2
    low, high, most = 1e30, -1e30, 0.0
    ga, gb = at
    before, s_before, lower_before, upper_before = 0.0, begin, 0.0, 0.0
    for turn_number in range(int((end - begin) / stride) + 2):
        s = begin + turn_number * stride
        ia, ib = min(max(int(ga), 0), n), min(max(int(gb), 0), n)
        u, v = min(max(ga - ia, 0.0), 1.0), min(max(gb - ib, 0.0), 1.0)
        ga += steps[0]
        gb += steps[1]
        w00, w01, w10, w11 = (1.0 - u) * (1.0 - v), (1.0 - u) * v, u * (1.0 - v), u * v
        p00, p01, p10, p11 = cells[ia, ib], cells[ia, ib + 1], cells[ia + 1, ib], cells[ia + 1, ib + 1]
        covered = w00 * p00[0] + w01 * p01[0] + w10 * p10[0] + w11 * p11[0]
        if covered <= 0.25 and before < _HALF:
            before, s_before = covered, s
            continue
        lower = w00 * p00[1] + w01 * p01[1] + w10 * p10[1] + w11 * p11[1] - y
        upper = w00 * p00[2] + w01 * p01[2] + w10 * p10[2] + w11 * p11[2] - y
        if (covered >= _HALF) != (before >= _HALF) and turn_number > 0:
            t = (_HALF - before) / (covered - before)
            if before <= 0.25:  # heights beside the body are those of its edge
                lower_before, upper_before = lower, upper
            away = 1.0 / max(s_before + (s - s_before) * t, 1e-9)
            low = min(low, (lower_before + t * (lower - lower_before)) * away)
            high = max(high, (upper_before + t * (upper - upper_before)) * away)
        most = max(most, covered)
        if covered >= _HALF or high < low:
            away = 1.0 / max(s, 1e-9)
            low, high = min(low, lower * away), max(high, upper * away)
        before, s_before, lower_before, upper_before = covered, s, lower, upper
    return low, high, most


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def sweep(point: Any, origin: Any, frame: Any, cells: Any, begins: Any, blocked: Any) -> None:
    """Find what a body blocks at places (n, 3), from `origin` (3,) as heights are.

    frame, cells: of `HeightField`. begins: (n, 3), the first azimuth [rad], the width of one, from +x to +z,
    and how many there are. blocked: (n, AZIMUTHS, 3), lowest and highest elevation [rad], and the fraction of the
    azimuth's width.
    """
    n = cells.shape[0] - 2
    ux, uz, hu, hv = frame[2], frame[3], frame[4], frame[5]
    turn = np.arctan2(uz, ux)
    cu, cv = 2.0 * hu / n, 2.0 * hv / n
    highest, wide_squared = cells[..., 2].max(), hu * hu + hv * hv
    radius_squared = wide_squared + (highest - cells[..., 1].min()) ** 2 / 4.0
    for k in range(len(point)):
        x, y, z = point[k, 0] - origin[0] - frame[0], point[k, 1] - origin[1], point[k, 2] - origin[2] - frame[1]
        a, b = x * ux + z * uz, z * ux - x * uz
        begins[k, 2] = 0.0
        squared = a * a + b * b
        beside = max(abs(a) - hu, 0.0) ** 2 + max(abs(b) - hv, 0.0) ** 2
        if most_blocked(squared, beside, wide_squared, highest - y) < _UNSEEN:
            continue
        apart = squared / radius_squared
        fewer = 4 if apart > _QUARTERED * _QUARTERED else 2 if apart > _HALVED * _HALVED else 1
        count, stride_cells = AZIMUTHS // fewer, 2.0 if apart > _STRIDE_HALVED * _STRIDE_HALVED else 1.0
        first, width = _width_at(a, b, hu, hv)
        step = width / count
        begins[k, 0], begins[k, 1], begins[k, 2] = first + turn, step, count
        for q in range(count):
            angle = first + (q + 0.5) * step
            da, db = np.cos(angle), np.sin(angle)
            inverse_a, inverse_b = 1.0 / da if abs(da) > 1e-12 else 1e12, 1.0 / db if abs(db) > 1e-12 else 1e12
            a0, a1, b0, b1 = (-hu - a) * inverse_a, (hu - a) * inverse_a, (-hv - b) * inverse_b, (hv - b) * inverse_b
            begin = max(min(a0, a1), min(b0, b1), 0.0)
            end = min(max(a0, a1), max(b0, b1))
            low, high, most = 1e30, -1e30, 0.0
            if end > begin:
                stride = stride_cells / max(abs(da) / cu, abs(db) / cv)
                at = (a + begin * da + hu) / cu + 0.5, (b + begin * db + hv) / cv + 0.5
                steps = stride * da / cu, stride * db / cv
                low, high, most = _slopes(cells, y, begin, end, stride, at, steps)
            if high < low or most <= 0.25:
                blocked[k, q, 0] = blocked[k, q, 1] = blocked[k, q, 2] = 0.0
            else:
                blocked[k, q, 0], blocked[k, q, 1] = np.arctan(low), np.arctan(high)
                blocked[k, q, 2] = min(max(2.0 * most - 0.5, 0.0), 1.0)


@_inlined  # type: ignore[untyped-decorator, unused-ignore]
def _at_azimuth(begins: Any, blocked: Any, azimuth: Any) -> Any:
    """Return (lowest, highest) elevation that a body blocks at an azimuth, equal for none."""
    turn = azimuth - begins[0]
    turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi))
    place = turn / begins[1] if begins[1] > 0.0 else 1e9
    if place >= begins[2]:
        return 0.0, 0.0
    q = int(place)
    share = blocked[q, 2]
    middle = 0.5 * (blocked[q, 0] + blocked[q, 1])
    return middle + share * (blocked[q, 0] - middle), middle + share * (blocked[q, 1] - middle)


@_inlined  # type: ignore[untyped-decorator, unused-ignore]
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


@_inlined  # type: ignore[untyped-decorator, unused-ignore]
def cut(piece: Any, low: Any, high: Any, begins: Any, blocked: Any, m: Any, azimuth: Any) -> Any:
    """Set the pieces of an interval that the bodies before the m-th leave at an azimuth; return how many there are."""
    piece[0, 0], piece[0, 1] = low, high
    pieces = 1
    for j in range(m):
        if begins[j, 2] == 0.0:
            continue
        taken, until = _at_azimuth(begins[j], blocked[j], azimuth)
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


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def gather(normal: Any, weights: Any, begins: Any, blocked: Any, table: Any, out: Any) -> None:
    """Add what bodies block at places with normals (n, 3) to `out` (bodies, n, channels).

    begins, blocked: (bodies, n, ...) of `sweep`. table: (azimuths, elevations + 1, 3, channels), P of the light, and
    weights (n, 3) the normals; or both of one component, where the normals are the same and P is taken along them.
    """
    piece = np.empty((PIECES, 2))
    for k in range(len(normal)):
        nx, ny, nz = normal[k, 0], normal[k, 1], normal[k, 2]
        upright = nx == 0.0 and nz == 0.0 and ny > 0.0
        for m in range(len(begins)):
            first, step = begins[m, k, 0], begins[m, k, 1]
            for q in range(int(begins[m, k, 2])):
                share = blocked[m, k, q, 2]
                if share <= 0.0:
                    continue
                azimuth = first + (q + 0.5) * step
                low, high = blocked[m, k, q, 0], blocked[m, k, q, 1]
                if upright:
                    low = max(low, 0.0)
                else:
                    level = nx * np.cos(azimuth) + nz * np.sin(azimuth)
                    if ny > 1e-9:
                        low = max(low, np.arctan(-level / ny))
                    elif ny < -1e-9:
                        high = min(high, np.arctan(-level / ny))
                    elif level <= 0.0:
                        continue
                if high <= low:
                    continue
                pieces = cut(piece, low, high, begins[:, k], blocked[:, k], m, azimuth)
                for p in range(pieces):
                    if piece[p, 1] > piece[p, 0]:
                        _add_sums(table, azimuth, piece[p, 1], weights[k], share * step, out[m, k])
                        _add_sums(table, azimuth, piece[p, 0], weights[k], -share * step, out[m, k])
