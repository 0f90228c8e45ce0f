# SPDX-License-Identifier: Apache-2.0
"""What shading and receivers ask of a light that has a direction of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """Light of one source at n places, before shadow and waves.

    direction: (n, 3), or (3,) for all, unit, towards the light. irradiance: (n, 3) across it, in plate radiance times
    sr. half_angle_rad: (n,), or a number for all, angular radius of the source.
    """

    direction: Floats
    irradiance: Floats
    half_angle_rad: Floats | float


class LightSource(Protocol):
    """One light in one shot. Points are from the camera, in the world's axes [m]."""

    @property
    def variable(self) -> str:
        """Name of the output variable that its light adds to."""

    @property
    def in_plate(self) -> bool:
        """Whether it lights the plate already."""

    def arrival(self, point: Floats) -> Arrival:
        """Return its light at places (n, 3)."""

    def pattern(self, point: Floats, footprint_m: Floats) -> Floats:
        """Return the factor (n, 3) of the waves, a mean over footprints (n,) [m]; 1 for light that they do not bend."""

    def visibility(self, start: Floats) -> Floats:
        """Return the fraction (n,) of its light that bodies let pass to places (n, 3)."""
