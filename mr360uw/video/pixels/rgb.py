# SPDX-License-Identifier: Apache-2.0
"""Converts between the code values of RGB pictures (PNG, JPEG, EXR) and linear light."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import Transfer, decode, encode
from mr360uw.types import Floats, Rectangle


def peak_code(codes: NDArray[Any]) -> float:
    """Return the code value of full scale: 255, 65535, or 1 of floating point pictures."""
    return float(np.iinfo(codes.dtype).max) if codes.dtype.kind == "u" else 1.0


@lru_cache(maxsize=8)
def _decode_table(peak: int, transfer: Transfer) -> NDArray[np.float32]:
    return np.asarray(decode(np.arange(peak + 1) / peak, transfer), np.float32)


def linear_from_codes(codes: NDArray[Any], transfer: Transfer) -> NDArray[np.float32]:
    """Return the linear light of code values (..., 3), float32."""
    if codes.dtype.kind == "u":
        return _decode_table(int(peak_code(codes)), transfer)[codes]
    return decode(np.asarray(codes, np.float32), transfer).astype(np.float32)


def noise(rows: int, columns: int, row: int, column: int, frame_index: int) -> NDArray[np.float32]:
    """Return the dither of a rectangle (rows, columns), in (0, 1); see `planes`."""
    from mr360uw.video.pixels.kernels import write_noise

    dither = np.empty((rows, columns), np.float32)
    write_noise(row, column, frame_index, dither)
    return dither


def codes_from_linear(linear: Floats, transfer: Transfer, dtype: Any, frame_index: int) -> NDArray[Any]:
    """Return dithered code values of linear light (H, W, 3), clipped to full scale; dtype uint8 or uint16."""
    peak = float(np.iinfo(dtype).max)
    dither = noise(linear.shape[0], linear.shape[1], 0, 0, frame_index)[..., None]
    return np.clip(np.floor(encode(linear, transfer) * peak + dither), 0.0, peak).astype(dtype)


def lay_over_codes(
    codes: NDArray[Any],
    linear: Floats,
    changed: NDArray[np.bool_],
    transfer: Transfer,
    rectangle: Rectangle,
    frame_index: int,
) -> None:
    """Write linear light (h, w, 3) into a rectangle of code values, in place, where `changed`.

    Integer codes are clipped to full scale and dithered; floating point pictures take the new light as it is.
    """
    if codes.dtype.kind == "f":
        codes[changed] = encode(linear[changed], transfer)
        return
    peak = peak_code(codes)
    column, row, width, height = rectangle
    dither = noise(height, width, row, column, frame_index)[changed][:, None]
    new = encode(np.asarray(linear[changed], np.float64), transfer) * peak
    codes[changed] = np.clip(np.floor(new + dither), 0.0, peak).astype(codes.dtype)
