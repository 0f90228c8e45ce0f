# SPDX-License-Identifier: Apache-2.0
"""The one pass over a decoded frame: Y'CbCr planes to a small map of linear, expanded radiance.

Each luma sample is turned into R'G'B' with the chroma of its 2 x 2 block, decoded by a polynomial, expanded by a
table of gains (one for each luma code) and added to its block with the weight of its row's solid angle. Nothing of
the size of the frame is written. Loops run along whole rows so that the compiler can use vector instructions.
"""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.color import Transfer, decode

_DEGREE = 6
_TOP = 1.1  # headroom of limited range video above white


@functools.cache
def decode_polynomial(transfer: Transfer) -> NDArray[np.float32]:
    """Return (toe, slope, c1 .. c6): linear light is slope x below `toe` and c1 x + .. + c6 x^6 above, x in [0, 1.1].

    Fitted to `color.decode`, within 0.5 % of the value above a code value of 0.1 and 0.001 everywhere.
    """
    toe = {"srgb": 0.04045, "bt709": 0.081}.get(transfer, 0.0)
    x = np.linspace(max(toe, 1e-3), _TOP, 2000)
    linear = decode(x, transfer)
    weight = 1.0 / (linear + 0.01)
    powers = x[:, None] ** np.arange(1, _DEGREE + 1)
    coefficients = np.linalg.lstsq(powers * weight[:, None], linear * weight, rcond=None)[0]
    slope = float(decode(np.array(0.5 * toe), transfer)) / (0.5 * toe) if toe else 0.0
    return np.array([toe, slope, *coefficients], np.float32)


@numba.njit(nogil=True, cache=True, fastmath={"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"})  # type: ignore[untyped-decorator, unused-ignore]
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
    row_region: NDArray[np.float32],  # (H,) how far the expansion acts
    block: int,
    total: NDArray[np.float32],  # (H/block, W/block, 3) out: mean expanded linear radiance
    brightest: NDArray[Any],  # (H/block, W/block) out: largest luma code
) -> None:
    """Fill `total` and `brightest` from the planes of a 4:2:0 frame whose sides are multiples of an even `block`."""
    height, width = y.shape
    half = width // 2
    scale, shift = luma[0], luma[1]
    neutral, r_v, g_u, g_v, b_u = chroma[0], chroma[1], chroma[2], chroma[3], chroma[4]
    toe, slope = curve[0], curve[1]
    c1, c2, c3, c4, c5, c6 = curve[2], curve[3], curve[4], curve[5], curve[6], curve[7]
    zero, top = np.float32(0.0), np.float32(1.1)
    dr = np.empty(width, np.float32)
    dg = np.empty(width, np.float32)
    db = np.empty(width, np.float32)
    code = np.empty(width, np.int32)
    weight = np.empty(width, np.float32)
    red = np.empty(width, np.float32)
    green = np.empty(width, np.float32)
    blue = np.empty(width, np.float32)
    peak = np.empty(width, y.dtype)
    for band in range(height // block):
        red[:] = zero
        green[:] = zero
        blue[:] = zero
        peak[:] = 0
        for row in range(band * block, (band + 1) * block):
            if row % 2 == 0:
                for k in range(half):
                    du = np.float32(u[row // 2, k]) - neutral
                    dv = np.float32(v[row // 2, k]) - neutral
                    dr[2 * k] = dr[2 * k + 1] = dv * r_v
                    dg[2 * k] = dg[2 * k + 1] = du * g_u + dv * g_v
                    db[2 * k] = db[2 * k + 1] = du * b_u
                    code[2 * k] = code[2 * k + 1] = margin + int(du * tint[0] + dv * tint[1])
            region = row_region[row] * row_weight[row]
            if region == zero:
                weight[:] = row_weight[row]
            else:
                for i in range(width):
                    weight[i] = row_weight[row] + region * gain[code[i] + y[row, i]]
            for i in range(width):
                peak[i] = max(peak[i], y[row, i])
                value = np.float32(y[row, i]) * scale + shift
                x = min(max(value + dr[i], zero), top)
                curved = x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * c6)))))
                red[i] += weight[i] * (curved if x > toe else slope * x)
                x = min(max(value + dg[i], zero), top)
                curved = x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * c6)))))
                green[i] += weight[i] * (curved if x > toe else slope * x)
                x = min(max(value + db[i], zero), top)
                curved = x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * c6)))))
                blue[i] += weight[i] * (curved if x > toe else slope * x)
        for k in range(width // block):
            r, g, b = zero, zero, zero
            high = peak[k * block]
            for i in range(k * block, (k + 1) * block):
                r += red[i]
                g += green[i]
                b += blue[i]
                high = max(high, peak[i])
            total[band, k, 0], total[band, k, 1], total[band, k, 2] = r, g, b
            brightest[band, k] = high
