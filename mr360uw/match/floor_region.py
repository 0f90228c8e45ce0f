# SPDX-License-Identifier: Apache-2.0
"""A square of level floor, and the plate's light on it, laid out in the world: column = +x, row = +z.

The camera's position and rotation are taken from every frame's place in the world, so a floor that stands still stands
still here. Seen from above with forward (-z) at the top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.medium.lookup import veil_lookup
from mr360uw.types import Floats, MediumTable

Array = NDArray[np.float64]

_SIDE_PER_HEIGHT = 4.0
"""Side of the region by default, over the camera's height above it: rays fall at 20 degrees and steeper. Half as large,
it holds a quarter of the waves; twice as large, pixels at its edges show no detail of caustics."""


@dataclass(frozen=True, slots=True)
class FloorRegion:
    """A square on the level floor. x_m, z_m: its middle in the world. size_m: its side."""

    x_m: float
    z_m: float
    size_m: float

    def __post_init__(self) -> None:
        values = (self.x_m, self.z_m, self.size_m)
        if not np.all(np.isfinite(values)) or self.size_m <= 0.0:
            raise ParameterError(f"region - must be x, z and a side > 0 in metres (got {values}) - correct it")

    @classmethod
    def below(cls, positions: Array, floor_y: float) -> FloorRegion:
        """Return the square below and around camera positions (n, 3)."""
        x, y, z = positions.mean(axis=0)
        return cls(float(x), float(z), _SIDE_PER_HEIGHT * float(y - floor_y))


@dataclass(frozen=True, slots=True, eq=False)
class FloorGrid:
    """The pixels of a region on the plane y = `floor_y`, `count` across."""

    region: FloorRegion
    floor_y: float
    count: int

    @property
    def pixel_m(self) -> float:
        """Side of a pixel [m]."""
        return self.region.size_m / self.count

    def places(self, finer: int = 1) -> tuple[Array, Array]:
        """Return x and z (n, n) [m] of the pixels' centres, or of `finer` points across each."""
        n = self.count * finer
        along = ((np.arange(n) + 0.5) / n - 0.5) * self.region.size_m
        x, z = np.broadcast_arrays(self.region.x_m + along, (self.region.z_m + along)[:, None])
        return x, z

    def footprint_m(self, position: Array, pixel_rad: float) -> Array:
        """Return the width (n, n) [m] of the square that `FloorView.read` averages over at each pixel.

        A pixel of the plate is a square w wide, of the same area; it has the variance w^2/12, the linear interpolation
        between pixels w^2/6, and a pixel of the grid p^2/12: together those of a square of the width sqrt(3 w^2 + p^2).
        pixel_rad: angle of a pixel of the plate.
        """
        x, z = self.places()
        down = position[1] - self.floor_y
        distance = np.sqrt((x - position[0]) ** 2 + (z - position[2]) ** 2 + down**2)
        return np.sqrt(3.0 * (distance * pixel_rad) ** 2 * distance / down + self.pixel_m**2)

    def light(self, seen: Floats, position: Array, table: MediumTable) -> NDArray[np.float32]:
        """Return the light (n, n, 3) of the floor as it arrives at the camera, without the veil.

        seen: (n, n, 3) of the plate. table: of the water, its veil matched to the plate.
        """
        x, z = self.places()
        down = position[1] - self.floor_y
        distance = np.sqrt((x - position[0]) ** 2 + (z - position[2]) ** 2 + down**2)
        return np.asarray(seen - veil_lookup(table, distance, -down / distance), np.float32)
