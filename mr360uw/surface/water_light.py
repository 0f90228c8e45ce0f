# SPDX-License-Identifier: Apache-2.0
"""Water between surface, floor and camera: what it takes of a ray, what it adds, and the light that reaches the floor.

The veil and the diffuse light are those of the solved field under a flat surface, for the sky and for the sun, times
the irradiance that each brings just below the surface. Light of the floor that the surface sends back down adds up to a
geometric series, E = E_0/(1 - albedo R), R from `optics.diffuse_reflectance_from_below`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.constants import JUST_BELOW_M
from mr360uw.medium import Medium, Water
from mr360uw.medium.depths import MediumAtDepths
from mr360uw.medium.lookup import beam_fraction, transmittance_lookup, veil_lookup
from mr360uw.medium.small_angles import spread_of
from mr360uw.optics import diffuse_reflectance_from_below, refract_to_water
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import FloorLight, Tiled
from mr360uw.surface.sky import Dome, sun_below
from mr360uw.surface.sky_pattern import sky_pattern
from mr360uw.types import CausticStack, MediumTable, Sun

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LightInWater:
    """Light of one origin. below: (3,) irradiance just below the surface. medium: solved for it. from_surface,
    from_camera: its tables for rays that start there; from_camera is None where the camera is above the water. depths:
    its tables for cameras at any depth.
    """

    below: Array
    medium: Medium
    from_surface: MediumTable
    depths: MediumAtDepths
    from_camera: MediumTable | None = None

    @classmethod
    def of(cls, below: Array, medium: Medium) -> LightInWater:
        """Return it with its tables for rays from the surface."""
        return cls(below, medium, medium.unit_table, MediumAtDepths(medium))

    def seen_from(self, camera_depth_m: float) -> LightInWater:
        """Return it with its tables for a camera at a depth [m], > 0."""
        return replace(self, from_camera=self.depths.at(camera_depth_m).unit_table)

    def table(self, from_camera: bool) -> MediumTable:
        """Return the table for rays of the camera, or of the surface."""
        return self.from_surface if self.from_camera is None or not from_camera else self.from_camera

    def down(self, depth_m: float) -> Array:
        """Return the irradiance (3,) on a level plane at a depth."""
        return self.below * self.medium.light.display(self.medium.model.irradiance(depth_m, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class WaterLight:
    """Water for rays. sky, sun: light of each in the water; none for clear water, and no sun at night. sun_up: y of the
    sun's direction in the water.
    """

    sky: LightInWater | None
    sun: LightInWater | None
    sun_up: float

    @classmethod
    def of(cls, water: Water | Medium | None, dome: Dome, sun: Sun | None, index: float) -> WaterLight:
        """Return the water of a scene for a camera above it. water: as of `SeaScene`; a medium's gain and camera are
        not read.
        """
        risen = sun is not None and sun.direction[1] > 0.0
        sun_up = float(refract_to_water(sun.direction, index)[1]) if sun is not None and risen else 1.0
        if water is None:
            return cls(None, None, sun_up)
        given = water if isinstance(water, Medium) else Medium(water, refractive_index=index)
        sky = Medium(
            given.water, given.sensor, given.mode, JUST_BELOW_M, illuminant=given.illuminant, refractive_index=index,
            formation=given.formation,
        )  # fmt: skip
        beam = None
        if risen:
            beam = Medium(
                given.water, given.sensor, given.mode, JUST_BELOW_M, illuminant=given.illuminant,
                refractive_index=index, sky=("sun", sun_up, 1.0), formation=given.formation,
            )  # fmt: skip
        of_sky = LightInWater.of(dome.irradiance_below(index), sky)
        of_sun = None if beam is None else LightInWater.of(sun_below(sun, index), beam)
        return cls(of_sky, of_sun, sun_up)

    def seen_from(self, camera_depth_m: float) -> WaterLight:
        """Return the water for a camera at a depth [m], > 0."""
        sky, sun = (None if light is None else light.seen_from(camera_depth_m) for light in (self.sky, self.sun))
        return WaterLight(sky, sun, self.sun_up)

    def along(self, distance_m: Array, up: Array, from_camera: bool) -> tuple[Array, Array]:
        """Return transmittance and veil (n, 3) of rays (n,) from the camera or from the surface; `up`: y of their
        directions. Distances may be infinite.
        """
        shape = (len(distance_m), 3)
        if self.sky is None:
            return np.ones(shape), np.zeros(shape)
        veil = self.sky.below * veil_lookup(self.sky.table(from_camera), distance_m, up)
        if self.sun is not None:
            veil = veil + self.sun.below * veil_lookup(self.sun.table(from_camera), distance_m, up)
        finite = np.isfinite(distance_m)
        reach = np.where(finite, distance_m, 0.0)
        passed = transmittance_lookup(self.sky.table(from_camera), reach, up)
        return np.where(finite[:, None], passed, 0.0), veil

    def on_floor(
        self, sea: Sea, sampled: SampledSea, dome: Dome, sun: Sun | None, depth_m: float, time_s: float, index: float,
        albedo: Array, settings: CausticSettings,
    ) -> FloorLight:  # fmt: skip
        """Return the light on a floor of a mean albedo (3,) below the mean surface. sampled: the sea at the time."""
        dry_sun: Array = np.zeros(3) if sun is None else np.asarray(sun.irradiance * max(float(sun.direction[1]), 0.0))
        dry = dome.irradiance + dry_sun
        if depth_m <= 0.0:
            return FloorLight(dry, (), dry, dry_sun)
        tau = np.zeros(3)  # of the way up and down again
        if self.sky is not None:
            down = np.array([depth_m]), np.array([-1.0])
            tau = -2.0 * np.log(np.maximum(self.along(*down, from_camera=False)[0][0], 1e-300))
        factor = 1.0 / (1.0 - albedo * diffuse_reflectance_from_below(index, tau))
        medium = None if self.sun is None else self.sun.medium
        pattern = sun_pattern(sea, sun, depth_m, time_s, index, settings, medium)
        if self.sky is None:
            patterns = [(sky_pattern(sea, sampled, dome, depth_m, time_s, index), factor)]
            if pattern is not None:
                patterns.append((pattern[0], factor * sun_below(sun, index)))
            return FloorLight(np.zeros(3), tuple(patterns), dry, dry_sun, skies=1)
        even, patterns = self.sky.down(depth_m), []
        if pattern is not None and self.sun is not None:
            beam, sharp = self._beam(depth_m)
            even = even + self.sun.down(depth_m) - beam
            patterns = [(pattern[0], factor * sharp)]
            if pattern[1] is not None:
                patterns.append((pattern[1], factor * (beam - sharp)))
            else:
                even = even + beam - sharp
        return FloorLight(factor * np.maximum(even, 0.0), tuple(patterns), dry, dry_sun)

    def _beam(self, depth_m: float) -> tuple[Array, Array]:
        """Return the irradiance (3,) of a level plane by the sun's beam, and its part that has not turned at all."""
        assert self.sun is not None
        beam = beam_fraction(self.sun.from_surface, depth_m, self.sun_up)
        medium = self.sun.medium
        sharp = medium.light.display(np.exp(-medium.model.attenuation * depth_m / self.sun_up))
        return self.sun.below * beam, self.sun.below * np.minimum(sharp, beam)


def sun_pattern(
    sea: Sea, sun: Sun | None, depth_m: float, time_s: float, index: float, settings: CausticSettings,
    medium: Medium | None = None,
) -> tuple[Tiled, Tiled | None] | None:  # fmt: skip
    """Return the caustics of the sun on the floor, mean 1, and those of the light that the water has turned by small
    angles; None without a sun above the horizon.
    """
    if sun is None or sun.direction[1] <= 0.0:
        return None
    settings = settings.model_copy(update={"sun_half_angle_rad": sun.half_angle_rad})
    spread = None if medium is None else spread_of(medium)
    stack = caustic_stack(sea, sun.direction, [depth_m], time_s, settings, index, spread)
    soft = None if stack.soft is None else _on_floor(stack, np.repeat(stack.soft[0], 3, axis=-1))
    return _on_floor(stack, stack.ratio[0]), soft


def _on_floor(stack: CausticStack, plane: Array) -> Tiled:
    """Return a plane of a stack along the beam in the place where it lies on the floor."""
    x, y, z = stack.sun_direction
    depth = float(stack.depth_m[0])
    return Tiled.of(np.ascontiguousarray(plane), stack.tile_m, (-float(x / y) * depth, -float(z / y) * depth))
