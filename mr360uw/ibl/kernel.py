# SPDX-License-Identifier: Apache-2.0
"""Block means of linear radiance, in one pass over the Y'CbCr planes of a decoded frame.

Each luma sample is turned into R'G'B' with the chroma of its 2 x 2 block, decoded by the decoder's polynomial and added
to its block with the weight of its row's solid angle. Nothing of the size of the frame is written. Loops run along two
whole rows, which share their chroma, so that the compiler can use vector instructions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import fast, inlined
from mr360uw.yuv.decode_kernels import polynomial_light

_ZERO = np.float32(0.0)


@inlined
def _chroma_parts(u: Any, v: Any, folded: Any, dr: Any, dg: Any, db: Any) -> None:
    """Write the terms of R', G', B' (W,) that two rows of pixels share: their row of chroma, and the luma offset."""
    shift, neutral = folded[1], folded[2]
    r_v, g_u, g_v, b_u = folded[3], folded[4], folded[5], folded[6]
    for k in range(len(u)):
        du = np.float32(u[k]) - neutral
        dv = np.float32(v[k]) - neutral
        dr[2 * k] = dr[2 * k + 1] = shift + dv * r_v
        dg[2 * k] = dg[2 * k + 1] = shift + du * g_u + dv * g_v
        db[2 * k] = db[2 * k + 1] = shift + du * b_u


@inlined
def _add_light(
    ya: Any, yb: Any, scale: Any, curve: Any, dr: Any, dg: Any, db: Any, weight_a: Any, weight_b: Any,
    red: Any, green: Any, blue: Any,
) -> None:  # fmt: skip
    """Add the weighted light of two rows of pixels to the sums of their columns."""
    slope, c1, c2, c3, c4, c5, c6 = curve[0], curve[1], curve[2], curve[3], curve[4], curve[5], curve[6]
    for i in range(len(ya)):
        a, b = np.float32(ya[i]) * scale, np.float32(yb[i]) * scale
        p = polynomial_light(a + dr[i], slope, c1, c2, c3, c4, c5, c6)
        q = polynomial_light(b + dr[i], slope, c1, c2, c3, c4, c5, c6)
        red[i] += weight_a * p + weight_b * q
        p = polynomial_light(a + dg[i], slope, c1, c2, c3, c4, c5, c6)
        q = polynomial_light(b + dg[i], slope, c1, c2, c3, c4, c5, c6)
        green[i] += weight_a * p + weight_b * q
        p = polynomial_light(a + db[i], slope, c1, c2, c3, c4, c5, c6)
        q = polynomial_light(b + db[i], slope, c1, c2, c3, c4, c5, c6)
        blue[i] += weight_a * p + weight_b * q


@inlined
def _store_blocks(red: Any, green: Any, blue: Any, peak: Any, block: Any, total: Any, brightest: Any) -> None:
    """Write the sums of the columns of each block (W/block, 3), and the largest luma code (W/block,)."""
    for k in range(len(total)):
        r, g, b = _ZERO, _ZERO, _ZERO
        high = peak[k * block]
        for i in range(k * block, (k + 1) * block):
            r += red[i]
            g += green[i]
            b += blue[i]
            high = max(high, peak[i])
        total[k, 0], total[k, 1], total[k, 2] = r, g, b
        brightest[k] = high


@fast
def reduce_planes(
    y: NDArray[Any],
    u: NDArray[Any],
    v: NDArray[Any],
    folded: NDArray[np.float32],  # yuv.coefficients.folded_coefficients
    curve: NDArray[np.float32],  # yuv.coefficients.decode_polynomial
    row_weight: NDArray[np.float32],  # (H,) solid angle over that of the block
    block: int,
    total: NDArray[np.float32],  # (H/block, W/block, 3) out: mean linear radiance
    brightest: NDArray[Any],  # (H/block, W/block) out: largest luma code
) -> None:
    """Fill `total` and `brightest` from the planes of a 4:2:0 frame whose sides are multiples of an even `block`."""
    height, width = y.shape
    dr, dg, db = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    red, green, blue = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    peak = np.empty(width, y.dtype)
    for band in range(height // block):
        red[:] = _ZERO
        green[:] = _ZERO
        blue[:] = _ZERO
        peak[:] = 0
        for row in range(band * block, (band + 1) * block, 2):
            ya, yb, chroma_u, chroma_v = y[row], y[row + 1], u[row // 2], v[row // 2]
            _chroma_parts(chroma_u, chroma_v, folded, dr, dg, db)
            for i in range(width):
                peak[i] = max(peak[i], ya[i], yb[i])
            weight_a, weight_b = row_weight[row], row_weight[row + 1]
            _add_light(ya, yb, folded[0], curve, dr, dg, db, weight_a, weight_b, red, green, blue)
        _store_blocks(red, green, blue, peak, block, total[band], brightest[band])
