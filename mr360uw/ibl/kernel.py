# SPDX-License-Identifier: Apache-2.0
"""The one pass over a decoded frame: Y'CbCr planes to a small map of linear, expanded radiance.

Each luma sample is turned into R'G'B' with the chroma of its 2 x 2 block, decoded by a polynomial, expanded by a
table of gains (one for each luma code) and added to its block with the weight of its row's solid angle. Nothing of
the size of the frame is written. Loops run along two whole rows, which share their chroma, so that the compiler can use
vector instructions; what it cannot turn into them, the look-up of gains, has a loop of its own.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.color import Transfer, decode

_DEGREE = 6
_TOP = np.float32(1.1)  # headroom of limited range video above white
_ZERO = np.float32(0.0)
_FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}


@functools.cache
def decode_polynomial(transfer: Transfer) -> NDArray[np.float32]:
    """Return (slope, c1 .. c6): linear light is x max(slope, c1 + .. + c6 x^5) for code values x in [0, 1.1].

    Fitted to `color.decode`, within 0.8 % of the value above a code value of 0.1, 0.1 % in the mean; the slope is that
    of the toe, below which the sum falls there.
    """
    toe = {"srgb": 0.04045, "bt709": 0.081}.get(transfer, 0.0)
    x = np.linspace(max(toe, 1e-3), _TOP, 2000)
    linear = decode(x, transfer)
    weight = 1.0 / (linear + 0.01)
    powers = x[:, None] ** np.arange(1, _DEGREE + 1)
    coefficients = np.linalg.lstsq(powers * weight[:, None], linear * weight, rcond=None)[0]
    slope = float(decode(np.array(0.5 * toe), transfer)) / (0.5 * toe) if toe else 0.0
    return np.array([slope, *coefficients], np.float32)


@numba.njit(inline="always", fastmath=_FAST)  # type: ignore[untyped-decorator, unused-ignore]
def _decoded(x: Any, slope: Any, c1: Any, c2: Any, c3: Any, c4: Any, c5: Any, c6: Any) -> Any:
    x = min(max(x, _ZERO), _TOP)
    return x * max(c1 + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * c6)))), slope)


@numba.njit(nogil=True, cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator, unused-ignore]
def reduce_planes(
    y: NDArray[Any],
    u: NDArray[Any],
    v: NDArray[Any],
    luma: NDArray[np.float32],  # (scale, shift): Y' = code x scale + shift
    chroma: NDArray[np.float32],  # (neutral code, R'/V, G'/U, G'/V, B'/U)
    curve: NDArray[np.float32],  # decode_polynomial
    gain: NDArray[np.float32],  # gain - 1 of every code of the operator's luma, `margin` codes more on either side
    margin: int,
    tint: NDArray[np.float32],  # codes that the operator's luma differs from Y' by, for each unit of (U, V)
    row_weight: NDArray[np.float32],  # (H,) solid angle over that of the block
    region: NDArray[np.float32],  # (r, c) how far the expansion acts, over equal parts of the frame; c = 1: by row
    block: int,
    total: NDArray[np.float32],  # (H/block, W/block, 3) out: mean expanded linear radiance
    brightest: NDArray[Any],  # (H/block, W/block) out: largest luma code
) -> None:
    """Fill `total` and `brightest` from the planes of a 4:2:0 frame whose sides are multiples of an even `block`."""
    height, width = y.shape
    half, cells = width // 2, region.shape[1]
    scale, shift = luma[0], luma[1]
    neutral, r_v, g_u, g_v, b_u = chroma[0], chroma[1], chroma[2], chroma[3], chroma[4]
    slope, c1, c2, c3, c4, c5, c6 = curve[0], curve[1], curve[2], curve[3], curve[4], curve[5], curve[6]
    dr, dg, db = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    red, green, blue = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    weight_a, weight_b = np.empty(width, np.float32), np.empty(width, np.float32)
    code = np.empty(width, np.uint32)
    place_a, place_b = np.empty(width, np.uint32), np.empty(width, np.uint32)
    peak = np.empty(width, y.dtype)
    for band in range(height // block):
        red[:] = _ZERO
        green[:] = _ZERO
        blue[:] = _ZERO
        peak[:] = 0
        for row in range(band * block, (band + 1) * block, 2):
            ya, yb = y[row], y[row + 1]
            for k in range(half):
                du = np.float32(u[row // 2, k]) - neutral
                dv = np.float32(v[row // 2, k]) - neutral
                dr[2 * k] = dr[2 * k + 1] = shift + dv * r_v
                dg[2 * k] = dg[2 * k + 1] = shift + du * g_u + dv * g_v
                db[2 * k] = db[2 * k + 1] = shift + du * b_u
            wa, wb = row_weight[row], row_weight[row + 1]
            acts_a, acts_b = region[row * len(region) // height], region[(row + 1) * len(region) // height]
            if cells == 1 and acts_a[0] == _ZERO and acts_b[0] == _ZERO:
                weight_a[:] = wa
                weight_b[:] = wb
            else:
                for k in range(half):
                    du = np.float32(u[row // 2, k]) - neutral
                    dv = np.float32(v[row // 2, k]) - neutral
                    code[2 * k] = code[2 * k + 1] = margin + int(du * tint[0] + dv * tint[1])
                for i in range(width):
                    place_a[i] = code[i] + ya[i]
                    place_b[i] = code[i] + yb[i]
                for k in range(cells):
                    share_a, share_b = wa * acts_a[k], wb * acts_b[k]
                    for i in range(k * width // cells, (k + 1) * width // cells):
                        weight_a[i] = wa + share_a * gain[place_a[i]]
                        weight_b[i] = wb + share_b * gain[place_b[i]]
            for i in range(width):
                peak[i] = max(peak[i], ya[i], yb[i])
            for i in range(width):
                a, b = np.float32(ya[i]) * scale, np.float32(yb[i]) * scale
                p = _decoded(a + dr[i], slope, c1, c2, c3, c4, c5, c6)
                q = _decoded(b + dr[i], slope, c1, c2, c3, c4, c5, c6)
                red[i] += weight_a[i] * p + weight_b[i] * q
                p = _decoded(a + dg[i], slope, c1, c2, c3, c4, c5, c6)
                q = _decoded(b + dg[i], slope, c1, c2, c3, c4, c5, c6)
                green[i] += weight_a[i] * p + weight_b[i] * q
                p = _decoded(a + db[i], slope, c1, c2, c3, c4, c5, c6)
                q = _decoded(b + db[i], slope, c1, c2, c3, c4, c5, c6)
                blue[i] += weight_a[i] * p + weight_b[i] * q
        for k in range(width // block):
            r, g, b = _ZERO, _ZERO, _ZERO
            high = peak[k * block]
            for i in range(k * block, (k + 1) * block):
                r += red[i]
                g += green[i]
                b += blue[i]
                high = max(high, peak[i])
            total[band, k, 0], total[band, k, 1], total[band, k, 2] = r, g, b
            brightest[band, k] = high


@numba.njit(nogil=True, cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator, unused-ignore]
def _bilinear(plane: NDArray[Any], x: float, y: float) -> Any:
    """Return a plane at x in [0, W], y in [0, H]: periodic across the seam, the nearest row at the poles."""
    height, width = plane.shape
    x, y = x - 0.5, min(max(y - 0.5, 0.0), height - 1.0)
    left, top = math.floor(x), int(y)
    fx, fy = x - left, y - top
    right, bottom = left + 1 if left + 1 < width else 0, min(top + 1, height - 1)
    left = left if left >= 0 else width - 1
    upper = plane[top, left] * (1.0 - fx) + plane[top, right] * fx
    lower = plane[bottom, left] * (1.0 - fx) + plane[bottom, right] * fx
    return upper * (1.0 - fy) + lower * fy


@numba.njit(nogil=True, cache=True, fastmath=_FAST)  # type: ignore[untyped-decorator, unused-ignore]
def sample_planes(
    direction: NDArray[np.float64],  # (n, 3)
    y: NDArray[Any],
    u: NDArray[Any],
    v: NDArray[Any],
    luma: NDArray[np.float32],
    chroma: NDArray[np.float32],  # both as in `reduce_planes`
    table: NDArray[np.float32],  # linear light at code values k/steps
    steps: float,
    linear: NDArray[np.float32],  # (n, 3) out
) -> None:
    """Fill `linear` with the light of a 4:2:0 frame in `direction`, chroma interpolated."""
    height, width = y.shape
    last = len(table) - 1.0
    for i in range(len(direction)):
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        px = width * (math.atan2(dx, -dz) / (2.0 * math.pi) + 0.5)
        py = height * (0.5 - math.atan2(dy, math.sqrt(dx * dx + dz * dz)) / math.pi)
        # chroma is sited on the left luma sample of its pair, and half way between its two rows
        cb = _bilinear(u, 0.5 * px + 0.25, 0.5 * py) - chroma[0]
        cr = _bilinear(v, 0.5 * px + 0.25, 0.5 * py) - chroma[0]
        code = _bilinear(y, px, py) * luma[0] + luma[1]
        linear[i, 0] = table[int(min(max((code + cr * chroma[1]) * steps + 0.5, 0.0), last))]
        linear[i, 1] = table[int(min(max((code + cb * chroma[2] + cr * chroma[3]) * steps + 0.5, 0.0), last))]
        linear[i, 2] = table[int(min(max((code + cb * chroma[4]) * steps + 0.5, 0.0), last))]
