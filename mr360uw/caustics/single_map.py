# SPDX-License-Identifier: Apache-2.0
"""One caustic map on the world's grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.caustics.flux.irradiance import check_arguments, reference_map
from mr360uw.caustics.sea.base import SeaParameters
from mr360uw.caustics.settings import Method, Sea
from mr360uw.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.shapes import instance

Array = NDArray[np.floating[Any]]


def caustic_map(
    sea: Sea,
    sun_direction_in_air: ArrayLike,
    depth_m: float,
    time_s: float,
    size: int = 512,
    grid: int = 256,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    sun_half_angle_rad: float = SUN_HALF_ANGLE_RAD,
    method: Method = "exact",
) -> Array:
    """Return the irradiance ratio (size, size), mean 1, on the plane depth_m below the mean surface.

    Column = +x, row = +z; pixel (0, 0) spans [0, tile_m/size) from the world's origin, not shifted along the sun.
    sun_direction_in_air: (3,) towards the sun, above the horizon. grid: cells of the surface across the tile.
    Float64. Raises `ParameterError` for arguments outside their domain.
    """
    instance("sea", sea, SeaParameters, "make a GerstnerSea or a SpectralSea")
    sun = check_arguments(sun_direction_in_air, [depth_m], size, grid, refractive_index, sun_half_angle_rad)
    return reference_map(sea, sun, depth_m, time_s, size, grid, refractive_index, sun_half_angle_rad, method)
