# SPDX-License-Identifier: Apache-2.0
"""The pixel loops of `planes`: serial, compiled, outside Python's lock.

k: coefficients, in this order: offset and span of luma, offset and span of chroma; R', G', B' from (Cb, Cr), six;
Y', Cb, Cr from R'G'B', nine. sx, sy: log2 of the chroma subsampling. wrap: left and right edges meet. grain: noise of
variance 1 in a rectangle of a plane, or an empty array for none; strength: its standard deviation in parts of the span,
times how much of it is wanted, even over Y' from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

DECODE_STEPS = 8192
DECODE_LOW, DECODE_HIGH = -1.0, 2.0
# Encoding: the exponent and the first 7 bits of the mantissa of a float32 number the samples of its table.
ENCODE_STEP_BITS = 16
ENCODE_LOW = (127 - 32) << (23 - ENCODE_STEP_BITS)
ENCODE_STEPS = 36 << (23 - ENCODE_STEP_BITS)


# Sums may be reordered and divisions multiplied; no sample is ever infinite or not a number.
_Function = TypeVar("_Function", bound=Callable[..., Any])
kernel: Callable[[_Function], _Function] = numba.njit(nogil=True, cache=True, fastmath=True)
inlined: Callable[[_Function], _Function] = numba.njit(nogil=True, cache=True, fastmath=True, inline="always")


@kernel
def _chroma_row(
    plane: Any, row: int, column: int, sx: int, sy: int, wrap: bool, offset: Any, span: Any, out: Any
) -> None:
    """Write the chroma at the pixels (row, column...) into `out`, linearly interpolated, as C in [-.5, .5]."""
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
def _lookup(table: Any, position: Any) -> Any:
    """The table at a fractional index, held at its ends."""
    position = min(max(position, np.float32(0.0)), np.float32(DECODE_STEPS - 1.01))
    i = np.uint32(position)
    low = table[i]
    return low + (position - np.float32(i)) * (table[i + np.uint32(1)] - low)


@kernel
def read_rectangle(
    y: Any, u: Any, v: Any, row: int, column: int, sx: int, sy: int, wrap: bool, k: Any, table: Any, out: Any
) -> None:
    """Write the linear light of a rectangle of the planes into `out` (h, w, 3)."""
    height, width = out.shape[:2]
    scale = np.float32((DECODE_STEPS - 1) / (DECODE_HIGH - DECODE_LOW))
    base = np.float32(-DECODE_LOW)
    cb = np.empty(width, np.float32)
    cr = np.empty(width, np.float32)
    y_offset, y_scale = k[0], np.float32(1.0) / k[1]
    red_cb, red_cr, green_cb, green_cr, blue_cb, blue_cr = k[4], k[5], k[6], k[7], k[8], k[9]
    for r in range(height):
        _chroma_row(u, row + r, column, sx, sy, wrap, k[2], k[3], cb)
        _chroma_row(v, row + r, column, sx, sy, wrap, k[2], k[3], cr)
        luma_row = y[row + r, column : column + width]
        pixels = out[r]
        for c in range(width):
            luma = (np.float32(luma_row[c]) - y_offset) * y_scale + base
            pixels[c, 0] = _lookup(table, (luma + red_cb * cb[c] + red_cr * cr[c]) * scale)
            pixels[c, 1] = _lookup(table, (luma + green_cb * cb[c] + green_cr * cr[c]) * scale)
            pixels[c, 2] = _lookup(table, (luma + blue_cb * cb[c] + blue_cr * cr[c]) * scale)


@kernel
def _encode_row(
    codes: Any, cb: Any, cr: Any, light_bits: Any, alpha: Any, k: Any, channel: int, table: Any, out: Any
) -> None:
    """Write the step from the old R' (or G', B') of a row to that of its new light into `out`.

    light_bits: float32 read as uint32. The new value is clipped to [0, 1], or as far outside as the old
    one was, where it is not covered.
    """
    offset, scale, from_cb, from_cr = k[0], np.float32(1.0) / k[1], k[4 + 2 * channel], k[5 + 2 * channel]
    fraction_mask, sign_bit = np.uint32((1 << ENCODE_STEP_BITS) - 1), np.uint32(1 << 31)
    fraction_scale = np.float32(1.0 / (1 << ENCODE_STEP_BITS))
    first, last = np.int32(ENCODE_LOW), np.int32(ENCODE_STEPS - 1)
    zero, one = np.float32(0.0), np.float32(1.0)
    for c in range(out.size):
        old = (np.float32(codes[c]) - offset) * scale + from_cb * cb[c] + from_cr * cr[c]
        magnitude = light_bits[c] & ~sign_bit
        step = np.int32(magnitude >> np.uint32(ENCODE_STEP_BITS)) - first
        i = np.uint32(min(max(step, np.int32(0)), last))
        low = table[i]
        code = low + np.float32(magnitude & fraction_mask) * fraction_scale * (table[i + np.uint32(1)] - low)
        code = -code if light_bits[c] & sign_bit else code
        clear = one - alpha[c]
        out[c] = min(max(code, clear * min(old, zero)), one + clear * max(old - one, zero)) - old


@inlined
def _noise(row: int, column: int, frame: int) -> Any:
    """Interleaved gradient noise in (0, 1), off the ends so that rounding errors change no code."""
    shift = np.float32(5.588238) * np.float32(frame & 63)
    ramp = np.float32(0.06711056) * (np.float32(column) + shift) + np.float32(0.00583715) * (np.float32(row) + shift)
    value = np.float32(52.9829189) * (ramp - np.float32(int(ramp)))
    return np.float32(0.001) + np.float32(0.998) * (value - np.float32(int(value)))


@kernel
def write_noise(row: int, column: int, frame: int, out: Any) -> None:
    """Write the noise of a rectangle that begins at (row, column) into `out` (h, w)."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[r, c] = _noise(row + r, column + c, frame)


