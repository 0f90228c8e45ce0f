# SPDX-License-Identifier: Apache-2.0
"""Linear light of decoded planes, of a rectangle of the frame or in directions, and its compiled functions.

These are serial, outside Python's lock; the equations stand below. k: `coefficients`; folded:
`folded_coefficients`. sx, sy: log2 of the chroma subsampling. wrap: left and right edges meet. Chroma of
4:2:0 and 4:2:2 is sited at the even columns, between the rows of a pair (the default of H.264 and HEVC), and
interpolated linearly.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import (
    ColorSpec,
    Transfer,
    code_range,
    decode,
    decode_signal,
    encode_signal,
    in_rec709,
    rgb_from_ycbcr,
    ycbcr_from_rgb,
)
from mr360uw.base.texels import between_four
from mr360uw.jit import fast, fast_making, inlined
from mr360uw.types import Floats, Rectangle, YuvImage

_between_four = inlined(between_four)

# Sums may be reordered and divisions multiplied; no sample is ever infinite or not a number.

_ZERO = np.float32(0.0)


@inlined
def luma_from_code(code: Any, offset: Any, scale: Any) -> Any:
    """Return Y' of a luma code; scale = 1/dy."""
    return (np.float32(code) - offset) * scale


@inlined
def polynomial_light(x: Any, slope: Any, c1: Any, c2: Any, c3: Any, c4: Any, c5: Any, c6: Any) -> Any:
    """Return the linear light of R', G' or B' by `decode_polynomial`; negative values count as 0."""
    x = min(max(x, _ZERO), POLYNOMIAL_TOP)
    return x * max(c1 + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * c6)))), slope)


@inlined
def _table_place(x: Any) -> Any:
    """Return the fractional index of R', G' or B' less DECODE_LOW in `decode_table`, held at its ends."""
    scale = np.float32((DECODE_STEPS - 1) / (DECODE_HIGH - DECODE_LOW))
    return min(max(x * scale, _ZERO), np.float32(DECODE_STEPS - 1.01))


@inlined
def _table_light(table: Any, place: Any) -> Any:
    """Return `decode_table` at a fractional index, linearly interpolated."""
    i = np.uint32(place)
    low = table[i]
    return low + (place - np.float32(i)) * (table[i + np.uint32(1)] - low)


@inlined
def _nearest_light(table: Any, x: Any, steps: Any, last: Any) -> Any:
    """Return `nearest_table` at R', G' or B' = x; negative values count as 0."""
    return table[int(min(max(x * steps + 0.5, 0.0), last))]


@fast
def chroma_row(plane: Any, place: Any, offset: Any, span: Any, out: Any) -> None:
    """Write the chroma at the pixels (row, column...) into `out`, linearly interpolated, as C in [-.5, .5].

    place: row, column, sx, sy and wrap.
    """
    row, column, sx, sy, wrap = place
    rows, columns = plane.shape
    j = row >> sy
    far = j
    if sy:
        far = min(j + 1, rows - 1) if row & 1 else max(j - 1, 0)
    near_weight = np.float32(0.75 if sy else 1.0) / span
    far_weight = np.float32(0.25 if sy else 0.0) / span
    base = -offset / span
    near_row, far_row = plane[j], plane[far]
    for c in range(out.size):
        i = np.uint32(column + c) >> np.uint32(sx)
        out[c] = base + near_weight * np.float32(near_row[i]) + far_weight * np.float32(far_row[i])
    if sx:
        last = (column + out.size - 1) >> 1
        after = last + 1
        if after == columns:
            after = 0 if wrap else last
        right = base + near_weight * np.float32(near_row[after]) + far_weight * np.float32(far_row[after])
        for c in range(1 - (column & 1), out.size, 2):
            out[c] = np.float32(0.5) * (out[c] + (out[c + 1] if c + 1 < out.size else right))


