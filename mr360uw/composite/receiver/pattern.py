# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics on the receiver, which a shadow takes away with the light that bears them.

    r = (plate - veil)/(calm - veil) = share + (1 - share) c        ratio = (share free + (r - share) V waves + added)/r

with `calm` the plate in the mean light of its waves, c the plate's own caustic factor, share the ambient fraction of
the mean light, V the visible fraction of the sun. In the umbra the plate becomes calm times its ambient light: no
filament runs on through it. Where nothing blocks the sun the ratio is 1 and the plate is left as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mr360uw.types import Floats, Rectangle

LEAST_LIGHT = 1e-3
"""Linear light above the veil below which a pattern is taken for noise: a quarter of an 8-bit code near black."""
LEAST_DIRECT = 0.02
"""Least direct light over the mean that is left beside the ambient: filaments are bright, what lies between them is not
quite without sun."""
_SIGMA_M = 0.3
"""Standard deviation on the ground of the blur that takes caustics for detail: filaments are 5 to 30 cm apart in the
first ten metres. Half of it leaves broad filaments, twice of it takes away ripples of the sand."""
_STEP = 2.0**0.5
"""Ratio of neighbouring blurs, between which the blur of a row is mixed."""


class Picture(Protocol):
    """A plate's frame."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def linear(self, rectangle: Rectangle) -> Floats:
        """Return a part of it as linear light (h, w, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class PlatePattern:
    """A plate's frame and how it would look in the mean light of its waves.

    mean: (H, W, 3) of the clip where the camera stands, or None: then detail of the size of caustics is smoothed.
    height_m: of the camera above the ground, for that size. strength: fraction of the detail that is caustics, 0 to 1.
    """

    picture: Picture
    mean: Floats | None
    height_m: float
    strength: float

    def light(self, part: Rectangle) -> tuple[Floats, Floats]:
        """Return the frame and its calm state over a part of it, each (h, w, 3) float32."""
        shown = np.asarray(self.picture.linear(part), np.float32)
        if self.mean is not None:
            rows = slice(part.row, part.row + part.height)
            calm = self.mean[rows, part.column : part.column + part.width].astype(np.float32)
        else:
            calm = self._smooth(part)
        return shown, shown + np.float32(self.strength) * (calm - shown)

    def _smooth(self, part: Rectangle) -> Floats:
        """Return a part blurred by `_SIGMA_M` on level ground, row by row."""
        import cv2

        height, width = self.picture.shape
        latitude = np.pi * ((np.arange(part.height) + part.row + 0.5) / height - 0.5)
        distance = self.height_m / np.maximum(np.sin(latitude), 0.02)
        sigma = np.clip(_SIGMA_M / distance * height / np.pi, 1.0, width / 16)
        level = np.log(sigma) / np.log(_STEP)
        low, high = int(np.floor(level.min())), int(np.floor(level.max())) + 1
        margin = int(np.ceil(3.0 * _STEP**high))
        around = _around(self.picture, part, margin)
        smooth = np.zeros((part.height, part.width, 3), np.float32)
        for number in range(low, high + 1):
            weight = np.maximum(1.0 - np.abs(level - number), 0.0).astype(np.float32)
            if not np.any(weight):
                continue
            blurred = cv2.GaussianBlur(around, (0, 0), _STEP**number, borderType=cv2.BORDER_REPLICATE)
            top, left = min(margin, part.row), margin
            smooth += weight[:, None, None] * blurred[top : top + part.height, left : left + part.width]
        return smooth


def direct_pattern(shown: Floats, calm: Floats, veil: Floats, share: Floats) -> Floats:
    """Return r (..., 3), the light on the receiver over its mean; at least a little above the ambient share."""
    base = calm - veil
    r = np.where(base > LEAST_LIGHT, (shown - veil) / np.maximum(base, LEAST_LIGHT), 1.0)
    return np.maximum(r, share + LEAST_DIRECT * (1.0 - share))


def _around(picture: Picture, part: Rectangle, margin: int) -> Floats:
    """Return a part of a panorama and `margin` pixels about it, (h, w, 3), closed over the seam, cut at the poles."""
    height, width = picture.shape
    first, last = max(part.row - margin, 0), min(part.row + part.height + margin, height)
    columns = (np.arange(part.column - margin, part.column + part.width + margin)) % width
    if len(columns) >= width:
        return np.asarray(picture.linear(Rectangle(0, first, width, last - first)), np.float32)[:, columns]
    cut = int(np.argmax(columns == 0)) if columns[0] > columns[-1] else 0
    pieces = [(int(columns[0]), cut), (0, len(columns) - cut)] if cut else [(int(columns[0]), len(columns))]
    rows = [picture.linear(Rectangle(start, first, count, last - first)) for start, count in pieces]
    return np.asarray(np.concatenate(rows, axis=1), np.float32)
