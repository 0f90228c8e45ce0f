# SPDX-License-Identifier: Apache-2.0
"""What is laid over a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.types.frames import Floats, Rectangle


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A rectangle of the frame that something was drawn into.

    column, row: top left pixel; 0 <= column < W and the tile never crosses the seam. All arrays are (h, w, ...).
    radiance: (h, w, 3) premultiplied by alpha. alpha: (h, w) coverage in [0, 1]. distance_m: (h, w) along the ray
    to the nearest object, infinity where there is none. ratio: (h, w, 3) factor on the surface part of the plate
    behind the object (shadow below 1, caustics about 1). veil: (h, w, 3) the part of the plate's radiance that the
    water between camera and receiver adds, on which no shadow falls. shafts: (h, w, 3) radiance that light in the water
    before the plate deviates by from the smooth veil, of either sign; None where it is zero.
    """

    column: int
    row: int
    radiance: Floats
    alpha: Floats
    distance_m: Floats
    ratio: Floats
    veil: Floats
    shafts: Floats | None = None

    @property
    def rectangle(self) -> Rectangle:
        """Where the tile lies in the frame."""
        height, width = self.alpha.shape
        return Rectangle(self.column, self.row, width, height)

    @property
    def window(self) -> tuple[slice, slice]:
        """The tile's rows and columns, to index a full frame with."""
        height, width = self.alpha.shape
        return slice(self.row, self.row + height), slice(self.column, self.column + width)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """What is laid over a plate: disjoint tiles of a height x width frame; everything else stays untouched."""

    height: int
    width: int
    tiles: tuple[Tile, ...]

    def _full(self, name: str, background: float, channels: int) -> Floats:
        shape = (self.height, self.width, channels) if channels else (self.height, self.width)
        image = np.full(shape, background, np.float32)
        for tile in self.tiles:
            if (values := getattr(tile, name)) is not None:
                image[tile.window] = values
        return image

    @property
    def radiance(self) -> Floats:
        """Premultiplied radiance of the whole frame, (H, W, 3)."""
        return self._full("radiance", 0.0, 3)

    @property
    def alpha(self) -> Floats:
        """Coverage of the whole frame, (H, W)."""
        return self._full("alpha", 0.0, 0)

    @property
    def distance_m(self) -> Floats:
        """Ray distance of the whole frame, (H, W), infinity where there is no object."""
        return self._full("distance_m", np.inf, 0)

    @property
    def ratio(self) -> Floats:
        """Receiver ratio of the whole frame, (H, W, 3), 1 where nothing changes."""
        return self._full("ratio", 1.0, 3)

    @property
    def shafts(self) -> Floats:
        """Deviation of the light in the water of the whole frame, (H, W, 3), of either sign."""
        return self._full("shafts", 0.0, 3)
