# SPDX-License-Identifier: Apache-2.0
"""A square of level floor, and the plate's light on it, laid out in the world: column = +x, row = +z.

The camera's position and rotation are taken from every frame's place in the world, so a floor that stands still stands
still here. Seen from above with forward (-z) at the top.

The plate's floor and our caustics are read through the same pixels by the same interpolation. A pattern that is read in
another way differs in its finest detail by 10 to 20 %, and so does the wind that is fitted to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.lookup import veil_lookup
from mr360uw.sphere import direction_from_frame, frame_from_direction
from mr360uw.types import Floats, MediumTable

Array = NDArray[np.float64]

_FINER = 2
"""Points across a pixel of the region, whose mean it is: the plate's pixels below the camera are finer."""
_LEAST_DOWN = 0.02
"""Sine of the angle below the horizon that pixels are taken to have at least: rays that miss the floor are not read."""
_MOST_BLUR = 0.7
"""Greatest standard deviation [pixels] of a blur by three taps; beyond, the middle one would vanish."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorView:
    """Where a frame shows a region, for one place and rotation of the camera.

    rows: [first, last) of the frame that hold the region. x_m, z_m, footprint_m: (h, W) of these pixels on the floor,
    the footprint as the side of a square of their area. column, row: (2 n, 2 n) where points of the region lie in the
    picture of these rows with a border of one pixel, as `cv2.remap` takes them.
    """

    rows: tuple[int, int]
    x_m: Array
    z_m: Array
    footprint_m: Array
    column: NDArray[np.float32]
    row: NDArray[np.float32]

    @classmethod
    def of(cls, grid: FloorGrid, position: Floats, rotation: Floats, width: int, height: int) -> FloorView:
        """Return the view of a region from a camera at `position` (3,), `rotation` (3, 3) world_from_camera."""
        x, z = grid.places(_FINER)
        ray = np.stack([x - position[0], np.full_like(x, grid.floor_y - position[1]), z - position[2]], axis=-1)
        column, row = frame_from_direction(ray @ rotation, width, height)
        first, last = max(int(row.min() - 0.5), 0), min(int(row.max() + 0.5) + 1, height)
        pixels = direction_from_frame(np.arange(width) + 0.5, np.arange(first, last)[:, None] + 0.5, width, height)
        across, down, along = np.moveaxis(pixels @ np.asarray(rotation, np.float64).T, -1, 0)
        sine = np.maximum(-down, _LEAST_DOWN)
        distance = (position[1] - grid.floor_y) / sine
        at = (column + 0.5).astype(np.float32), (row - first + 0.5).astype(np.float32)
        footprint = distance * (np.pi / height) / np.sqrt(sine)
        return cls((first, last), position[0] + distance * across, position[2] + distance * along, footprint, *at)

    def read(self, picture: Any, blur: float = 0.0) -> NDArray[np.float32]:
        """Return the region (n, n, ...) in a picture (h, W, ...) of the rows. blur: standard deviation [pixels]."""
        import cv2

        around = cv2.copyMakeBorder(np.asarray(picture, np.float32), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        around[1:-1, 0], around[1:-1, -1] = picture[:, -1], picture[:, 0]
        if blur > 0.0:
            side = 0.5 * min(blur, _MOST_BLUR) ** 2
            taps = np.array([side, 1.0 - 2.0 * side, side])
            around = cv2.sepFilter2D(around, -1, taps, taps, borderType=cv2.BORDER_REPLICATE)
        fine = cv2.remap(around, self.column, self.row, cv2.INTER_LINEAR)
        n = len(fine) // _FINER
        return np.asarray(fine.reshape(n, _FINER, n, _FINER, *fine.shape[2:]).mean(axis=(1, 3)))


_SIDE_PER_HEIGHT = 4.0
"""Side of the region by default, over the camera's height above it: rays fall at 20 degrees and steeper. Half as large,
it holds a quarter of the waves; twice as large, pixels at its edges show no detail of caustics."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorGrid:
    """The pixels of a square region on the level floor, `count` across.

    x_m, z_m: its middle in the world. size_m: its side. floor_y: height of the floor.
    """

    x_m: float
    z_m: float
    size_m: float
    floor_y: float
    count: int

    @classmethod
    def below(cls, positions: Array, floor_y: float, count: int) -> FloorGrid:
        """Return the square below and around camera positions (n, 3)."""
        x, y, z = positions.mean(axis=0)
        return cls(float(x), float(z), _SIDE_PER_HEIGHT * float(y - floor_y), floor_y, count)

    @property
    def pixel_m(self) -> float:
        """Side of a pixel [m]."""
        return self.size_m / self.count

    def places(self, finer: int = 1) -> tuple[Array, Array]:
        """Return x and z (n, n) [m] of the pixels' centres, or of `finer` points across each."""
        n = self.count * finer
        along = ((np.arange(n) + 0.5) / n - 0.5) * self.size_m
        x, z = np.broadcast_arrays(self.x_m + along, (self.z_m + along)[:, None])
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
