# SPDX-License-Identifier: Apache-2.0
"""The `[sea]` and `[caustics]` tables of a scene.

The cells of the surface that a sea's caustics need follow from its shortest waves and the blur of its light. Inside a
cell g wide a ray's slope is interpolated linearly. A ray is then off by f d g^2/8 times the second derivative of the
surface's slope, d the depth and f = 1 - 1/n. Sun's disc and short waves blur the light with the standard deviation b d.
As both grow with depth alike, the error of a map goes with the ratio

    r = f g^2/8 m/b        m^2 = sum k^6 A^2/2, the variance of the second derivative of the surface's slope
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Tag, field_validator

from mr360uw.cache import shared
from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.caustics.spectral import SpectralSea
from mr360uw.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.parameters import Parameters, advanced, listed, parameter

_RATIO = 0.11
"""Greatest r. The error of maps with the sun overhead is 0.3 to 0.7 r of their standard deviation, as measured.

Twice as large, grids have 0.7 times the cells across and twice the error.
"""
_STEP, _FEWEST, _MOST = 32, 64, 256
"""Grids are multiples of a step in a range. 256 cells take about twice the time of 128."""
_SAMPLES = 256
"""Points across the tile that the waves' spectrum is taken of."""


def cells_across(sea: Sea, sun_half_angle_rad: float) -> int:
    """Return the cells of the surface across the tile that keep the error of its caustics at about 0.05."""
    bend = 1.0 - 1.0 / REFRACTIVE_INDEX_SEA
    blur = math.hypot(bend * sea.blur_slope / math.sqrt(2.0), 0.5 * sun_half_angle_rad / REFRACTIVE_INDEX_SEA)
    bent = _second_derivative_of_slope(sea)
    if bent == 0.0:
        return _FEWEST
    cell_m = math.sqrt(8.0 * _RATIO * blur / (bend * bent))
    return int(np.clip(_STEP * math.ceil(sea.tile_m / max(cell_m, 1e-9 * sea.tile_m) / _STEP), _FEWEST, _MOST))


def grid_of(settings: CausticSettings, sea: Sea) -> int:
    """Return the cells across the tile that settings give, or that the sea needs."""
    return cells_across(sea, settings.sun_half_angle_rad) if settings.grid is None else settings.grid


@shared(keep=32)
def _second_derivative_of_slope(sea: Sea) -> float:
    """Return m [1/m^2] of the surface at time 0."""
    spectrum = np.fft.fft2(sea.grid_fields(_SAMPLES, 0.0).height) / _SAMPLES**2
    k = 2.0 * np.pi * np.fft.fftfreq(_SAMPLES, sea.tile_m / _SAMPLES)
    return math.sqrt(float(np.sum(np.abs(spectrum) ** 2 * (k[:, None] ** 2 + k**2) ** 3)))


Method = Literal["exact", "ratio", "fan", "jacobian", "scrolling"]
"""exact: flux by exact coverage. The others are published methods, see `published`."""
DIVIDED_AREAS: tuple[Method, ...] = ("ratio", "fan", "jacobian")
"""The methods of `published.divided_areas`."""


def _sea_model(value: Any) -> str:
    return str(value.get("model", "gerstner") if isinstance(value, dict) else getattr(value, "model", "gerstner"))


Sea = Annotated[
    Annotated[GerstnerSea, Tag("gerstner")] | Annotated[SpectralSea, Tag("spectral")], Discriminator(_sea_model)
]
"""A sea of either kind, chosen by `model`; Gerstner by default."""


@listed
class CausticSettings(Parameters):
    """Method and resolution of the caustics.

    The `[caustics]` table of a scene, and the `settings` of library calls. Time goes with the pixels of the maps, the
    cells of the surface and the planes.

    Raises
    ------
    ParameterError
        If a value is out of its range; the message names it.

    See Also
    --------
    uw.caustics.caustic_stack : Takes them.
    uw.Scene : Has them as `caustics`.

    Examples
    --------
    >>> uw.caustics.CausticSettings(size=64).size
    64
    """

    enabled: bool = parameter(True, "whether the surface focuses light")
    method: Method = parameter(
        "exact", "exact conserves energy; ratio, fan, jacobian, scrolling: as published", internal="comparisons"
    )
    size: int = advanced(
        512, "pixels of the map across the sea's tile, a power of two; fewer where no picture shows them",
        low=16, high=4096,
    )  # fmt: skip
    grid: int | None = advanced(
        None, "cells of the surface across the tile; none: as many as the sea needs, 64 to 256", low=4, high=2048
    )
    planes: int = parameter(
        4, "most depths that a frame's caustics are computed at", low=1, high=64, internal="draw.quality"
    )
    chromatic: Literal[1, 3] = advanced(1, "1: one refractive index; 3: one for each of red, green and blue")
    sun_half_angle_rad: float = parameter(
        SUN_HALF_ANGLE_RAD, "angular radius of the sun's disc in air; larger for haze", unit="rad", low=0.0, high=0.5
    )

    @field_validator("size")
    @classmethod
    def _power_of_two(cls, size: int) -> int:
        if size & (size - 1):
            raise ValueError(f"must be a power of two (got {size}): 128, 256, 512")
        return size
