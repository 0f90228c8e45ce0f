# SPDX-License-Identifier: Apache-2.0
"""Lamps of a scene: intensity from the `[[lamp]]` tables, and placement at a time for a shot.

    I = flux/solid angle        intensity = I color/white

with the flux in lumen, the solid angle that of the cone with its soft edge, and white the luminance [cd/m2] of the
plate's white. A white card under a lamp then has its true brightness relative to the plate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mr360uw.composite.motion import Motion, lamp_motion, rigid
from mr360uw.composite.settings import LampSettings
from mr360uw.composite.shot import PlacedObject
from mr360uw.medium.emitters import lamp_attenuation, lamp_color
from mr360uw.medium.medium import Medium
from mr360uw.types import Floats, Lamp, View

_EDGE = 0.3
"""Fraction of a cone's half angle over which its light fades. Twice as much: the beam has hardly a core."""
_DEFAULT_LUMEN = 2000.0
"""Flux of a typical diver's video light [lm], if a scene gives none."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneLamp:
    """A lamp of a scene. intensity: (3,) along its axis, attenuation: (D, 3) or None, as in `types.Lamp`."""

    settings: LampSettings
    motion: Motion
    intensity: Floats
    attenuation: Floats | None

    @property
    def moves(self) -> bool:
        """Whether it moves in the world."""
        return self.motion.moves or self.settings.attach != "world"

    def at(self, time_s: float, view: View, objects: Sequence[PlacedObject]) -> Lamp:
        """Return the lamp at a time. view: of the camera. objects: of the scene, at the same time."""
        place = self.motion.at(time_s)
        if self.settings.attach == "camera":
            place = rigid(view.position, view.world_from_camera) @ place
        elif self.settings.attach != "world":
            place = objects[self.settings.attach].world_from_object @ place
        axis = -place[:3, 2] / np.linalg.norm(place[:3, 2])
        cos_core, cos_edge = cone_cosines(self.settings)
        return Lamp(
            position=place[:3, 3],
            axis=axis,
            intensity=self.intensity,
            cos_core=cos_core,
            cos_edge=cos_edge,
            radius_m=self.settings.radius_m,
            attenuation=self.attenuation,
            casts_shadow=self.settings.casts_shadow,
        )


def load_lamps(
    all_settings: Sequence[LampSettings], medium: Medium | None, white_cd_m2: float
) -> tuple[SceneLamp, ...]:
    """Return the lamps of a scene. medium: the water they shine in, or None. white_cd_m2: of the plate's white."""
    lamps = []
    for settings in all_settings:
        color = lamp_color(medium, settings.temperature_k) * np.asarray(settings.color)
        cos_core, cos_edge = cone_cosines(settings)
        # the mean of the smooth step over the cosine, and so over solid angle, is 1/2
        angle = 4.0 * np.pi if cos_edge <= -1.0 else 2.0 * np.pi * (1.0 - 0.5 * (cos_core + cos_edge))
        candela = (_DEFAULT_LUMEN if settings.lumen is None else settings.lumen) / float(angle)
        attenuation = None if medium is None else lamp_attenuation(medium, settings.temperature_k)
        lamps.append(SceneLamp(settings, lamp_motion(settings), color * candela / white_cd_m2, attenuation))
    return tuple(lamps)


def cone_cosines(settings: LampSettings) -> tuple[float, float]:
    """Return the cosines of the half angles of a lamp's core and edge; both -1 for a point light."""
    half = np.radians(0.5 * settings.cone_deg)
    if half >= np.pi:
        return -1.0, -1.0
    return float(np.cos(half * (1.0 - _EDGE))), float(np.cos(half))
