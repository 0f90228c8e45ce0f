# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics on the receiver, which a shadow takes away with the light that bears them.

    r = (plate - veil)/(calm - veil) = share + (1 - share) c        ratio = (share free + (r - share) V waves + added)/r

with `calm` the plate in the mean light of its waves, c the plate's own caustic factor, share the ambient fraction of
the mean light, V the visible fraction of the sun. In the umbra the plate becomes calm times its ambient light: no
filament runs on through it. Where nothing blocks the sun the ratio is 1 and the plate is left as it is.

The blur that takes caustics for detail grows towards the camera, row by row. It is made at a few widths, of pictures
that are reduced as the blur is wide, and mixed between two of them where a pixel asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.tile_blend import (
    LEAST_DIRECT,
    LEAST_LIGHT,
    MOST_LOST,
    NO_BLURS,
    Blurs,
    Picture,
    calm_line,
    drawn_towards,
)
from mr360uw.jit import fast_making
from mr360uw.types import Floats, Rectangle

_FINE_SIGMA = 2.0
"""Standard deviation [px] that wide blurs are left with on a reduced picture."""
_COARSEST = 32
"""Largest reduction."""
_RADIUS = 4.0
"""Reach of a Gaussian, in standard deviations."""
_SIGMA_M = 0.3
"""Standard deviation on the ground of the blur that takes caustics for detail: filaments are 5 to 30 cm apart in the
first ten metres. Half of it leaves broad filaments, twice of it takes away ripples of the sand."""
_STEP = 2.0
"""Ratio of neighbouring blurs, between which the blur of a row is mixed."""
_FLATTEST = 0.02
"""Least sine of the angle below the horizon: nearer to it ground is too far away for its caustics to be seen."""


@dataclass(frozen=True, eq=False)
class PlatePattern:
    """A plate's frame and how it would look in the mean light of its waves.

    mean: (rows, W, 3) of the clip's last rows, which show the ground, where the camera stands; 0 is taken above them.
    None: then detail of the size of caustics is smoothed.
    height_m: of the camera above the ground, for that size. strength: fraction of that detail that is caustics, 0 to 1;
    a mean is the calm state as it is. white: light from which a channel of the plate is clipped.
    """

    picture: Picture
    mean: Floats | None
    height_m: float
    strength: float
    white: float = np.inf

    def light(self, part: Rectangle) -> tuple[Floats, Floats]:
        """Return the frame and its calm state over a part of it, each (h, w, 3) float32."""
        shown = np.asarray(self.picture.linear(part), np.float32)
        if self.mean is not None:
            return shown, self.mean_of(part)
        calm = np.empty_like(shown)
        _read(self.blurs(part), part.row, part.column, shown, np.float32(self.strength), calm)
        return shown, calm

    def mean_of(self, part: Rectangle) -> NDArray[np.float32]:
        """Return a part (h, w, 3) of the mean of the clip; none of it where there is none."""
        if self.mean is None:
            return np.zeros((0, 0, 3), np.float32)
        first = part.row - self.picture.shape[0] + len(self.mean)
        columns = slice(part.column, part.column + part.width)
        found = self.mean[max(first, 0) : max(first + part.height, 0), columns].astype(np.float32)
        return found if first >= 0 else np.pad(found, ((part.height - len(found), 0), (0, 0), (0, 0)))

    def blurs(self, part: Rectangle) -> Blurs:
        """Return the blurs by `_SIGMA_M` on level ground that a part of the frame is mixed from, none with a mean."""
        if self.mean is not None:
            return NO_BLURS
        # How wide the blur of each row is, as a fractional number of the widths that are made
        height, width = self.picture.shape
        latitude = np.pi * ((np.arange(part.height) + part.row + 0.5) / height - 0.5)
        distance = self.height_m / np.maximum(np.sin(latitude), _FLATTEST)
        sigma = np.clip(_SIGMA_M / distance * height / np.pi, 1.0, width / 16)
        level = np.log(sigma) / np.log(_STEP)
        low, high = int(np.floor(level.min())), int(np.floor(level.max())) + 1
        # Blur by each width the rows that are mixed from it
        pyramid, values, table, size = _Pyramid(self.picture, part, _STEP**high), [], [], 0
        for number in range(low, high + 1):
            rows = np.flatnonzero(np.abs(level - number) < 1.0)
            blurred, origin, factor = pyramid.blurred(_STEP**number, rows + part.row)
            values.append(blurred.reshape(-1))
            table.append((size, *origin, *blurred.shape[:2], factor))
            size += blurred.size
        level = (level - low).astype(np.float32)
        return Blurs(np.concatenate(values), np.array(table, np.int64).reshape(-1, 6), part.row, level)


