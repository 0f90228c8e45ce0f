# SPDX-License-Identifier: Apache-2.0
"""The numbers of the Y'CbCr decoder: offsets, spans and matrices of a plate, and its transfer curve in three forms.

    Y' = (Y - y0)/dy,   Cb = (U - c0)/dc,   Cr = (V - c0)/dc        of the codes Y, U, V
    R' = Y' + m01 Cb + m02 Cr,   G' = Y' + m11 Cb + m12 Cr,   B' = Y' + m21 Cb + m22 Cr
    light = decode(R'), decode(G'), decode(B')

    symbol            source                      meaning
    y0, dy, c0, dc    `color.code_range`          offset and span of luma and of chroma, in code values
    m                 `color.rgb_from_ycbcr`      matrix from (Y', Cb, Cr) to (R', G', B'); its first column is 1
    decode            `color.decode_signal`       transfer curve

The curve comes in the form that suits the loop that reads it:

    decode_table         8192 samples over [-1, 2], interpolated linearly: within 2e-6, excursions kept
    nearest_table        8192 steps a unit over [0, 1.2], no interpolation: within half a step of 1/32 of an 8-bit code
    decode_polynomial    degree 6 over [0, 1.1]: within 0.8 %, no memory access, for means over many pixels; of the
                         curves that end at white alone, since the others rise too steeply
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import (
    ColorSpec,
    Transfer,
    code_range,
    decode,
    decode_signal,
    encode_signal,
    rgb_from_ycbcr,
    ycbcr_from_rgb,
)
from mr360uw.types import YuvImage

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


@lru_cache(maxsize=16)
def coefficients(spec: ColorSpec) -> NDArray[np.float32]:
    """Return the 19 numbers (y0, dy, c0, dc, m01, m02, m11, m12, m21, m22, then the inverse of m row by row)."""
    y_offset, y_span, c_offset, c_span = code_range(spec)
    forward = rgb_from_ycbcr(spec.matrix)
    values = [y_offset, y_span, c_offset, c_span, *forward[:, 1:].ravel(), *ycbcr_from_rgb(spec.matrix).ravel()]
    return np.array(values, np.float32)


@lru_cache(maxsize=16)
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


@lru_cache(maxsize=8)
def decode_table(spec: ColorSpec) -> NDArray[np.float32]:
    """Return linear light at DECODE_STEPS values of R'G'B' from DECODE_LOW to DECODE_HIGH."""
    return np.asarray(decode_signal(np.linspace(DECODE_LOW, DECODE_HIGH, DECODE_STEPS), spec), np.float32)


@lru_cache(maxsize=8)
def encode_table(spec: ColorSpec) -> NDArray[np.float32]:
    """Return R'G'B' (2, ENCODE_STEPS + 1) of linear light, and of negative light, at the samples that `ENCODE_LOW` and
    `ENCODE_STEP_BITS` number.
    """
    bits = (np.arange(ENCODE_STEPS + 1, dtype=np.uint32) + np.uint32(ENCODE_LOW)) << np.uint32(ENCODE_STEP_BITS)
    light = bits.view(np.float32).astype(np.float64)
    return np.asarray([encode_signal(light, spec), encode_signal(-light, spec)], np.float32)


@lru_cache(maxsize=8)
def nearest_table(spec: ColorSpec) -> NDArray[np.float32]:
    """Return linear light at R'G'B' = k/NEAREST_STEPS, from 0 to 1.2."""
    return decode_signal(np.arange(int(_NEAREST_TOP * NEAREST_STEPS)) / NEAREST_STEPS, spec).astype(np.float32)


@lru_cache(maxsize=8)
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
