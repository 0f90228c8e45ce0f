# SPDX-License-Identifier: Apache-2.0
"""Between the planes of a video frame and linear light, one rectangle at a time.

`linear_from_planes` reads a rectangle as linear Rec.709; `lay_over_planes` puts a changed rectangle back. Writing adds
the *difference* between the new and the old light, in code values, to the old codes: what did not change keeps its
code, and nothing is lost by a round trip through another colour space.

Chroma of 4:2:0 and 4:2:2 is sited at the even columns, between the rows of a pair (H.264 and HEVC default). It is
interpolated linearly for reading and filtered [1 2 1]/4 along, [1 1]/2 across for writing; a chroma sample is written
only where a pixel of its own block changed. Round a panorama, the column after the last one is the first.

    code' = code + span (E(new) - E(old)) + dither,    E: linear light -> R'G'B' -> Y' or C

Where an object of coverage alpha covers the plate, the detail of the old chroma that linear interpolation and the
filter do not return is scaled by 1 - alpha, so that no plate shines through an opaque object.

Curves are tables, linearly interpolated: decoding over R'G'B' in [-1, 2], encoding over 128 samples in each octave of
linear light from 2^-32 to 16, found by the leading bits of the float, which follows the steep foot of a power law
(error below 2e-6 of full scale).
The dither is interleaved gradient noise (Jimenez 2014, "Next generation post processing in Call of Duty"), of the
pixel's position and the frame's index alone: no banding, no random state.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec, Transfer, code_range, decode, encode, rgb_from_ycbcr, ycbcr_from_rgb
from mr360uw.types import Floats, Tile, YuvImage

_TABLE = 8192
_DECODE_LOW, _DECODE_HIGH = -1.0, 2.0
# Encoding: the exponent and the first 7 bits of the mantissa of a float32 number the samples of its table.
_STEP_BITS = 16
_STEPS_LOW = (127 - 32) << (23 - _STEP_BITS)
_STEPS = 36 << (23 - _STEP_BITS)

# Linear Rec.709 from linear BT.2020 (ITU-R BT.2087-0, inverse of its eq. for M2).
_REC709_FROM_BT2020 = np.array(
    [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]]
)

Rectangle = tuple[int, int, int, int]
"""row, column, height, width of a part of the frame."""


@lru_cache(maxsize=8)
def _decode_table(transfer: Transfer) -> NDArray[np.float32]:
    codes = np.linspace(_DECODE_LOW, _DECODE_HIGH, _TABLE)
    return np.asarray(decode(codes, transfer), np.float32)


@lru_cache(maxsize=8)
def _encode_table(transfer: Transfer) -> NDArray[np.float32]:
    bits = (np.arange(_STEPS + 1, dtype=np.uint32) + np.uint32(_STEPS_LOW)) << np.uint32(_STEP_BITS)
    return np.asarray(encode(bits.view(np.float32).astype(np.float64), transfer), np.float32)


@lru_cache(maxsize=16)
def _coefficients(spec: ColorSpec) -> NDArray[np.float32]:
    """Offsets and spans, then R'G'B' from (Cb, Cr), then (Y', Cb, Cr) from R'G'B'."""
    y_offset, y_span, c_offset, c_span = code_range(spec)
    forward = rgb_from_ycbcr(spec.matrix)
    values = [y_offset, y_span, c_offset, c_span, *forward[:, 1:].ravel(), *ycbcr_from_rgb(spec.matrix).ravel()]
    return np.array(values, np.float32)


def subsampling(image: YuvImage) -> tuple[int, int]:
    """Return log2 of the horizontal and vertical chroma subsampling: 4:2:0 is (1, 1), 4:2:2 (1, 0), 4:4:4 (0, 0)."""
    (height, width), (rows, columns) = image.y.shape, image.u.shape
    return int(columns < width), int(rows < height)


# Sums may be reordered and divisions multiplied; no sample is ever infinite or not a number.
_Function = TypeVar("_Function", bound=Callable[..., Any])
_kernel: Callable[[_Function], _Function] = numba.njit(nogil=True, cache=True, fastmath=True)
_inlined: Callable[[_Function], _Function] = numba.njit(nogil=True, cache=True, fastmath=True, inline="always")


@_kernel
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


@_inlined
def _lookup(table: Any, position: Any) -> Any:
    """The table at a fractional index, held at its ends."""
    position = min(max(position, np.float32(0.0)), np.float32(_TABLE - 1.01))
    i = np.uint32(position)
    low = table[i]
    return low + (position - np.float32(i)) * (table[i + np.uint32(1)] - low)