@inlined
def _quantise(code: Any, noise: Any, peak: Any) -> Any:
    return int(min(max(code + noise, np.float32(0.0)), peak))


@inlined
def _lost_detail(plane: Any, j: int, i: int, sy: int, wrap: bool) -> Any:
    """How much of a chroma code reading and filtering do not return: the code less its blur [1 6 1]/8."""
    rows, columns = plane.shape
    left = i - 1 if i else (columns - 1 if wrap else 0)
    right = i + 1 if i + 1 < columns else (0 if wrap else i)
    six, eight = np.float32(6.0), np.float32(8.0)
    blur = np.float32(plane[j, left]) + six * np.float32(plane[j, i]) + np.float32(plane[j, right])
    if sy:
        up, down = max(j - 1, 0), min(j + 1, rows - 1)
        above = np.float32(plane[up, left]) + six * np.float32(plane[up, i]) + np.float32(plane[up, right])
        below = np.float32(plane[down, left]) + six * np.float32(plane[down, i]) + np.float32(plane[down, right])
        blur = (above + six * blur + below) / eight
    return np.float32(plane[j, i]) - blur / eight


@inlined
def _strength(luma: Any, strength: Any) -> Any:
    """The strength of the grain where Y' is `luma`."""
    place = luma * np.float32(strength.size - 1) + np.float32(0.5)
    return strength[np.int32(min(max(place, np.float32(0.0)), np.float32(strength.size - 1)))]


@kernel
def _grain_row(codes: Any, alpha: Any, grain: Any, strength: Any, k: Any, steps: Any) -> None:
    """Add a row's luma grain to the steps of R', G', B' (3, w): grey has no chroma, and the luma weights sum to 1."""
    for c in range(codes.size):
        if alpha[c] > np.float32(0.0):
            old = (np.float32(codes[c]) - k[0]) / k[1]
            luma = old + k[10] * steps[0, c] + k[11] * steps[1, c] + k[12] * steps[2, c]
            step = alpha[c] * grain[c] * _strength(luma, strength)
            for n in range(3):
                steps[n, c] += step


