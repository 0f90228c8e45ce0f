# SPDX-License-Identifier: Apache-2.0
"""The two sides of the moving surface of a shot: the light of each, the water between them and the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mr360uw.composite.lighting.surfaces import veil_ahead, water_ahead
from mr360uw.composite.shot import Shot
from mr360uw.medium.lookup import transmittance_lookup
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.types import Floats, MediumTable


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