@_kernel
def _read(
    y: Any, u: Any, v: Any, row: int, column: int, sx: int, sy: int, wrap: bool, k: Any, table: Any, out: Any
) -> None:
    height, width = out.shape[:2]
    scale = np.float32((_TABLE - 1) / (_DECODE_HIGH - _DECODE_LOW))
    base = np.float32(-_DECODE_LOW)
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


@_kernel
def _encode_row(
    codes: Any,
    cb: Any,
    cr: Any,
    light_bits: Any,
    offset: Any,
    scale: Any,
    from_cb: Any,
    from_cr: Any,
    table: Any,
    out: Any,
) -> None:
    """Write the step from the old R' (or G', B') of a row to that of its new light into `out`.

    light_bits: float32 read as uint32. The new value is clipped to [0, 1], or as far outside as the old one was.
    """
    offset, scale, from_cb, from_cr = k[0], np.float32(1.0) / k[1], k[4 + 2 * channel], k[5 + 2 * channel]
    fraction_mask, sign_bit = np.uint32((1 << _STEP_BITS) - 1), np.uint32(1 << 31)
    fraction_scale = np.float32(1.0 / (1 << _STEP_BITS))
    first, last = np.int32(_STEPS_LOW), np.int32(_STEPS - 1)
    zero, one = np.float32(0.0), np.float32(1.0)
    for c in range(out.size):
        old = (np.float32(codes[c]) - offset) * scale + from_cb * cb[c] + from_cr * cr[c]
        magnitude = light_bits[c] & ~sign_bit
        step = np.int32(magnitude >> np.uint32(_STEP_BITS)) - first
        i = np.uint32(min(max(step, np.int32(0)), last))
        low = table[i]
        code = low + np.float32(magnitude & fraction_mask) * fraction_scale * (table[i + np.uint32(1)] - low)
        code = -code if light_bits[c] & sign_bit else code
        out[c] = min(max(code, min(old, zero)), max(old, one)) - old


@_inlined
def _noise(row: int, column: int, frame: int) -> Any:
    """Interleaved gradient noise in (0, 1), off the ends so that rounding errors change no code."""
    shift = np.float32(5.588238) * np.float32(frame & 63)
    ramp = np.float32(0.06711056) * (np.float32(column) + shift) + np.float32(0.00583715) * (np.float32(row) + shift)
    value = np.float32(52.9829189) * (ramp - np.float32(int(ramp)))
    return np.float32(0.001) + np.float32(0.998) * (value - np.float32(int(value)))


@_inlined
def _quantise(code: Any, noise: Any, peak: Any) -> Any:
    return int(min(max(code + noise, np.float32(0.0)), peak))


@_inlined
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


@_kernel
def _write_luma(
    y: Any, u: Any, v: Any, y_out: Any, row: int, column: int, sx: int, sy: int, wrap: bool,
    k: Any, table: Any, peak: Any, light_bits: Any, changed: Any, frame: int, chroma: Any,
) -> None:  # fmt: skip
    """Write the luma of the changed pixels, and the change of their chroma in codes into `chroma` (2, h, w)."""
    height, width = changed.shape
    cb = np.empty(width, np.float32)
    cr = np.empty(width, np.float32)
    steps = np.empty((3, width), np.float32)  # of R', G', B'
    for r in range(height):
        _chroma_row(u, row + r, column, sx, sy, wrap, k[2], k[3], cb)
        _chroma_row(v, row + r, column, sx, sy, wrap, k[2], k[3], cr)
        codes = y[row + r, column : column + width]
        codes_out = y_out[row + r, column : column + width]
        for n in range(3):
            _encode_row(
                codes, cb, cr, light_bits[r, :, n], y_offset, y_scale, k[4 + 2 * n], k[5 + 2 * n], table, steps[n]
            )
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


@_kernel
def _write_chroma(
    u: Any, v: Any, u_out: Any, v_out: Any, row: int, column: int, sx: int, sy: int, wrap: bool,
    peak: Any, alpha: Any, changed: Any, frame: int, chroma: Any,
) -> None:  # fmt: skip
    """Write the chroma samples of the blocks with a changed pixel from the pixels' change of chroma."""
    height, width = alpha.shape
    # Sums down a block, for the pixels of a row and one more to either side.
    steps = np.empty((3, width + 2), np.float32)
    touched = np.empty(width + 2, np.bool_)
    scale = np.float32(1.0) / np.float32((4 if sx else 1) * (2 if sy else 1))
    side, middle = np.float32(1.0 if sx else 0.0), np.float32(2.0 if sx else 1.0)
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
            before = max(c - 1, 0)
            cb_step = side * (steps[0, before] + steps[0, c + sx]) + middle * steps[0, c]
            cr_step = side * (steps[1, before] + steps[1, c + sx]) + middle * steps[1, c]
            cover = side * (steps[2, before] + steps[2, c + sx]) + middle * steps[2, c]
            cb = np.float32(u[j, i]) + cb_step * scale
            cr = np.float32(v[j, i]) + cr_step * scale
            if sx and cover > np.float32(0.0):
                cb -= cover * scale * _lost_detail(u, j, i, sy, wrap)
                cr -= cover * scale * _lost_detail(v, j, i, sy, wrap)
            # Other corners of the noise than luma's, so that the three do not round up together.
            u_out[j, i] = _quantise(cb, _noise(j + 17, i + 59, frame), peak)
            v_out[j, i] = _quantise(cr, _noise(j + 101, i + 31, frame), peak)


