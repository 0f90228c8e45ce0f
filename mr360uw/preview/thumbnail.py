# SPDX-License-Identifier: Apache-2.0
"""Pictures of light as files for pages and notebooks: 8-bit sRGB, PNG or JPEG."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import encode
from mr360uw.jit import exact

_STEPS = 1 << 14
"""Steps of the table over the square root of light: 45 for the narrowest code value, so that one pixel in 45 at most
differs from exact rounding, by one code value."""


@cache
def _table() -> NDArray[np.uint8]:
    light = (np.arange(_STEPS + 1) / _STEPS) ** 2
    return np.round(255.0 * encode(light, "srgb")).astype(np.uint8)


def screen_codes(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return linear light (H, W, 3) as 8-bit sRGB; light above 1 is white, below 0 black."""
    codes = np.empty(linear.shape, np.uint8)
    _encode(np.ascontiguousarray(linear, np.float32).reshape(-1), _table(), codes.reshape(-1))
    return codes


@exact
def _encode(linear: Any, table: Any, codes: Any) -> None:
    steps = np.float32(_STEPS)
    for i in range(linear.size):
        light = min(max(linear[i], np.float32(0.0)), np.float32(1.0))
        codes[i] = table[int(math.sqrt(light) * steps + np.float32(0.5))]


LARGEST_WIDTH = 1024
QUALITY = 90
"""Quality of JPEG: twice the compression of 95, without visible blocks."""


def thumbnail(linear: ArrayLike) -> bytes:
    """Return linear light (H, W, 3) as a PNG in 8-bit sRGB, at most 1024 pixels wide; light above 1 is white."""
    return screen_picture(linear, ".png", width=LARGEST_WIDTH)


def screen_picture(
    linear: ArrayLike, suffix: Literal[".jpg", ".png"] = ".jpg", *, width: int | None = None, quality: int = QUALITY
) -> bytes:
    """Return linear light (H, W, 3) as a picture file in 8-bit sRGB; light above 1 is white.

    width: the most pixels across; None leaves them all. quality: 0 to 100, of JPEG.
    """
    import cv2

    image = np.asarray(linear, np.float32)
    if width is not None and image.shape[1] > width:
        size = (width, max(1, round(image.shape[0] * width / image.shape[1])))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    return encoded(screen_codes(image), suffix, quality)


def encoded(codes: NDArray[np.uint8], suffix: str, quality: int = QUALITY) -> bytes:
    """Return codes (h, w, 3) as a picture file of the kind that a suffix names. quality: 0 to 100, of JPEG."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix in (".jpg", ".jpeg") else [cv2.IMWRITE_PNG_COMPRESSION, 1]
    done, data = cv2.imencode(suffix, cv2.cvtColor(np.ascontiguousarray(codes), cv2.COLOR_RGB2BGR), options)
    assert done
    return bytes(data)
