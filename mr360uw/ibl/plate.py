# SPDX-License-Identifier: Apache-2.0
"""A plate as the light stages look at it: a coarse map of the whole, and a close look at any direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.ibl.reduce import reduce_map, reduce_maximum
from mr360uw.sphere import frame_from_direction
from mr360uw.types import Floats

COARSE_SCALE = 4
COARSE_COLUMNS, COARSE_ROWS = 64 * COARSE_SCALE, 32 * COARSE_SCALE
"""Pixels of the coarse map: 1.4 degrees, fine enough for 0.5 % of irradiance, small enough to be free."""


class Plate(Protocol):
    """What the sun detector and the environment need to know of a plate, whatever its storage."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    @property
    def coarse(self) -> Floats:
        """Means of the linear plate before expansion, (128, 256, 3)."""

    @property
    def brightest(self) -> Floats:
        """Largest luminance of the plate's pixels inside each coarse pixel, (128, 256)."""

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (..., 3) in directions (..., 3)."""


def remap(image: NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16], x: Floats, y: Floats) -> Floats:
    """Return bilinear samples (h, w, ...) of an equirectangular image at continuous coordinates (h, w)."""
    import cv2

    x, y = (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32)
    return cv2.remap(image, x, np.clip(y, 0, image.shape[0] - 1), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


@dataclass(frozen=True, slots=True)
class LinearPlate:
    """A plate of linear floats, (H, W, 3)."""

    image: NDArray[np.float32]
    coarse: Floats
    brightest: Floats

    @classmethod
    def of(cls, image: NDArray[np.float32]) -> LinearPlate:
        """Return the plate with its coarse maps worked out."""
        luminance_map = image @ np.array([0.2126, 0.7152, 0.0722], np.float32)
        return cls(
            image,
            reduce_map(image, COARSE_COLUMNS, COARSE_ROWS),
            reduce_maximum(luminance_map, COARSE_COLUMNS, COARSE_ROWS),
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.image.shape[1], self.image.shape[0]

    def look(self, direction: Floats) -> Floats:
        """Return the linear radiance (h, w, 3) in directions (h, w, 3)."""
        return remap(self.image, *frame_from_direction(direction, *self.size))
