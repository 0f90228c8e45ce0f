# SPDX-License-Identifier: Apache-2.0
"""The two sides of the moving surface of a shot: the light of each, the water between them and the camera.

What stands out of the water above an underwater plate is lit by the sky that the plate shows through the surface:

    symbol  meaning
    n       refractive index of the water
    t, R    transmittance and reflectance of a level surface for irradiance (Fresnel), at an angle in the air
    L_w     radiance just below the surface: the plate's, with what the water above the camera has taken

Radiance over the squared index is kept but for reflection, so the sky is L = (L_w - R D)/(n^2 t), seen in the refracted
direction, with D the water's light that the surface mirrors there. From below comes R L + t D/n^2. The sun's
beam has the power per level area that passes the surface, E cos = E_w cos_w/t.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mr360uw.composite.lighting.light_sources import sun_of, sun_up
from mr360uw.composite.lighting.shading import veil_ahead, water_ahead
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup
from mr360uw.optics import fresnel_transmittance, refract_to_air, refract_to_water
from mr360uw.sphere import directions
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.types import Floats, Light, MediumTable, Sun

_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in the air below which it gives no light: nearly all of it is reflected."""
_LEAST_PASSED = 0.05
"""Least transmittance that the sky is divided by: at the horizon, where hardly any of its light is left."""


def in_air(shot: Shot) -> Shot:
    """Return a shot of the same bodies in the light of the air, without water and caustics.

    shot: of a camera in the water.
    """
    if shot.medium is None:
        return shot
    sun = _sun_in_air(shot)
    roughness = tuple(shot.environment.glossy_roughness.tolist()) if len(shot.environment.glossy) else ()
    light = assemble(_sky(shot), sun, roughness)
    lamps: tuple[Light, ...] = tuple(one for one in shot.lights if not isinstance(one, Sun))
    lights = lamps if sun is None else (sun, *lamps)
    return replace(shot, environment=light, lights=lights, medium=None, caustics=None, between=None)


def _sky(shot: Shot) -> Floats:
    """Return the radiance (128, 256, 3) of all directions in the air, without the sun."""
    n, medium = shot.refractive_index, shot.medium
    assert medium is not None
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    up = towards * np.array([1.0, 0.0, 1.0]) + np.abs(towards) * np.array([0.0, 1.0, 0.0])
    passed = fresnel_transmittance(up[..., 1], n)[..., None]
    below = refract_to_water(up, n)
    at_surface = ambient_ratio(medium, 0.0)
    residual = shot.environment.residual
    deep = environment_lookup(residual, below * np.array([1.0, -1.0, 1.0])) * at_surface
    sent = environment_lookup(residual, below) * at_surface - (1.0 - passed) * deep
    sky = np.maximum(sent, 0.0) / (n * n * np.maximum(passed, _LEAST_PASSED))
    under = (1.0 - passed) * sky + passed * deep / (n * n)
    return np.where(towards[..., 1:2] > 0.0, sky, under).astype(np.float32)


def _sun_in_air(shot: Shot) -> Sun | None:
    sun, n = sun_of(shot), shot.refractive_index
    if sun is None or shot.medium is None:
        return None
    direction = refract_to_air(sun.direction, n)
    if direction[1] < _LOWEST_SUN:
        return None
    below = sun.irradiance * beam_ratio(shot.medium, 0.0, sun_up(sun)) * sun.direction[1]
    irradiance = below / (direction[1] * float(fresnel_transmittance(direction[1], n)))
    return Sun(direction, np.asarray(irradiance, np.float64), sun.half_angle_rad * n, sun.confidence)


@dataclass(frozen=True, slots=True, eq=False)
class WaterSides:
    """What both sides of the surface show to a camera on one of them.

    wet, dry: the shot in the light of the water and of the air; same view, same objects. sea: waves of the instant.
    from_surface: the water's table for rays that start at the surface; None for clear water. in_water: whether the
    camera is below the waves. refractive_index: of the water.
    """

    wet: Shot
    dry: Shot
    sea: SampledSea
    from_surface: MediumTable | None
    in_water: bool
    refractive_index: float

    @property
    def relative_index(self) -> float:
        """Index behind the surface over that on the camera's side."""
        return 1.0 / self.refractive_index if self.in_water else self.refractive_index

    @property
    def camera_over_m(self) -> float:
        """Height [m] of the camera over the mean surface, negative below."""
        return float(self.wet.view.position[1] - self.wet.view.surface_y_m)

    def to_surface(self, distance_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return transmittance and veil (n, 3) from the camera to the surface."""
        if self.in_water:
            return water_ahead(self.wet, distance_m, direction)
        return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))

    def below_surface(self, distance_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return transmittance and veil (n, 3) of rays from the surface down into the water."""
        table = self.from_surface
        if table is None:
            return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))
        level = np.stack([direction[:, 0], np.minimum(direction[:, 1], 0.0), direction[:, 2]], axis=-1)
        # a ray that a wave turns up stays in the water until the body
        return transmittance_lookup(table, distance_m, level[:, 1]), veil_ahead(table, distance_m, level)


def camera_in_water(shot: Shot, sea: SampledSea) -> bool:
    """Return whether a shot's camera is below the waves."""
    position = np.asarray(shot.view.position, np.float64)
    return bool(position[1] - shot.view.surface_y_m < sea.heights(position[[0]], position[[2]])[0])


def table_at_surface(camera: MediumTable, unit_camera: MediumTable, unit_surface: MediumTable) -> MediumTable:
    """Return a water's table for rays from the surface with the veil's gain of a frame's table, and its plate's light.

    camera: the frame's. unit_camera, unit_surface: without gain, for the camera's depth and for the surface.
    """
    whole = np.maximum(unit_camera.veil.sum(axis=1), 1e-12)
    gain = camera.veil.sum(axis=1) / whole
    veil = (unit_surface.veil * gain[:, None]).astype(np.float32)
    return replace(unit_surface, veil=veil, plate_ratio=camera.plate_ratio)
