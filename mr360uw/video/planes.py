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

Curves are tables, linearly interpolated: decoding over R'G'B' in [-1, 2], encoding over the fourth root of linear
light in [0, 16], which keeps the steep foot of a power law smooth (error below 2e-6 of full scale).
The dither is interleaved gradient noise (Jimenez 2014, "Next generation post processing in Call of Duty"), of the
pixel's position and the frame's index alone: no banding, no random state.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec, Transfer, code_range, decode, encode, rgb_from_ycbcr, ycbcr_from_rgb
from mr360uw.types import Floats, YuvImage

_TABLE = 8192
_DECODE_LOW, _DECODE_HIGH = -1.0, 2.0
_ENCODE_ROOT_MAX = 2.0  # fourth root of 16

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
    roots = np.linspace(0.0, _ENCODE_ROOT_MAX, _TABLE)
    return np.asarray(encode(roots**4, transfer), np.float32)


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


@numba.njit(nogil=True, cache=True, inline="always")
def _chroma(plane: Any, row: int, column: int, sx: int, sy: int, wrap: bool) -> Any:
    """The chroma code at a luma pixel, linearly interpolated."""
    rows, columns = plane.shape
    i = column >> sx
    j = row >> sy
    i2 = i
    if sx and column & 1:
        i2 = i + 1
        if i2 == columns:
            i2 = 0 if wrap else i
    j2 = j
    if sy:
        j2 = min(j + 1, rows - 1) if row & 1 else max(j - 1, 0)
    near = np.float32(plane[j, i]) + np.float32(plane[j, i2])
    if not sy:
        return np.float32(0.5) * near
    far = np.float32(plane[j2, i]) + np.float32(plane[j2, i2])
    return np.float32(0.375) * near + np.float32(0.125) * far


@numba.njit(nogil=True, cache=True, inline="always")
def _lookup(table: Any, position: Any) -> Any:
    """The table at a fractional index, held at its ends."""
    position = min(max(position, np.float32(0.0)), np.float32(_TABLE - 1) - np.float32(0.01))
    i = int(position)
    low = table[i]
    return low + (position - np.float32(i)) * (table[i + 1] - low)


@numba.njit(nogil=True, cache=True)
def _read(
    y: Any, u: Any, v: Any, row: int, column: int, sx: int, sy: int, wrap: bool, k: Any, table: Any, out: Any
) -> None:
    height, width = out.shape[:2]
    low = np.float32(_DECODE_LOW)
    scale = np.float32((_TABLE - 1) / (_DECODE_HIGH - _DECODE_LOW))
    for r in range(height):
        for c in range(width):
            luma = (np.float32(y[row + r, column + c]) - k[0]) / k[1]
            cb = (_chroma(u, row + r, column + c, sx, sy, wrap) - k[2]) / k[3]
            cr = (_chroma(v, row + r, column + c, sx, sy, wrap) - k[2]) / k[3]
            out[r, c, 0] = _lookup(table, (luma + k[4] * cb + k[5] * cr - low) * scale)
            out[r, c, 1] = _lookup(table, (luma + k[6] * cb + k[7] * cr - low) * scale)
            out[r, c, 2] = _lookup(table, (luma + k[8] * cb + k[9] * cr - low) * scale)


@numba.njit(nogil=True, cache=True, inline="always")
def _encoded(linear: Any, old: Any, table: Any) -> Any:
    """R' of linear light, clipped to [0, 1] or as far outside as the old value was."""
    scale = np.float32((_TABLE - 1) / _ENCODE_ROOT_MAX)
    code = _lookup(table, np.float32(math.sqrt(math.sqrt(abs(linear)))) * scale)
    if linear < np.float32(0.0):
        code = -code
    return min(max(code, min(old, np.float32(0.0))), max(old, np.float32(1.0)))


@numba.njit(nogil=True, cache=True, inline="always")
def _noise(row: int, column: int, frame: int) -> Any:
    """Interleaved gradient noise in [0, 1)."""
    shift = np.float32(5.588238) * np.float32(frame & 63)
    x = np.float32(column) + shift
    y = np.float32(row) + shift
    ramp = np.float32(0.06711056) * x + np.float32(0.00583715) * y
    value = np.float32(52.9829189) * (ramp - np.float32(math.floor(ramp)))
    return value - np.float32(math.floor(value))


@numba.njit(nogil=True, cache=True, inline="always")
def _quantise(code: Any, noise: Any, peak: Any) -> Any:
    return min(max(np.float32(math.floor(code + noise)), np.float32(0.0)), peak)


