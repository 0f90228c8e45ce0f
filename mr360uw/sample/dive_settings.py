# SPDX-License-Identifier: Apache-2.0
"""Parameters of a synthetic dive: depths, water, sun, wind, motion of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, pi, radians
from typing import cast

import numpy as np

from mr360uw.caustics import GerstnerSea
from mr360uw.errors import ParameterError
from mr360uw.medium.jerlov import JERLOV_TYPES, JerlovType
from mr360uw.sphere import direction_from_angles
from mr360uw.types import Floats

_ABOVE_FLOOR_M = 3.5
"""Height [m] of the camera above the sand where no depth of the sand is given."""


_SLICK_SLOPE = 0.02
"""Root mean square slope of the waves that are not drawn. Twice as large, the lines of light are twice as wide."""


@dataclass(frozen=True, slots=True)
class DiveSettings:
    """Parameters of the dive.

    Depths below the mean surface [m], angles of the sun above the surface [rad], speed of the wind and of the camera,
    which swims straight ahead [m/s]. sand_contrast: of the sand's albedo, 1 ordinary, 0 an even floor, 3 stones. Raises
    `ParameterError`.
    """

    camera_depth_m: float = 4.0
    floor_depth_m: float = 7.5
    water: JerlovType = "IB"
    sun_azimuth_rad: float = radians(34.4)
    sun_elevation_rad: float = radians(57.3)
    wind_speed_m_s: float = 3.0
    speed_m_s: float = 0.0
    seed: int = 1
    sand_contrast: float = 1.0

    def __post_init__(self) -> None:
        camera, floor, sun = self.camera_depth_m, self.floor_depth_m, self.sun_elevation_rad
        if self.water not in JERLOV_TYPES:
            raise ParameterError(f"water - no such type (got {self.water!r}) - take one of {', '.join(JERLOV_TYPES)}")
        if not 0.05 <= camera <= 100.0:
            raise ParameterError(f"depth - is out of range (got {camera:g} m) - give 0.05 to 100")
        if not camera + 0.2 <= floor <= 200.0:
            raise ParameterError(f"floor - must lie below the camera (got {floor:g} m) - give {camera + 0.2:g} to 200")
        if not radians(3.0) <= sun <= pi / 2.0:
            raise ParameterError(f"sun elevation - is out of range (got {degrees(sun):g} degrees) - give 3 to 90")
        if not np.isfinite(self.sun_azimuth_rad):
            raise ParameterError(f"sun azimuth - must be finite (got {self.sun_azimuth_rad}) - give an angle")
        if self.seed < 0:
            raise ParameterError(f"seed - must be 0 or more (got {self.seed}) - give another whole number")
        if not 0.3 <= self.wind_speed_m_s <= 15.0:
            raise ParameterError(f"wind - is out of range (got {self.wind_speed_m_s:g} m/s) - give 0.3 to 15")
        if not abs(self.speed_m_s) <= 10.0:
            raise ParameterError(f"speed - is out of range (got {self.speed_m_s:g} m/s) - give -10 to 10")

    @classmethod
    def in_degrees(
        cls,
        water: str,
        depth_m: float,
        floor_m: float | None,
        sun_elevation_deg: float,
        sun_azimuth_deg: float,
        wind_m_s: float,
        speed_m_s: float,
        seed: int,
    ) -> DiveSettings:
        """Return the parameters with angles in degrees. floor_m: None for 3.5 m below the camera."""
        floor = depth_m + _ABOVE_FLOOR_M if floor_m is None else floor_m
        angles = radians(sun_azimuth_deg), radians(sun_elevation_deg)
        return cls(depth_m, floor, cast("JerlovType", water), *angles, wind_m_s, speed_m_s, seed)

    @property
    def sun_in_air(self) -> Floats:
        """Unit direction towards the sun, above the surface."""
        return direction_from_angles(self.sun_azimuth_rad, self.sun_elevation_rad)

    @property
    def sea(self) -> GerstnerSea:
        """The surface of the dive, with few ripples, as under a natural slick (Cox & Munk 1954)."""
        return GerstnerSea(
            wind_speed=self.wind_speed_m_s, wind_direction_deg=35.0, tile_m=16.0, seed=self.seed,
            detail_slope=_SLICK_SLOPE,
        )  # fmt: skip

    def camera_at(self, time_s: float) -> Floats:
        """Return the position (3,) [m] of the camera, which swims straight ahead."""
        return np.array([0.0, 0.0, -self.speed_m_s * time_s])