class _Pyramid:
    """Reduced pictures about a part of a frame, a panorama closed over the seam, for blurs up to a width [px]."""

    def __init__(self, picture: Picture, part: Rectangle, widest: float) -> None:
        reach = int(_RADIUS * widest) + _COARSEST
        self._picture, self._height = picture, picture.shape[0]
        self._top = max(part.row - reach, 0) // _COARSEST * _COARSEST
        self._bottom = min(-(-(part.row + part.height + reach) // _COARSEST) * _COARSEST, self._height)
        self._left = (part.column - reach) // _COARSEST * _COARSEST
        self._right = -(-(part.column + part.width + reach) // _COARSEST) * _COARSEST
        self._reduced: dict[int, NDArray[np.float32]] = {}

    def blurred(self, sigma: float, rows: NDArray[np.int64]) -> tuple[NDArray[np.float32], tuple[int, int], int]:
        """Return rows of the part under a Gaussian of a standard deviation [px], on a picture that is reduced by a
        factor; the row and column of that picture where it begins, and the factor.
        """
        import cv2

        factor = min(1 << max(int(np.log2(sigma / _FINE_SIGMA)), 0), _COARSEST)
        if len(rows) == 0:
            return np.zeros((0, 0, 3), np.float32), (0, 0), factor
        reach = int(_RADIUS * sigma) + factor
        first, last = int(rows[0]) - reach, int(rows[-1]) + 1 + reach
        if factor == 1:
            top, cells = max(first, 0), self._joined(self._picture.linear, max(first, 0), min(last, self._height))
        else:
            whole, begin = self._by(factor), self._top // factor
            top = max(first // factor, begin)
            cells = whole[top - begin : -(-last // factor) - begin]
        blurred = cv2.GaussianBlur(cells, (0, 0), sigma / factor, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred), (top, self._left // factor), factor

    def _by(self, factor: int) -> NDArray[np.float32]:
        """Return the picture reduced by a factor of two or more."""
        import cv2

        if factor not in self._reduced:
            height, width = self._picture.shape
            if factor == 2 and height % 2 == width % 2 == 0:
                self._reduced[factor] = self._joined(self._picture.halved, self._top, self._bottom)
                return self._reduced[factor]
            finer = self._by(factor // 2) if factor > 2 else self._joined(self._picture.linear, self._top, self._bottom)
            even = cv2.copyMakeBorder(finer, 0, len(finer) % 2, 0, 0, cv2.BORDER_REPLICATE) if len(finer) % 2 else finer
            size = even.shape[1] // 2, even.shape[0] // 2
            self._reduced[factor] = np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA))
        return self._reduced[factor]

    def _joined(self, read: Callable[[Rectangle], Floats], top: int, bottom: int) -> NDArray[np.float32]:
        """Return the picture's rows [top, bottom) as `read` returns parts of them, over the seam."""
        left, width, parts = self._left, self._picture.shape[1], []
        while left < self._right:
            columns = min(self._right - left, width - left % width)
            parts.append(read(Rectangle(left % width, top, columns, bottom - top)))
            left += columns
        return np.asarray(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1), np.float32)


def direct_pattern(shown: Floats, calm: Floats, veil: Floats, share: Floats) -> Floats:
    """Return r (..., 3), the light on the receiver over its mean; at least a little above the ambient share."""
    base = calm - veil
    r = np.where(base > LEAST_LIGHT, (shown - veil) / np.maximum(base, LEAST_LIGHT), 1.0)
    return np.maximum(r, share + LEAST_DIRECT * (1.0 - share))


def lost_light(shown: Floats, r: Floats, white: float) -> Floats:
    """Return how many times the light that they show (..., 3) clipped channels have lost, 1 for others.

    Sunlight brightens all channels alike: the one whose r is greatest tells what the clipped ones would be.
    """
    return np.where(shown >= white, np.minimum(r.max(axis=-1, keepdims=True) / r, MOST_LOST), 1.0)


@fast_making
def _read(blurs: Any, row: int, column: int, shown: Any, strength: Any, calm: Any) -> None:
    """Write the calm state (h, w, 3) of a part that begins at (row, column) and is shown, (h, w, 3)."""
    line, own = np.empty((3, calm.shape[1]), np.float32), np.empty(3 * calm.shape[1] + 9, np.float32)
    for j in range(len(calm)):
        calm_line(blurs, row + j, column, own, line)
        for i in range(calm.shape[1]):
            for c in range(3):
                calm[j, i, c] = drawn_towards(shown[j, i, c], strength, line[c, i])