@_kernel
def _find_changes(alpha: Any, ratio: Any, radiance: Any, out: Any) -> None:
    one, zero = np.float32(1.0), np.float32(0.0)
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            same = alpha[r, c] == zero
            for n in range(3):
                same &= (ratio[r, c, n] == one) & (radiance[r, c, n] == zero)
            out[r, c] = not same


def changed_pixels(tile: Tile) -> NDArray[np.bool_]:
    """Return where a tile lays anything over the plate, (h, w): coverage, light, or a ratio other than 1."""
    out = np.empty(tile.alpha.shape, np.bool_)
    alpha, ratio, radiance = (np.ascontiguousarray(a, np.float32) for a in (tile.alpha, tile.ratio, tile.radiance))
    _find_changes(alpha, ratio, radiance, out)
    return out


def linear_from_planes(image: YuvImage, rectangle: Rectangle | None = None, wrap: bool = True) -> NDArray[np.float32]:
    """Return a rectangle of the planes (by default all of it) as linear Rec.709, (h, w, 3) float32, not clipped.

    wrap: the last column is the neighbour of the first, as in a panorama.
    """
    row, column, height, width = rectangle or (0, 0, *image.y.shape)
    out = np.empty((height, width, 3), np.float32)
    sx, sy = subsampling(image)
    table = _decode_table(image.spec.transfer)
    _read(image.y, image.u, image.v, row, column, sx, sy, wrap, _coefficients(image.spec), table, out)
    if image.spec.matrix == "bt2020":
        out = np.asarray(out @ _REC709_FROM_BT2020.T, np.float32)
    return out


def lay_over_planes(
    old: YuvImage,
    new: YuvImage,
    rectangle: Rectangle,
    linear: Floats,
    alpha: Floats,
    changed: NDArray[np.bool_],
    frame_index: int,
    wrap: bool = True,
) -> None:
    """Write linear Rec.709 light (h, w, 3) into a rectangle of the planes `new`, which hold a copy of `old`.

    Only pixels where `changed` (h, w) get a new luma code, and only chroma samples of 2x2 (or 2x1, 1x1) blocks with
    such a pixel a new chroma code. Light is clipped to code values between 0 and full scale (a plate that is itself
    brighter or darker keeps its excursion). alpha: (h, w) coverage of the plate.
    """
    row, column, _, _ = rectangle
    if old.spec.matrix == "bt2020":
        linear = linear @ np.linalg.inv(_REC709_FROM_BT2020).T
    sx, sy = subsampling(old)
    coefficients, peak = _coefficients(old.spec), np.float32((1 << old.spec.bits) - 1)
    light, cover = np.ascontiguousarray(linear, np.float32), np.ascontiguousarray(alpha, np.float32)
    chroma = np.empty((2, *alpha.shape), np.float32)
    _write_luma(
        old.y, old.u, old.v, new.y, row, column, sx, sy, wrap,
        coefficients, _encode_table(old.spec.transfer), peak, light.view(np.uint32), changed, frame_index, chroma,
    )  # fmt: skip
    _write_chroma(
        old.u, old.v, new.u, new.v, row, column, sx, sy, wrap, peak, cover, changed, frame_index, chroma
    )  # fmt: skip


def planes_from_linear(linear: Floats, planes: YuvImage, wrap: bool = True) -> None:
    """Write a whole picture of linear Rec.709 light (H, W, 3), dithered, into planes that are about to hold it."""
    y_offset, _, c_offset, _ = code_range(planes.spec)
    black = YuvImage(
        np.full_like(planes.y, y_offset),
        np.full_like(planes.u, c_offset),
        np.full_like(planes.v, c_offset),
        planes.spec,
    )
    everything = np.ones(planes.y.shape, np.float32)
    lay_over_planes(black, planes, (0, 0, *planes.y.shape), linear, everything, everything > 0, 0, wrap)