@inlined
def light_row(codes: Any, cb: Any, cr: Any, k: Any, table: Any, places: Any, light: Any) -> None:
    """Write the linear light (w, 3) of a row of luma codes and chroma; table: `decode_table`.

    Places (3, w) in the table are found by vector instructions, before they are looked up.
    """
    offset, scale, base = k[0], np.float32(1.0) / k[1], np.float32(-DECODE_LOW)
    for n in range(3):
        from_cb, from_cr = k[4 + 2 * n], k[5 + 2 * n]
        for c in range(len(codes)):
            luma = luma_from_code(codes[c], offset, scale) + base
            places[n, c] = _table_place(luma + from_cb * cb[c] + from_cr * cr[c])
    for c in range(len(codes)):
        for n in range(3):
            light[c, n] = _table_light(table, places[n, c])


@fast_making
def read_rectangle(planes: Any, place: Any, k: Any, table: Any, out: Any) -> None:
    """Write the linear light of a rectangle of the planes (y, u, v) into `out` (h, w, 3).

    place: of its first pixel, see `chroma_row`. table: `decode_table`.
    """
    (y, u, v), (row, column, sx, sy, wrap) = planes, place
    height, width = out.shape[:2]
    cb, cr, places = np.empty(width, np.float32), np.empty(width, np.float32), np.empty((3, width), np.float32)
    for r in range(height):
        chroma_row(u, (row + r, column, sx, sy, wrap), k[2], k[3], cb)
        chroma_row(v, (row + r, column, sx, sy, wrap), k[2], k[3], cr)
        light_row(y[row + r, column : column + width], cb, cr, k, table, places, out[r])


@fast
def _bilinear(plane: Any, x: Any, y: Any) -> Any:
    """Return a plane at x in [0, W], y in [0, H]: periodic across the seam, the nearest row at the poles."""
    height, width = plane.shape
    x, y = x - 0.5, min(max(y - 0.5, 0.0), height - 1.0)
    left, top = math.floor(x), int(y)
    fx, fy = x - left, y - top
    right, bottom = left + 1 if left + 1 < width else 0, min(top + 1, height - 1)
    left = left if left >= 0 else width - 1
    return _between_four(plane[top, left], plane[top, right], plane[bottom, left], plane[bottom, right], fx, fy)


@fast
def read_directions(direction: Any, y: Any, u: Any, v: Any, folded: Any, table: Any, steps: float, out: Any) -> None:
    """Write the light of a 4:2:0 panorama in directions (n, 3) into `out` (n, 3); table: `nearest_table`.

    The planes are interpolated bilinearly, chroma at its own sites.
    """
    height, width = y.shape
    last = len(table) - 1.0
    for i in range(len(direction)):
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        px = width * (math.atan2(dx, -dz) / (2.0 * math.pi) + 0.5)
        py = height * (0.5 - math.atan2(dy, math.sqrt(dx * dx + dz * dz)) / math.pi)
        # chroma is sited on the left luma sample of its pair, and half way between its two rows
        cb = _bilinear(u, 0.5 * px + 0.25, 0.5 * py) - folded[2]
        cr = _bilinear(v, 0.5 * px + 0.25, 0.5 * py) - folded[2]
        luma = _bilinear(y, px, py) * folded[0] + folded[1]
        out[i, 0] = _nearest_light(table, luma + cr * folded[3], steps, last)
        out[i, 1] = _nearest_light(table, luma + cb * folded[4] + cr * folded[5], steps, last)
        out[i, 2] = _nearest_light(table, luma + cb * folded[6], steps, last)


def linear_from_planes(image: YuvImage, rectangle: Rectangle | None = None, wrap: bool = True) -> NDArray[np.float32]:
    """Return a rectangle of the planes (by default all of it) as linear Rec.709, (h, w, 3) float32, not clipped.

    Any chroma format, 8 to 16 bits. wrap: the last column is the neighbour of the first, as in a panorama.
    """
    column, row, width, height = rectangle or (0, 0, *image.y.shape[::-1])
    out = np.empty((height, width, 3), np.float32)
    # Read-only views, so that all are of one type: a kernel is compiled for each
    planes = tuple(np.broadcast_to(plane, plane.shape) for plane in (image.y, image.u, image.v))
    place = (row, column, *subsampling(image), wrap)
    read_rectangle(planes, place, coefficients(image.spec), decode_table(image.spec), out)
    return in_rec709(out, image.spec)


