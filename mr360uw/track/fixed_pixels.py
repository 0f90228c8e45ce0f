# SPDX-License-Identifier: Apache-2.0
"""Finds the pixels that stand still while the rest of a picture moves: a rig, a housing, the diver's hand."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_STILL_CODES = 3.0
"""Standard deviation over time [codes] up to which a pixel stands still: twice a codec's noise."""
_TEXTURED_CODES = 4.0
"""Least standard deviation [codes] around a pixel whose standing still means anything."""
_STILL_OF_TEXTURE = 0.35
"""Largest standard deviation over time over that around it of a pixel that stands still."""
_LARGEST_STILL = 0.5
"""Share of textured pixels that stand still above which nothing is left out: then the whole scene does."""
_LEAST_KEYS_OF_MASK = 6


def fixed_pixels(pictures: Iterable[NDArray[np.uint8]]) -> NDArray[np.bool_]:
    """Return where pictures (H, W) of the same size stand still, (H, W); nowhere for fewer than six of them."""
    fixed: FixedPixels | None = None
    for picture in pictures:
        fixed = FixedPixels(picture.shape) if fixed is None else fixed
        fixed.add(picture)
    return np.zeros((0, 0), bool) if fixed is None else fixed.mask()


class FixedPixels:
    """Mean and variance over time of every pixel of small pictures."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._count, self._sum, self._squares = 0, np.zeros(shape), np.zeros(shape)

    def add(self, small: NDArray[np.uint8]) -> None:
        """Take in another picture."""
        self._count += 1
        self._sum += small
        self._squares += np.square(small, dtype=np.float64)

    def mask(self) -> NDArray[np.bool_]:
        """Return where the picture stands still (H, W); nowhere if most of it does, or there are too few pictures."""
        import cv2

        nothing = np.zeros(self._sum.shape, bool)
        if self._count < _LEAST_KEYS_OF_MASK:
            return nothing
        mean = self._sum / self._count
        temporal = np.sqrt(np.maximum(self._squares / self._count - mean**2, 0.0))
        size = (9, 9)
        around = np.sqrt(np.maximum(cv2.blur(mean**2, size) - cv2.blur(mean, size) ** 2, 0.0))
        textured = np.maximum(around, temporal) > _TEXTURED_CODES
        still = textured & (temporal < _STILL_CODES) & (temporal < _STILL_OF_TEXTURE * around)
        if np.count_nonzero(still) > _LARGEST_STILL * np.count_nonzero(textured):
            return nothing
        closed = cv2.morphologyEx(still.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        closed = cv2.morphologyEx(closed, cv2.MORPH_CLOSE, np.ones((15, 15), np.uint8))
        return np.asarray(cv2.dilate(closed, np.ones((7, 7), np.uint8))).astype(bool)