@numba.njit(nogil=True, cache=True, inline="always")
def _chroma_step(plane: Any, change: Any, alpha: Any, weight: Any, i: int, j: int, sx: int, sy: int, wrap: bool) -> Any:
    """The change of one chroma code: the filtered change, less the covered part of the detail that reading loses."""
    rows, columns = plane.shape
    detail = np.float32(0.0)
    if alpha > np.float32(0.0) and sx:
        left, right, up, down = i - 1, i + 1, max(j - 1, 0), min(j + 1, rows - 1)
        if left < 0:
            left = columns - 1 if wrap else 0
        if right == columns:
            right = 0 if wrap else i
        total = np.float32(0.0)
        for jj, across in ((up, np.float32(0.125)), (j, np.float32(0.75)), (down, np.float32(0.125))):
            if not sy:
                across = np.float32(1.0) if jj == j and across > np.float32(0.5) else np.float32(0.0)
            along = np.float32(0.125) * (np.float32(plane[jj, left]) + np.float32(plane[jj, right]))
            total += across * (along + np.float32(0.75) * np.float32(plane[jj, i]))
        detail = np.float32(plane[j, i]) - total
    return change / weight - detail * alpha / weight


@numba.njit(nogil=True, cache=True)
def _write(
    y: Any, u: Any, v: Any, y_out: Any, u_out: Any, v_out: Any, row: int, column: int, sx: int, sy: int, wrap: bool,
    k: Any, table: Any, peak: Any, linear: Any, alpha: Any, changed: Any, frame: int,
) -> None:  # fmt: skip
    height, width = alpha.shape
    chroma_step = np.zeros((height, width, 2), np.float32)
    for r in range(height):
        for c in range(width):
            if not changed[r, c]:
                continue
            luma = (np.float32(y[row + r, column + c]) - k[0]) / k[1]
            cb = (_chroma(u, row + r, column + c, sx, sy, wrap) - k[2]) / k[3]
            cr = (_chroma(v, row + r, column + c, sx, sy, wrap) - k[2]) / k[3]
            red_old = luma + k[4] * cb + k[5] * cr
            green_old = luma + k[6] * cb + k[7] * cr
            blue_old = luma + k[8] * cb + k[9] * cr
            red = _encoded(linear[r, c, 0], red_old, table) - red_old
            green = _encoded(linear[r, c, 1], green_old, table) - green_old
            blue = _encoded(linear[r, c, 2], blue_old, table) - blue_old
            step = k[1] * (k[10] * red + k[11] * green + k[12] * blue)
            code = np.float32(y[row + r, column + c]) + step
            y_out[row + r, column + c] = int(_quantise(code, _noise(row + r, column + c, frame), peak))
            chroma_step[r, c, 0] = k[3] * (k[13] * red + k[14] * green + k[15] * blue)
            chroma_step[r, c, 1] = k[3] * (k[16] * red + k[17] * green + k[18] * blue)
    for j in range(row >> sy, ((row + height - 1) >> sy) + 1):
        for i in range(column >> sx, ((column + width - 1) >> sx) + 1):
            touched = False
            weight = np.float32(0.0)
            cover = np.float32(0.0)
            cb_step = np.float32(0.0)
            cr_step = np.float32(0.0)
            for r in range((j << sy) - row, (j << sy) - row + 1 + sy):
                for c in range((i << sx) - column - sx, (i << sx) - column + 1 + sx):
                    own = np.float32(2.0) if sx and c == (i << sx) - column else np.float32(1.0)
                    weight += own
                    if 0 <= r < height and 0 <= c < width and changed[r, c]:
                        touched = touched or c + column >= i << sx
                        cover += own * alpha[r, c]
                        cb_step += own * chroma_step[r, c, 0]
                        cr_step += own * chroma_step[r, c, 1]
            if touched:
                cb_step = _chroma_step(u, cb_step, cover, weight, i, j, sx, sy, wrap)
                cr_step = _chroma_step(v, cr_step, cover, weight, i, j, sx, sy, wrap)
                # Other corners of the noise than luma's, so that the three do not round up together.
                u_out[j, i] = int(_quantise(np.float32(u[j, i]) + cb_step, _noise(j + 17, i + 59, frame), peak))
                v_out[j, i] = int(_quantise(np.float32(v[j, i]) + cr_step, _noise(j + 101, i + 31, frame), peak))


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
    _write(
        old.y, old.u, old.v, new.y, new.u, new.v, row, column, sx, sy, wrap,
        _coefficients(old.spec), _encode_table(old.spec.transfer), np.float32((1 << old.spec.bits) - 1),
        np.ascontiguousarray(linear, np.float32), np.ascontiguousarray(alpha, np.float32), changed, frame_index,
    )  # fmt: skip