def linear_in_directions(image: YuvImage, direction: Floats) -> NDArray[np.float32]:
    """Return the linear Rec.709 light (..., 3) of a 4:2:0 panorama in unit directions (..., 3), at least 0."""
    out = np.empty((direction.size // 3, 3), np.float32)
    places = np.ascontiguousarray(direction, np.float64).reshape(-1, 3)
    table, folded = nearest_table(image.spec), folded_coefficients(image.spec)
    read_directions(places, image.y, image.u, image.v, folded, table, NEAREST_STEPS, out)
    return lit_rec709(out, image.spec).reshape(direction.shape)


def lit_rec709(linear: NDArray[np.float32], spec: ColorSpec) -> NDArray[np.float32]:
    """Return linear Rec.709 (..., 3) of a plate's linear light (..., 3) >= 0; colours outside the gamut are cut off."""
    return linear if spec.is_rec709 else np.maximum(in_rec709(linear, spec), 0.0)


# The numbers of the Y'CbCr decoder: offsets, spans and matrices of a plate, and its transfer curve in three forms.
#
#     Y' = (Y - y0)/dy,   Cb = (U - c0)/dc,   Cr = (V - c0)/dc        of the codes Y, U, V
#     R' = Y' + m01 Cb + m02 Cr,   G' = Y' + m11 Cb + m12 Cr,   B' = Y' + m21 Cb + m22 Cr
#     light = decode(R'), decode(G'), decode(B')
#
#     symbol            source                      meaning
#     y0, dy, c0, dc    `color.code_range`          offset and span of luma and of chroma, in code values
#     m                 `color.rgb_from_ycbcr`      matrix from (Y', Cb, Cr) to (R', G', B'); its first column is 1
#     decode            `color.decode_signal`       transfer curve
#
# The curve comes in the form that suits the loop that reads it:
#
#     decode_table         8192 samples over [-1, 2], interpolated linearly: within 2e-6, excursions kept
# nearest_table        8192 steps a unit over [0, 1.2], no interpolation: within half a step of 1/32 of an 8-bit code
# decode_polynomial    degree 6 over [0, 1.1]: within 0.8 %, no memory access, for means over many pixels; of the
# curves that end at white alone, since the others rise too steeply

DECODE_STEPS = 8192
"""Samples of `decode_table`. With half as many its error is four times as large."""
DECODE_LOW, DECODE_HIGH = -1.0, 2.0
"""R'G'B' at the ends of `decode_table`: wider than that of any legal colour. Codes beyond are held at the ends."""
NEAREST_STEPS = 8192
"""Steps of `nearest_table` over R'G'B' from 0 to 1: 32 for each 8-bit code, so that rounding to one does not show."""
_NEAREST_TOP = 1.2  # R'G'B' at the end of the table, at which brighter values are held; luma ends at 1.09
POLYNOMIAL_TOP = np.float32(1.1)
"""R'G'B' up to which `decode_polynomial` is fitted: the headroom of limited range above white. Held constant beyond."""
ENCODE_STEP_BITS = 16
"""Bits of a float32 that lie between two samples of the encoding table: the exponent and the first 7 bits of the
mantissa number the samples, 128 in each octave. One bit more would halve them and make the error four times as large.
"""
ENCODE_LOW = (127 - 32) << (23 - ENCODE_STEP_BITS)
"""Number of the first sample, of light 2^-32, which a power law of 1/2.4 encodes as 1e-4: a tenth of a 10-bit code."""
ENCODE_STEPS = 38 << (23 - ENCODE_STEP_BITS)
"""Samples of the table: 38 octaves, up to 2^6, above the brightest light that any curve holds (PQ, 49)."""
_DEGREE = 6  # of the polynomial: mean error 0.1 %; 5 makes it 1.7 times as large, 7 saves a third


@shared(keep=16)
def coefficients(spec: ColorSpec) -> NDArray[np.float32]:
    """Return the 19 numbers (y0, dy, c0, dc, m01, m02, m11, m12, m21, m22, then the inverse of m row by row)."""
    y_offset, y_span, c_offset, c_span = code_range(spec)
    forward = rgb_from_ycbcr(spec.matrix)
    values = [y_offset, y_span, c_offset, c_span, *forward[:, 1:].ravel(), *ycbcr_from_rgb(spec.matrix).ravel()]
    return np.array(values, np.float32)


@shared(keep=16)
def folded_coefficients(spec: ColorSpec) -> NDArray[np.float32]:
    """Return the same decoder with spans multiplied in: (1/dy, -y0/dy, c0, m02/dc, m11/dc, m12/dc, m21/dc).

    R' = Y/dy - y0/dy + (V - c0) m02/dc and so on; m01 and m22 are 0. One multiplication a sample less.
    """
    y_offset, y_span, c_offset, c_span = code_range(spec)
    m = rgb_from_ycbcr(spec.matrix) / c_span
    return np.array([1.0 / y_span, -y_offset / y_span, c_offset, m[0, 2], *m[1, 1:], m[2, 1]], np.float32)


def subsampling(image: YuvImage) -> tuple[int, int]:
    """Return log2 of the horizontal and vertical chroma subsampling: 4:2:0 is (1, 1), 4:2:2 (1, 0), 4:4:4 (0, 0)."""
    (height, width), (rows, columns) = image.y.shape, image.u.shape
    return int(columns < width), int(rows < height)


@shared(keep=8)
def decode_table(spec: ColorSpec) -> NDArray[np.float32]:
    """Return linear light at DECODE_STEPS values of R'G'B' from DECODE_LOW to DECODE_HIGH."""
    return np.asarray(decode_signal(np.linspace(DECODE_LOW, DECODE_HIGH, DECODE_STEPS), spec), np.float32)


@shared(keep=8)
def encode_table(spec: ColorSpec) -> NDArray[np.float32]:
    """Return R'G'B' (2, ENCODE_STEPS + 1) of linear light, and of negative light, at the samples that `ENCODE_LOW` and
    `ENCODE_STEP_BITS` number.
    """
    bits = (np.arange(ENCODE_STEPS + 1, dtype=np.uint32) + np.uint32(ENCODE_LOW)) << np.uint32(ENCODE_STEP_BITS)
    light = bits.view(np.float32).astype(np.float64)
    return np.asarray([encode_signal(light, spec), encode_signal(-light, spec)], np.float32)


@shared(keep=8)
def nearest_table(spec: ColorSpec) -> NDArray[np.float32]:
    """Return linear light at R'G'B' = k/NEAREST_STEPS, from 0 to 1.2."""
    return decode_signal(np.arange(int(_NEAREST_TOP * NEAREST_STEPS)) / NEAREST_STEPS, spec).astype(np.float32)


@functools.cache
def decode_polynomial(transfer: Transfer) -> NDArray[np.float32]:
    """Return (slope, c1 .. c6): linear light is x max(slope, c1 + .. + c6 x^5) for x in [0, POLYNOMIAL_TOP].

    Fitted to `color.decode`, within 0.8 % of the value above x = 0.1, 0.1 % in the mean; the slope is that of the
    toe, where the polynomial falls below it.
    """
    toe = {"srgb": 0.04045, "bt709": 0.081}.get(transfer, 0.0)
    x = np.linspace(max(toe, 1e-3), POLYNOMIAL_TOP, 2000)
    linear = decode(x, transfer)
    weight = 1.0 / (linear + 0.01)
    powers = x[:, None] ** np.arange(1, _DEGREE + 1)
    fitted = np.linalg.lstsq(powers * weight[:, None], linear * weight, rcond=None)[0]
    slope = float(decode(np.array(0.5 * toe), transfer)) / (0.5 * toe) if toe else 0.0
    return np.array([slope, *fitted], np.float32)
