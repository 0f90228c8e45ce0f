# SPDX-License-Identifier: Apache-2.0
"""Interface of directed lights: arriving light, caustic factor and visibility at points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """Light of one source at n points, without shadows and caustics.

    direction: (n, 3), or (3,) for all, unit, towards the light. irradiance: (n, 3) perpendicular to it, in plate
    radiance times sr. half_angle_rad: (n,), or a number for all, angular radius of the source.
    """

    direction: Floats
    irradiance: Floats
    half_angle_rad: Floats | float


class LightSource(Protocol):
    """One light in one shot. Points are from the camera, in the world's axes [m]."""

    @property
    def variable(self) -> str:
        """Name of the output variable of its light."""

    @property
    def in_plate(self) -> bool:
        """Whether it already lights the plate."""

    def arrival(self, point: Floats) -> Arrival:
        """Return its light at points (n, 3)."""

    def pattern(self, point: Floats, footprint_m: Floats) -> Floats:
        """Return the caustic factor (n, 3), a mean over footprints (n,) [m]; 1 for light that waves do not refract."""

    def visibility(self, start: Floats, sides: Floats | None = None) -> Floats:
        """Return the fraction (n,) of the source that bodies leave visible from points (n, 3).

        sides: (n, 2, 3) [m] of parallelograms about the points, for the means over them; None for the points alone.
        """
