# SPDX-License-Identifier: Apache-2.0
"""Parameters of one caustic map that OpenGL draws."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.detail_blur import LEAST_PIXELS, detail_footprint
from mr360uw.caustics.flux.sun_disc import footprint
from mr360uw.caustics.settings import Method

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class CausticPlane:
    """A plane at a depth, the sun above it and the map's size.

    travel: (2,) shift of the map per metre of depth. blur_slope: of the sea.
    """

    tile_m: float
    sun: Array
    depth_m: float
    size: int
    grid: int
    refractive_index: float
    sun_half_angle_rad: float
    method: Method
    travel: Array = field(default_factory=lambda: np.zeros(2))
    blur_slope: float = 0.0

    @property
    def uniforms(self) -> dict[str, Any]:
        """The uniforms that cell.vert, mesh.vert and vertices.frag share."""
        return {
            "grid": self.grid, "size": float(self.size), "depth": self.depth_m / self.tile_m, "travel": self.travel
        }  # fmt: skip

    @property
    def disc_radii(self) -> tuple[float, float]:
        """Half widths of the sun's image along x and z, in pixels."""
        x, z = np.linalg.norm(self._disc, axis=1) * (self.size / self.tile_m)
        return float(x), float(z)

    @property
    def detail_covariance(self) -> Array | None:
        """Covariance (2, 2) [pixel^2] of the blur by short waves and the sun's disc; None without short waves."""
        to_pixel = self.size / self.tile_m
        detail = to_pixel * detail_footprint(self.sun, self.refractive_index, self.blur_slope, self.depth_m)
        if np.linalg.norm(detail, 2) < LEAST_PIXELS:
            return None
        disc = to_pixel * self._disc
        return detail @ detail.T + 0.25 * disc @ disc.T  # of an evenly filled disc

    @property
    def _disc(self) -> Array:
        return footprint(self.sun, self.refractive_index, self.sun_half_angle_rad, self.depth_m)