@kernel
def write_luma(
    y: Any, u: Any, v: Any, y_out: Any, row: int, column: int, sx: int, sy: int, wrap: bool,
    k: Any, table: Any, peak: Any, light_bits: Any, alpha: Any, changed: Any, frame: int,
    grain: Any, strength: Any, chroma: Any,
) -> None:  # fmt: skip
    """Write the luma of the changed pixels, and the change of their chroma in codes into `chroma` (2, h, w)."""
    height, width = changed.shape
    cb = np.empty(width, np.float32)
    cr = np.empty(width, np.float32)
    steps = np.empty((3, width), np.float32)  # of R', G', B'
    grainy = grain.size > 0
    for r in range(height):
        _chroma_row(u, row + r, column, sx, sy, wrap, k[2], k[3], cb)
        _chroma_row(v, row + r, column, sx, sy, wrap, k[2], k[3], cr)
        codes = y[row + r, column : column + width]
        codes_out = y_out[row + r, column : column + width]
        for n in range(3):
            _encode_row(codes, cb, cr, light_bits[r, :, n], alpha[r], k, n, table, steps[n])
        if grainy:
            _grain_row(codes, alpha[r], grain[r], strength, k, steps)
        red, green, blue = k[1] * k[10], k[1] * k[11], k[1] * k[12]
        for c in range(width):
            if changed[r, c]:
                step = red * steps[0, c] + green * steps[1, c] + blue * steps[2, c]
                codes_out[c] = _quantise(np.float32(codes[c]) + step, _noise(row + r, column + c, frame), peak)
        for plane in range(2):
            red, green, blue = k[3] * k[13 + 3 * plane], k[3] * k[14 + 3 * plane], k[3] * k[15 + 3 * plane]
            for c in range(width):
                step = red * steps[0, c] + green * steps[1, c] + blue * steps[2, c]
                chroma[plane, r, c] = step if changed[r, c] else np.float32(0.0)


@kernel
def write_chroma(
    u: Any, v: Any, y_out: Any, u_out: Any, v_out: Any, row: int, column: int, sx: int, sy: int, wrap: bool,
    k: Any, peak: Any, alpha: Any, changed: Any, frame: int, grain: Any, strength: Any, chroma: Any,
) -> None:  # fmt: skip
    """Add the change of the pixels' chroma to the samples of the blocks with a changed pixel.

    Adding lets two rectangles share a block. grain: (2, blocks down, blocks across); strength: (2, n); the luma `y_out`
    has been written.
    """
    height, width = alpha.shape
    # Sums down a block, for the pixels of a row and one more to either side.
    steps = np.empty((3, width + 2), np.float32)
    touched = np.empty(width + 2, np.bool_)
    scale = np.float32(1.0) / np.float32((4 if sx else 1) * (2 if sy else 1))
    side, middle = np.float32(1.0 if sx else 0.0), np.float32(2.0 if sx else 1.0)
    grainy = grain.size > 0
    for j in range(row >> sy, ((row + height - 1) >> sy) + 1):
        steps[:] = np.float32(0.0)
        touched[:] = False
        for r in range(max((j << sy) - row, 0), min((j << sy) - row + 1 + sy, height)):
            for c in range(width):
                steps[0, c + 1] += chroma[0, r, c]
                steps[1, c + 1] += chroma[1, r, c]
                steps[2, c + 1] += alpha[r, c] if changed[r, c] else np.float32(0.0)
                touched[c + 1] |= changed[r, c]
        for i in range(column >> sx, ((column + width - 1) >> sx) + 1):
            c = (i << sx) - column + 1
            if not (touched[c] or touched[c + sx]):
                continue
            before = c - 1 if c > 1 else c  # what is left of the rectangle is taken to change like its first column
            cb_step = side * (steps[0, before] + steps[0, c + sx]) + middle * steps[0, c]
            cr_step = side * (steps[1, before] + steps[1, c + sx]) + middle * steps[1, c]
            cover = side * (steps[2, before] + steps[2, c + sx]) + middle * steps[2, c]
            cb = np.float32(u_out[j, i]) + cb_step * scale
            cr = np.float32(v_out[j, i]) + cr_step * scale
            if sx and cover > np.float32(0.0):
                cb -= cover * scale * _lost_detail(u, j, i, sy, wrap)
                cr -= cover * scale * _lost_detail(v, j, i, sy, wrap)
            if grainy and cover > np.float32(0.0):
                luma = (np.float32(y_out[j << sy, i << sx]) - k[0]) / k[1]
                m, n = j - (row >> sy), i - (column >> sx)
                cb += cover * scale * grain[0, m, n] * _strength(luma, strength[0]) * k[3]
                cr += cover * scale * grain[1, m, n] * _strength(luma, strength[1]) * k[3]
            # Other corners of the noise than luma's, so that the three do not round up together.
            u_out[j, i] = _quantise(cb, _noise(j + 17, i + 59, frame), peak)
            v_out[j, i] = _quantise(cr, _noise(j + 101, i + 31, frame), peak)


@kernel
def find_changes(alpha: Any, ratio: Any, radiance: Any, out: Any) -> None:
    """Write into `out` (h, w) where a tile covers, adds light or changes the plate's light."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            same = alpha[r, c] == zero
            for n in range(3):
                same &= (ratio[r, c, n] == one) & (radiance[r, c, n] == zero)
            out[r, c] = not same
