# SPDX-License-Identifier: Apache-2.0
"""Synthetic dives by seed: water, sky, sun, sea, floor, camera, and a body in front of it.

Light is in units of the irradiance that sun and sky bring on a level plane above the sea.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mr360uw.base.optics import refract_to_water
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.caustics import GerstnerSea
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import BED_TILE_M, sea_bed
from mr360uw.surface.sea_floor import Floor
from mr360uw.types import Floats, Sun

WATERS = ("I", "IB", "II", "III", "3C")
SUN_HALF_ANGLE = 0.00465
SEA_TILE_M = 16.0
_RAYLEIGH = np.array([0.05, 0.10, 0.21])
"""Optical depth of clean air at 650, 550 and 450 nm."""
_DOWN = 0.6
"""Fraction of the light that the air scatters which comes down."""
SHAPES = ("ball", "box", "whale")


@dataclass(frozen=True)
class Dive:
    """One dive. Angles [rad]; lengths [m]; the camera is the world's origin.

    haze: optical depth of aerosol. size_m: radius of a ball, half width of a box, half length of a whale. center: (3,)
    of the body. albedo: (3,).
    """

    seed: int
    water: str
    azimuth_rad: float
    elevation_rad: float
    haze: float
    camera_depth_m: float
    above_floor_m: float
    wind_m_s: float
    shape: str
    size_m: float
    yaw_rad: float
    center: Floats
    albedo: Floats

    @classmethod
    def of(cls, seed: int) -> Dive:
        """Return the dive of a seed, 1 or more: five neighbours have five waters and five heights of the sun."""
        rng = np.random.default_rng((seed, 0xC105ED))
        block = (seed - 1) // 5
        fifth = (2 * (seed - 1) + block) % 5  # every water gets another fifth of the heights in every block
        elevation = np.radians(25.0 + 55.0 * (fifth + rng.random()) / 5.0)
        depth, above = 2.0 * 7.5 ** rng.random(), rng.uniform(1.5, 6.0)
        shape = SHAPES[seed % 3]
        size = {"ball": rng.uniform(0.35, 0.7), "box": rng.uniform(0.3, 0.55), "whale": rng.uniform(0.9, 1.4)}[shape]
        half_height = {"ball": size, "box": 0.8 * size, "whale": 0.25 * size}[shape]
        lifted = 0.0 if shape == "box" else rng.choice([0.01, rng.uniform(0.2, 0.8)])
        away, around = rng.uniform(1.6, 3.2) + size, rng.uniform(-np.pi, np.pi)
        center = away * direction_from_angles(around, 0.0)
        center[1] = min(-above + half_height + lifted, -0.2 - half_height)
        grey = rng.uniform(0.12, 0.55)
        albedo = np.clip(grey * (1.0 + 0.25 * rng.uniform(-1.0, 1.0, 3)), 0.03, 0.8)
        return cls(
            seed, WATERS[(seed - 1) % 5], rng.uniform(-np.pi, np.pi), float(elevation), rng.uniform(0.1, 0.3),
            float(depth), float(above), rng.uniform(2.0, 8.0), shape, float(size), rng.uniform(-np.pi, np.pi),
            center, albedo,
        )  # fmt: skip

    @property
    def sun_in_air(self) -> Floats:
        """Direction (3,) towards the sun in the air."""
        return direction_from_angles(self.azimuth_rad, self.elevation_rad)

    @property
    def sun_in_water(self) -> Floats:
        """Direction (3,) towards the sun under a level surface."""
        return refract_to_water(self.sun_in_air)

    @property
    def _horizontal(self) -> tuple[Floats, Floats]:
        """Irradiance (3,) of a level plane above the sea by sun and sky, before the camera's white balance."""
        up = float(np.sin(self.elevation_rad))
        passed = np.exp(-(_RAYLEIGH + self.haze) / up)
        return up * passed, _DOWN * up * (1.0 - passed)

    @property
    def sun(self) -> Sun:
        """The sun in the air."""
        direct, diffuse = self._horizontal
        beam = direct / (direct + diffuse) / np.sin(self.elevation_rad)
        return Sun(self.sun_in_air, beam, SUN_HALF_ANGLE, 1.0)

    @cached_property
    def dome(self) -> Floats:
        """Radiance (64, 128, 3) of the sky: brighter to the horizon and about the sun."""
        direct, diffuse = self._horizontal
        view = directions(128, 64)
        near = np.clip(view @ self.sun_in_air, -1.0, 1.0)
        shape = (1.0 + 1.2 * (1.0 - np.abs(view[..., 1])) ** 3) * (
            1.0 + 0.45 * near**2 + 4.0 * np.exp(8.0 * (near - 1))
        )
        upper = np.maximum(view[..., 1], 0.0) * row_solid_angle(128, 64)[:, None]
        return shape[..., None] / np.sum(shape * upper) * diffuse / (direct + diffuse)

    @property
    def sea(self) -> GerstnerSea:
        """The sea of the dive."""
        return GerstnerSea(
            wind_speed=self.wind_m_s, wind_direction_deg=float(np.degrees(self.yaw_rad)), tile_m=SEA_TILE_M,
            seed=self.seed,
        )  # fmt: skip

    @cached_property
    def floor(self) -> Floor:
        """The sand."""
        bare = DiveSettings(seed=self.seed, rocks=0.0, grass=0.0)
        return Floor(-self.above_floor_m, sea_bed(bare)[1], BED_TILE_M)

    @property
    def floor_depth_m(self) -> float:
        """Depth of the sand below the mean surface."""
        return self.camera_depth_m + self.above_floor_m
