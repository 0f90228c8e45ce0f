# SPDX-License-Identifier: Apache-2.0
"""Small pictures of light, for pages and notebooks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import encode

LARGEST_WIDTH = 1024


def thumbnail(linear: ArrayLike, width: int = LARGEST_WIDTH) -> bytes:
    """Return linear light (H, W, 3) as a PNG in 8-bit sRGB, at most `width` pixels wide; light above 1 is white."""
    import cv2

    image = np.asarray(linear, np.float32)
    if image.shape[1] > width:
        size = (width, max(1, round(image.shape[0] * width / image.shape[1])))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    codes = np.round(255.0 * np.clip(encode(np.maximum(image, 0.0), "srgb"), 0.0, 1.0)).astype(np.uint8)
    return encoded(codes, ".png")


def encoded(codes: NDArray[np.uint8], suffix: str) -> bytes:
    """Return codes (h, w, 3) as a picture file of the kind that a suffix names."""
    import cv2

    done, data = cv2.imencode(suffix, np.ascontiguousarray(codes[..., ::-1]))
    assert done
    return bytes(data)
