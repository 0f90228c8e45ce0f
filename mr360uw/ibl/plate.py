# SPDX-License-Identifier: Apache-2.0
"""The plate interface of the light stages: a coarse map of the whole sphere, and samples in any direction.

Parts of the sphere are looked at in equal-area patches about one direction (Lambert's azimuthal projection), without
seam and poles. A direction at an angle from the centre lies 2 sin(angle/2) from it on the patch, y upwards. Every pixel
has the same solid angle, and discs about the centre stay round.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import LUMINANCE
from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, REFRACTIVE_INDEX_SEA
from mr360uw.ibl.expansion import expand
from mr360uw.ibl.reduce import reduce_map, reduce_maximum
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.tilt import LEVEL, elevation_sine
from mr360uw.sphere import Array, directions, frame_from_direction, row_solid_angle, unit
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
    """A plate for the sun detector and the environment, independent of its storage (floats or planes).

    coarse: (128, 256, 3) means of the expanded radiance. brightest: (128, 256) largest luminance of the plate's pixels
    inside each coarse pixel before expansion. up: (3,) direction of the world's up in the axes of the plate.
    refractive_index: of the water, which sets the width of Snell's window; without effect in air.
    """

    coarse: Floats
    brightest: Floats
    up: Array
    refractive_index: float

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


class LinearPlate:
    """A plate of linear floats, (H, W, 3), and its expansion; without settings nothing is expanded."""

    def __init__(
        self,
        image: NDArray[np.float32],
        settings: LightSettings | None = None,
        up: Array = LEVEL,
        refractive_index: float = REFRACTIVE_INDEX_SEA,
    ) -> None:
        self.image = self.expanded = image
        if settings is not None:
            self.expanded = expand(image, settings, up=up, refractive_index=refractive_index)
        self.coarse = reduce_map(self.expanded, COARSE_COLUMNS, COARSE_ROWS)
        self.brightest = reduce_maximum(image @ LUMINANCE.astype(np.float32), COARSE_COLUMNS, COARSE_ROWS)
        self.up, self.refractive_index = up, refractive_index

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        return self._sample(self.image, direction)

    def look_expanded(self, direction: Floats) -> Floats:
        """Return the expanded radiance (h, w, 3) in directions (h, w, 3)."""
        return self._sample(self.expanded, direction)

    @staticmethod
    def _sample(image: NDArray[np.float32], direction: Floats) -> Floats:
        return remap(image, *frame_from_direction(direction, image.shape[1], image.shape[0]))


def tangent_frame(direction: ArrayLike) -> tuple[Array, Array, Array]:
    """Return (right, up, direction), orthonormal, for a direction (3,)."""
    d = unit(direction)
    x, y, z = map(float, d)
    low = abs(y) < 0.9  # away from the poles +y is the other axis, near them +z
    size = math.hypot(x, z if low else y)
    a, b, c = (-z / size, 0.0, x / size) if low else (y / size, -x / size, 0.0)
    return np.array([a, b, c]), np.array([b * z - c * y, c * x - a * z, a * y - b * x]), d


def patch_step(radius_rad: float, size: int) -> float:
    """Return the side of a pixel of a patch of `size` pixels; its square is the pixel's solid angle [sr]."""
    return 4.0 * math.sin(min(0.5 * radius_rad, 0.5)) / size


def patch_directions(direction: ArrayLike, radius_rad: float, size: int) -> Array:
    """Return the unit directions (size, size, 3) of a square patch about `direction`.

    Its inscribed circle has `radius_rad`, at most one radian, so that the corners stay on the sphere.
    """
    x = (np.arange(size) - 0.5 * (size - 1)) * patch_step(radius_rad, size)
    square = (x * x)[None, :] + (x * x)[:, None]
    ratio = np.sqrt(1.0 - 0.25 * square)
    place = np.empty((size, size, 3))
    np.multiply(ratio, x[None, :], out=place[..., 0])
    np.multiply(ratio, -x[:, None], out=place[..., 1])
    np.subtract(1.0, 0.5 * square, out=place[..., 2])
    out: Array = place @ np.stack(tangent_frame(direction))
    return out
