# SPDX-License-Identifier: Apache-2.0
"""Gaussian blurs of parts of a plate's frame, wide ones from reduced pictures that all parts share.

The time grows with the pixels of the parts, and once with those of the rows that wide blurs reach.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Room
from mr360uw.types import Floats, Rectangle

_FINE_SIGMA = 2.0
"""Standard deviation [px] that wide blurs are left with on a reduced picture."""
_COARSEST = 32
"""Largest reduction."""
_BAND = 256
"""Rows of the frame that are read and reduced together, a multiple of `_COARSEST`."""
_RADIUS = 4.0
"""Radius of OpenCV's Gaussian of floats, in standard deviations."""


class Picture(Protocol):
    """A plate's frame."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def linear(self, rectangle: Rectangle) -> Floats:
        """Return a part of it as linear light (h, w, 3)."""

    def lent(self, rectangle: Rectangle) -> Floats:
        """Return the same, read-only, of a part that is read again when the frame is composited."""


class PlateBlur:
    """Blurs of one frame, a panorama closed over the seam. The values do not depend on how it is cut into parts."""

    def __init__(self, picture: Picture) -> None:
        self._picture = picture
        self._bands: dict[tuple[int, int], Floats] = {}

    def of(self, part: Rectangle, sigma: float) -> Floats:
        """Return a part (h, w, 3), float32, under a Gaussian of a standard deviation [px]."""
        image, row, column = self.around(part, sigma, Room())
        return image[row : row + part.height, column : column + part.width]

    def around(self, part: Rectangle, sigma: float, room: Room) -> tuple[Floats, int, int]:
        """Return a picture that holds what `of` returns, contiguous, and the row and column where that begins.

        room: has the picture, until it is used again.
        """
        import cv2

        height, width = self._picture.shape
        factor = min(1 << max(int(np.log2(sigma / _FINE_SIGMA)), 0), _COARSEST)
        reach = int(_RADIUS * sigma) + factor
        # cells of `factor` pixels within the blur's reach, and those that the part is interpolated between
        rows, across = -(-height // factor), -(-width // factor)
        top, bottom = max((part.row - reach) // factor, 0), min(-(-(part.row + part.height + reach) // factor), rows)
        left, right = (part.column - reach) // factor, -(-(part.column + part.width + reach) // factor)
        beside = 1 if factor > 1 else 0
        first, last = max(part.row // factor - beside, 0), min(-(-(part.row + part.height) // factor) + beside, rows)
        begin, end = part.column // factor - beside, -(-(part.column + part.width) // factor) + beside
        cells = self._cells(factor, top, bottom, np.arange(left, right) % across)
        small = cv2.GaussianBlur(
            cells, (0, 0), sigma / factor, room.floats("blurred", *cells.shape), borderType=cv2.BORDER_REPLICATE
        )
        if factor == 1:
            return small, first - top, begin - left
        small = small[first - top : last - top, begin - left : end - left]
        size = factor * (end - begin), factor * (last - first)
        large = cv2.resize(small, size, room.floats("enlarged", *size[::-1], 3), interpolation=cv2.INTER_LINEAR)
        return large, part.row - factor * first, part.column - factor * begin

    def _cells(self, factor: int, top: int, bottom: int, columns: NDArray[np.integer]) -> Floats:
        """Return rows from `top` to before `bottom`, and columns (n,), of the frame reduced by a factor."""
        if factor == 1:
            whole = Rectangle(0, top, self._picture.shape[1], bottom - top)
            if columns[-1] - columns[0] == len(columns) - 1:
                whole, columns = whole._replace(column=int(columns[0]), width=len(columns)), columns - columns[0]
            return np.asarray(self._picture.linear(whole), np.float32)[:, columns]
        deep = _BAND // factor
        bands = [self._band(factor, number) for number in range(top // deep, -(-bottom // deep))]
        start = top // deep * deep
        return np.concatenate([band[:, columns] for band in bands])[top - start : bottom - start]

    def _band(self, factor: int, number: int) -> Floats:
        """Return the rows from `_BAND` number on, reduced by a factor of two or more."""
        import cv2

        if (factor, number) not in self._bands:
            height, width = self._picture.shape
            if factor == 2:
                row = _BAND * number
                part = Rectangle(0, row, width, min(_BAND, height - row))
                finer = np.asarray(self._picture.linear(part), np.float32)
            else:
                finer = self._band(factor // 2, number)
            odd_row, odd_column = finer.shape[0] % 2, finer.shape[1] % 2
            if odd_row:
                finer = cv2.copyMakeBorder(finer, 0, 1, 0, 0, cv2.BORDER_REPLICATE)
            if odd_column:
                finer = cv2.copyMakeBorder(finer, 0, 0, 0, 1, cv2.BORDER_WRAP)
            size = finer.shape[1] // 2, finer.shape[0] // 2
            self._bands[factor, number] = np.asarray(cv2.resize(finer, size, interpolation=cv2.INTER_AREA))
        return self._bands[factor, number]
