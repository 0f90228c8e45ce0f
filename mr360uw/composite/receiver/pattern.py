# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics on the receiver, which a shadow takes away with the light that bears them.

    r = (plate - veil)/(calm - veil) = share + (1 - share) c        ratio = (share free + (r - share) V waves + added)/r

with `calm` the plate in the mean light of its waves, c the plate's own caustic factor, share the ambient fraction of
the mean light, V the visible fraction of the sun. In the umbra the plate becomes calm times its ambient light: no
filament runs on through it. Where nothing blocks the sun the ratio is 1 and the plate is left as it is.

Gaussian blurs of parts of the plate's frame take reduced pictures that all parts share where they are wide. The time
grows with the pixels of the parts, and once with those of the rows that wide blurs reach.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Scratch
from mr360uw.jit import exact
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
        image, row, column = self.around(part, sigma, Scratch())
        return image[row : row + part.height, column : column + part.width]

    def around(self, part: Rectangle, sigma: float, scratch: Scratch) -> tuple[Floats, int, int]:
        """Return a picture that holds what `of` returns, contiguous, and the row and column where that begins.

        scratch: has the picture, until it is used again.
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
            cells, (0, 0), sigma / factor, scratch.floats("blurred", *cells.shape), borderType=cv2.BORDER_REPLICATE
        )
        if factor == 1:
            return small, first - top, begin - left
        small = small[first - top : last - top, begin - left : end - left]
        size = factor * (end - begin), factor * (last - first)
        large = cv2.resize(small, size, scratch.floats("enlarged", *size[::-1], 3), interpolation=cv2.INTER_LINEAR)
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


LEAST_LIGHT = 1e-3
"""Linear light above the veil below which a pattern is taken for noise: a quarter of an 8-bit code near black."""
LEAST_DIRECT = 0.02
"""Least direct light over the mean that is left beside the ambient: filaments are bright, what lies between them is not
quite without sun."""
_SIGMA_M = 0.3
"""Standard deviation on the ground of the blur that takes caustics for detail: filaments are 5 to 30 cm apart in the
first ten metres. Half of it leaves broad filaments, twice of it takes away ripples of the sand."""
_STEP = 2.0
"""Ratio of neighbouring blurs, between which the blur of a row is mixed."""
_HALF_BIAS = np.float32(2.0**112)
"""Ratio of the exponents' biases of float32 and float16, which turns the bits of one into the other."""
_FLATTEST = 0.02
"""Least sine of the angle below the horizon: nearer to it ground is too far away for its caustics to be seen."""


@dataclass(frozen=True, eq=False)
class PlatePattern:
    """A plate's frame and how it would look in the mean light of its waves.

    mean: (H, W, 3) of the clip where the camera stands, or None: then detail of the size of caustics is smoothed.
    height_m: of the camera above the ground, for that size. strength: fraction of that detail that is caustics, 0 to 1;
    a mean is the calm state as it is.
    """

    picture: Picture
    mean: Floats | None
    height_m: float
    strength: float

    @functools.cached_property
    def blur(self) -> PlateBlur:
        """Blurs of the frame, whose parts share reduced pictures."""
        return PlateBlur(self.picture)

    def light(self, part: Rectangle, scratch: Scratch | None = None) -> tuple[Floats, Floats]:
        """Return the frame and its calm state over a part of it, each (h, w, 3) float32.

        scratch: may have the calm state, until it is used again; None takes new memory.
        """
        shown = np.asarray(self.picture.lent(part), np.float32)
        if self.mean is not None:
            rows, columns = slice(part.row, part.row + part.height), slice(part.column, part.column + part.width)
            return shown, _widened(self.mean[rows, columns])
        calm = self._smooth(part, Scratch() if scratch is None else scratch)
        _draw_from(shown.reshape(-1), np.float32(self.strength), calm.reshape(-1))
        return shown, calm

    def _smooth(self, part: Rectangle, scratch: Scratch) -> NDArray[np.float32]:
        """Return a part blurred by `_SIGMA_M` on level ground, row by row."""
        height, width = self.picture.shape
        latitude = np.pi * ((np.arange(part.height) + part.row + 0.5) / height - 0.5)
        distance = self.height_m / np.maximum(np.sin(latitude), _FLATTEST)
        sigma = np.clip(_SIGMA_M / distance * height / np.pi, 1.0, width / 16)
        level = np.log(sigma) / np.log(_STEP)
        low, high = int(np.floor(level.min())), int(np.floor(level.max())) + 1
        smooth, begun = scratch.floats("smooth", part.height, part.width, 3), np.zeros(part.height, np.bool_)
        for number in range(low, high + 1):
            weight = np.maximum(1.0 - np.abs(level - number), 0.0).astype(np.float32)
            rows = np.flatnonzero(weight)
            if len(rows) == 0:
                continue
            own = slice(rows[0], rows[-1] + 1)
            band = part._replace(row=part.row + int(rows[0]), height=int(rows[-1] - rows[0]) + 1)
            _add_rows(*self.blur.around(band, _STEP**number, scratch), weight[own], begun[own], smooth[own])
        return smooth


def direct_pattern(shown: Floats, calm: Floats, veil: Floats, share: Floats) -> Floats:
    """Return r (..., 3), the light on the receiver over its mean; at least a little above the ambient share."""
    base = calm - veil
    r = np.where(base > LEAST_LIGHT, (shown - veil) / np.maximum(base, LEAST_LIGHT), 1.0)
    return np.maximum(r, share + LEAST_DIRECT * (1.0 - share))


@exact
def _add_rows(image: Any, row: int, column: int, weight: Any, begun: Any, smooth: Any) -> None:
    """Add rows of an image, from a row and a column on, times weights (h,), to those of `smooth` (h, w, 3); rows that
    are not `begun` (h,) are set.
    """
    across = 3 * smooth.shape[1]
    for r in range(len(weight)):
        line = image[row + r].reshape(-1)[3 * column : 3 * column + across]
        out, by = smooth[r].reshape(-1), weight[r]
        if begun[r]:
            for i in range(across):
                out[i] += by * line[i]
        else:
            for i in range(across):
                out[i] = by * line[i]
        begun[r] = True


@exact
def _draw_from(shown: Any, strength: Any, calm: Any) -> None:
    """Set `calm` (n,) to values (n,) that are drawn towards it by a strength."""
    for i in range(len(calm)):
        calm[i] = shown[i] + strength * (calm[i] - shown[i])


def _widened(image: Floats) -> NDArray[np.float32]:
    """Return an image (h, w, 3) of finite float16 or of floats as float32."""
    if image.dtype != np.float16:
        return image.astype(np.float32)
    bits = np.empty(image.shape, np.uint32)
    _widen(image.view(np.uint16), bits)
    return bits.view(np.float32) * _HALF_BIAS


@exact
def _widen(halves: Any, bits: Any) -> None:
    """Write the bits of float16 (h, w, 3) as those of float32 that are smaller by `_HALF_BIAS`."""
    for row in range(bits.shape[0]):
        for column in range(bits.shape[1]):
            for k in range(3):
                half = np.uint32(halves[row, column, k])
                bits[row, column, k] = (half & np.uint32(0x8000)) << np.uint32(16) | (
                    half & np.uint32(0x7FFF)
                ) << np.uint32(13)
