# SPDX-License-Identifier: Apache-2.0
"""The `[sea]` and `[caustics]` tables of a scene."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Tag, field_validator

from mr360uw.caustics.sea.gerstner import GerstnerSea
from mr360uw.caustics.sea.spectral import SpectralSea
from mr360uw.constants import SUN_HALF_ANGLE_RAD
from mr360uw.parameters import Parameters, advanced, parameter

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


class CausticSettings(Parameters):
    """Method and resolution of the caustics."""

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
