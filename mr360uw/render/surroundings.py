# SPDX-License-Identifier: Apache-2.0
"""Surroundings of a plate: its camera path, its medium, and the reader of its light."""

from __future__ import annotations

from dataclasses import dataclass

from mr360uw.medium import Medium
from mr360uw.medium.depths import MediumAtDepths
from mr360uw.render.camera import CameraPath
from mr360uw.render.lights import LightReader
from mr360uw.scene.model import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Camera path, medium and light reader of a scene. medium: for a camera at `camera.depth_m`; None without water."""

    scene: Scene
    camera: CameraPath
    medium: Medium | None
    light: LightReader
    _depths: MediumAtDepths | None

    def medium_at(self, time_s: float) -> Medium | None:
        """Return the medium for the camera's depth at a time."""
        return self.medium if self._depths is None else self._depths.at(self.camera.depth_at(time_s))


def load_surroundings(scene: Scene) -> Surroundings:
    """Return the surroundings of a scene. Raises `ParameterError` or `VideoError`."""
    camera = CameraPath.of(scene)
    medium = scene.water.medium(scene.camera.depth_m)
    light = LightReader(scene, medium.unit_table if medium is not None else None, camera)
    depths = MediumAtDepths(medium) if medium is not None and camera.sinks else None
    return Surroundings(scene, camera, medium, light, depths)
