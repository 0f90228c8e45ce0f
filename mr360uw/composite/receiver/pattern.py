# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics on the receiver, which a shadow takes away with the light that bears them.

    r = (plate - veil)/(calm - veil) = share + (1 - share) c        ratio = (share free + (r - share) V waves + added)/r

with `calm` the plate in the mean light of its waves, c the plate's own caustic factor, share the ambient fraction of
the mean light, V the visible fraction of the sun. In the umbra the plate becomes calm times its ambient light: no
filament runs on through it. Where nothing blocks the sun the ratio is 1 and the plate is left as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats, Rectangle

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
_FINE_SIGMA = 2.0
"""Standard deviation [px] that wide blurs are left with on a reduced image."""
_COARSEST = 32
"""Largest reduction."""
_RADIUS = 4.0
"""Radius of OpenCV's Gaussian of floats, in standard deviations."""
_HALF_BIAS = np.float32(2.0**112)
"""Ratio of the exponents' biases of float32 and float16, which turns the bits of one into the other."""
_FLATTEST = 0.02
"""Least sine of the angle below the horizon: nearer to it ground is too far away for its caustics to be seen."""


class Picture(Protocol):
    """A plate's frame."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def linear(self, rectangle: Rectangle) -> Floats:
        """Return a part of it as linear light (h, w, 3)."""

    def lent(self, rectangle: Rectangle) -> Floats:
        """Return the same, read-only, of a part that is read again when the frame is composited."""


@dataclass(frozen=True, slots=True, eq=False)
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

    def light(self, part: Rectangle) -> tuple[Floats, Floats]:
        """Return the frame and its calm state over a part of it, each (h, w, 3) float32."""
        shown = np.asarray(self.picture.lent(part), np.float32)
        if self.mean is not None:
            rows, columns = slice(part.row, part.row + part.height), slice(part.column, part.column + part.width)
            return shown, _widened(self.mean[rows, columns])
        return shown, shown + np.float32(self.strength) * (self._smooth(part) - shown)

    def _smooth(self, part: Rectangle) -> Floats:
        """Return a part blurred by `_SIGMA_M` on level ground, row by row."""
        height, width = self.picture.shape
        latitude = np.pi * ((np.arange(part.height) + part.row + 0.5) / height - 0.5)
        distance = self.height_m / np.maximum(np.sin(latitude), _FLATTEST)
        sigma = np.clip(_SIGMA_M / distance * height / np.pi, 1.0, width / 16)
        level = np.log(sigma) / np.log(_STEP)
        low, high = int(np.floor(level.min())), int(np.floor(level.max())) + 1
        margin = int(np.ceil(3.0 * _STEP**high))
        around, first = _around(self.picture, part, margin)
        smooth = np.zeros((part.height, part.width, 3), np.float32)
        for number in range(low, high + 1):
            weight = np.maximum(1.0 - np.abs(level - number), 0.0).astype(np.float32)
            rows = np.flatnonzero(weight)
            if len(rows) == 0:
                continue
            # rows that this blur reaches, from and to multiples of `_COARSEST` of the frame's
            own, reach = slice(rows[0], rows[-1] + 1), int(_RADIUS * _STEP**number) + _COARSEST
            top, left = part.row - first.row, part.column - first.column
            begin = max(top + own.start - reach, 0) // _COARSEST * _COARSEST
            end = -(-(top + own.stop + reach) // _COARSEST) * _COARSEST
            blurred = _blurred(around[begin:end], _STEP**number)[top + own.start - begin : top + own.stop - begin]
            smooth[own] += weight[own, None, None] * blurred[:, left : left + part.width]
        return smooth


def direct_pattern(shown: Floats, calm: Floats, veil: Floats, share: Floats) -> Floats:
    """Return r (..., 3), the light on the receiver over its mean; at least a little above the ambient share."""
    base = calm - veil
    r = np.where(base > LEAST_LIGHT, (shown - veil) / np.maximum(base, LEAST_LIGHT), 1.0)
    return np.maximum(r, share + LEAST_DIRECT * (1.0 - share))


def _widened(image: Floats) -> NDArray[np.float32]:
    """Return an image (h, w, 3) of finite float16 or of floats as float32."""
    if image.dtype != np.float16:
        return image.astype(np.float32)
    bits = np.empty(image.shape, np.uint32)
    _widen(image.view(np.uint16), bits)
    return bits.view(np.float32) * _HALF_BIAS


@numba.njit(nogil=True, cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _widen(halves: Any, bits: Any) -> None:
    """Write the bits of float16 (h, w, 3) as those of float32 that are smaller by `_HALF_BIAS`."""
    for row in range(bits.shape[0]):
        for column in range(bits.shape[1]):
            for k in range(3):
                half = np.uint32(halves[row, column, k])
                bits[row, column, k] = (half & np.uint32(0x8000)) << np.uint32(16) | (
                    half & np.uint32(0x7FFF)
                ) << np.uint32(13)


def _around(picture: Picture, part: Rectangle, margin: int) -> tuple[Floats, Rectangle]:
    """Return a part of a panorama with at least `margin` pixels about it, and where that lies.

    It is closed over the seam, cut at the poles, and begins and ends at multiples of `_COARSEST`, so that what is
    reduced below does not depend on the part. Columns count from the part's own turn.
    """
    height, width = picture.shape
    row = max(part.row - margin, 0) // _COARSEST * _COARSEST
    column = (part.column - margin) // _COARSEST * _COARSEST
    rows = min(-(-(part.row + part.height + margin) // _COARSEST) * _COARSEST, height) - row
    last = -(-(part.column + part.width + margin) // _COARSEST) * _COARSEST
    whole = np.asarray(picture.linear(Rectangle(0, row, width, rows)), np.float32)
    columns = np.arange(column, last) % width
    return whole[:, columns], Rectangle(column, row, len(columns), rows)


def _blurred(image: Floats, sigma: float) -> Floats:
    """Return an image (h, w, 3) under a Gaussian, which wide ones are applied to a reduced image for."""
    import cv2

    factor = min(1 << max(int(np.log2(sigma / _FINE_SIGMA)), 0), _COARSEST)
    if factor == 1:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE))
    height, width = image.shape[:2]
    padded = image
    if height % factor or width % factor:
        padded = cv2.copyMakeBorder(image, 0, -height % factor, 0, -width % factor, cv2.BORDER_REPLICATE)
    size = padded.shape[1] // factor, padded.shape[0] // factor
    small = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma / factor, borderType=cv2.BORDER_REPLICATE)
    large = cv2.resize(small, padded.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[:height, :width])
