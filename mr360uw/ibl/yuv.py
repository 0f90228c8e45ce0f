# SPDX-License-Identifier: Apache-2.0
"""Environment of a decoded video frame, in one pass over its planes, without a full frame of floats.

Light is linear Rec.709 for plates of any primaries. Means are converted after summing, since the conversion is linear.
Colours outside the gamut of Rec.709 are cut off at 0, because no surface can be lit by negative light.

In the compiled pass, each luma sample is turned into R'G'B' with the chroma of its 2 x 2 block, decoded by the
decoder's polynomial and added to its block with the weight of its row's solid angle. Nothing of the size of the frame
is written. Loops run along two whole rows, which share their chroma, so that the compiler can use vector instructions.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import code_range, decode
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.ibl.lighting import SunChoice, light_of
from mr360uw.ibl.lookup import reduce_map, reduce_maximum
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, UNEXPANDED, LinearPlate, Plate
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.tilt import LEVEL, upward
from mr360uw.jit import fast, inlined
from mr360uw.shapes import checked, exactly
from mr360uw.sphere import Array, row_solid_angle
from mr360uw.types import Environment, Floats, YuvImage
from mr360uw.yuv.decoding import decode_polynomial, folded_coefficients, polynomial_light

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


class YuvPlate:
    """The planes of a 4:2:0 frame, with the maps of one pass over them in blocks; nothing is expanded."""

    def __init__(self, yuv: YuvImage, block: int, up: Array, refractive_index: float) -> None:
        self.yuv, self.up, self.refractive_index = yuv, up, refractive_index
        self.coarse, self.brightest = _reduce(yuv, block)

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        from mr360uw.yuv.decoding import linear_in_directions

        return linear_in_directions(self.yuv, direction)

    look_expanded = look


@checked
def environment_from_yuv(
    yuv: YuvImage,
    settings: LightSettings | None = None,
    *,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    clearness: float | None = None,
) -> Environment:
    """Return the light of a decoded frame, 8 to 16 bit: that of `environment` of the same frame in linear light.

    4:2:0 frames of even size take one pass over the planes; others, curves that hold light above white, and operators
    that expand are decoded in full first.
    """
    settings = settings or LightSettings()
    plate = plate_of_yuv(yuv, settings, upward(up), refractive_index)
    return light_of(plate, settings, sun, underwater, glossy, clearness)


def plate_of_yuv(
    yuv: YuvImage, settings: LightSettings, up: Array = LEVEL, refractive_index: float = REFRACTIVE_INDEX_SEA
) -> Plate:
    """Return the plate of a decoded frame with its coarse maps worked out."""
    height, width = yuv.y.shape
    half = (height // 2, width // 2), ((height + 1) // 2, (width + 1) // 2)
    exactly("u", yuv.u, *half, *((height, columns) for _, columns in half), (height, width))
    exactly("v", yuv.v, yuv.u.shape)
    block = block_size(width, height)
    if yuv.u.shape != half[0] or block == 0 or yuv.spec.is_wide or settings.operator not in UNEXPANDED:
        return LinearPlate(lit_frame(yuv), settings, up, refractive_index)
    return YuvPlate(yuv, block, up, refractive_index)


def block_size(width: int, height: int) -> int:
    """Return the side of the blocks a frame is first reduced to: even, dividing both sides, near 1/256 of the width.

    0 where there is none. Blocks of 4096 x 2048 or 7680 x 3840 are whole parts of the coarse map's pixels; others
    are taken as even in themselves, where their 1/300 of the width straddles two of them.
    """
    sizes = range(max(2, width // COARSE_COLUMNS // 2 * 2), 0, -2)
    return next((b for b in sizes if width % b == 0 and height % b == 0), 0)


def lit_frame(yuv: YuvImage) -> NDArray[np.float32]:
    """Return a decoded panorama of any chroma format as linear Rec.709 (H, W, 3), at least 0."""
    from mr360uw.yuv.decoding import linear_from_planes

    return np.maximum(linear_from_planes(yuv), 0.0)


@functools.lru_cache(maxsize=8)
def _row_weights(width: int, height: int, block: int) -> Floats:
    weight = row_solid_angle(width, height).reshape(-1, block)
    weight /= weight.sum(axis=1, keepdims=True) * block
    return weight.ravel().astype(np.float32)


def _reduce(yuv: YuvImage, block: int) -> tuple[Floats, Floats]:
    """Return the coarse maps of a frame: mean linear radiance (128, 256, 3), brightest luminance (128, 256)."""
    from mr360uw.yuv.decoding import lit_rec709

    height, width = yuv.y.shape
    if yuv.y.dtype not in (np.uint8, np.uint16) or not 8 <= yuv.spec.bits <= 16:
        raise ParameterError(f"planes - must be uint8 or uint16 (got {yuv.y.dtype}) - decode to one of them")
    total = np.empty((height // block, width // block, 3), np.float32)
    peak = np.empty(total.shape[:2], yuv.y.dtype)
    reduce_planes(
        yuv.y, yuv.u, yuv.v, folded_coefficients(yuv.spec), decode_polynomial(yuv.spec.transfer),
        _row_weights(width, height, block), block, total, peak,
    )  # fmt: skip
    low, span, _, _ = code_range(yuv.spec)
    total = lit_rec709(total, yuv.spec)
    coarse = (
        total if total.shape[:2] == (COARSE_ROWS, COARSE_COLUMNS) else reduce_map(total, COARSE_COLUMNS, COARSE_ROWS)
    )
    brightest = np.maximum((peak.astype(np.float32) - low) / span, 0.0)
    if brightest.shape != (COARSE_ROWS, COARSE_COLUMNS):
        brightest = reduce_maximum(brightest, COARSE_COLUMNS, COARSE_ROWS)
    return coarse.astype(np.float32), decode(brightest, yuv.spec.transfer)
