# SPDX-License-Identifier: Apache-2.0
"""The plate interface of the light stages: a coarse map of the whole sphere, and samples in any direction."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import LUMINANCE
from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, REFRACTIVE_INDEX_SEA
from mr360uw.ibl.expansion import expand
from mr360uw.ibl.level.tilt import LEVEL, elevation_sine
from mr360uw.ibl.reduce import reduce_map, reduce_maximum
from mr360uw.ibl.settings import LightSettings
from mr360uw.sphere import Array, directions, frame_from_direction, row_solid_angle
from mr360uw.types import Floats

COARSE_SCALE = 4
COARSE_COLUMNS, COARSE_ROWS = ENVIRONMENT_COLUMNS * COARSE_SCALE, ENVIRONMENT_ROWS * COARSE_SCALE
"""Pixels of the coarse map: 1.4 degrees, fine enough for 0.5 % of irradiance, small enough to be free."""


@functools.cache
def coarse_directions() -> Floats:
    """Return the directions of the coarse map's pixels, (128, 256, 3)."""
    return directions(COARSE_COLUMNS, COARSE_ROWS).astype(np.float32)


@functools.cache
def coarse_solid_angle() -> Floats:
    """Return the solid angles [sr] of the coarse map's pixels, (128, 1)."""
    return row_solid_angle(COARSE_COLUMNS, COARSE_ROWS).astype(np.float32)[:, None]


class Plate(Protocol):
    """A plate for the sun detector and the environment, independent of its storage (floats or planes)."""

    @property
    def coarse(self) -> Floats:
        """Means of the expanded radiance, (128, 256, 3)."""

    @property
    def brightest(self) -> Floats:
        """Largest luminance of the plate's pixels inside each coarse pixel before expansion, (128, 256)."""

    @property
    def up(self) -> Array:
        """Direction (3,) of the world's up in the axes of the plate."""

    @property
    def refractive_index(self) -> float:
        """Refractive index of the water, which sets the width of Snell's window; without effect in air."""

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance before expansion (h, w, 3) in directions (h, w, 3)."""

    def look_expanded(self, direction: Floats) -> Floats:
        """Return the expanded radiance (h, w, 3) in directions (h, w, 3)."""


def plate_sines(plate: Plate) -> Floats:
    """Return the sine of the elevation of the coarse map's pixels, (128, 256)."""
    return elevation_sine(coarse_directions(), plate.up)


def remap(image: NDArray[Any], x: Floats, y: Floats) -> NDArray[Any]:
    """Return bilinear samples (h, w, ...) of an equirectangular image at continuous coordinates (h, w).

    Periodic across the seam; beyond the centres of the first and last rows the nearest row.
    """
    import cv2

    column, row = (x - 0.5).astype(np.float32), np.clip(y - 0.5, 0, image.shape[0] - 1).astype(np.float32)
    return cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


@dataclass(frozen=True, slots=True)
class LinearPlate:
    """A plate of linear floats, (H, W, 3), and its expansion."""

    image: NDArray[np.float32]
    expanded: NDArray[np.float32]
    coarse: Floats
    brightest: Floats
    up: Array
    refractive_index: float

    @classmethod
    def of(
        cls,
        image: NDArray[np.float32],
        settings: LightSettings | None = None,
        up: Array = LEVEL,
        refractive_index: float = REFRACTIVE_INDEX_SEA,
    ) -> LinearPlate:
        """Return the plate with its coarse maps worked out; without settings nothing is expanded."""
        expanded = image
        if settings is not None:
            expanded = expand(image, settings, up=up, refractive_index=refractive_index)
        return cls(
            image,
            expanded,
            reduce_map(expanded, COARSE_COLUMNS, COARSE_ROWS),
            reduce_maximum(image @ LUMINANCE.astype(np.float32), COARSE_COLUMNS, COARSE_ROWS),
            up,
            refractive_index,
        )

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        return self._sample(self.image, direction)

    def look_expanded(self, direction: Floats) -> Floats:
        """Return the expanded radiance (h, w, 3) in directions (h, w, 3)."""
        return self._sample(self.expanded, direction)

    @staticmethod
    def _sample(image: NDArray[np.float32], direction: Floats) -> Floats:
        return remap(image, *frame_from_direction(direction, image.shape[1], image.shape[0]))
