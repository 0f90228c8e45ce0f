# SPDX-License-Identifier: Apache-2.0
"""Surroundings of a plate: its camera path, its medium, and the reader of its light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mr360uw.ibl import LightSettings
from mr360uw.medium import Medium
from mr360uw.medium.depths import MediumAtDepths
from mr360uw.reading.kept_reads import KeptReads
from mr360uw.render.camera import CameraPath
from mr360uw.render.lights import LightReader
from mr360uw.scene.keyed import scene_at
from mr360uw.scene.model import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Camera path, medium and light reader of a scene. medium: for a camera at `camera.depth_m`; None without water.

    settings: its `[light]` table.
    """

    settings: LightSettings
    camera: CameraPath
    medium: Medium | None
    light: LightReader
    _depths: MediumAtDepths | None

    def medium_at(self, time_s: float) -> Medium | None:
        """Return the medium for the camera's depth at a time."""
        return self.medium if self._depths is None else self._depths.at(self.camera.depth_at(time_s))


def load_surroundings(scene: Scene, kept: KeptReads | None = None) -> Surroundings:
    """Return the surroundings of a scene. kept: what was made before. Raises `ParameterError` or `VideoError`."""
    kept = KeptReads() if kept is None else kept
    levelled_by_plate = scene.plate if scene.camera.gravity is not None else None
    of_camera = scene.camera, levelled_by_plate, scene.water.type
    of_water = scene.water, scene.camera.depth_m

    def made() -> Surroundings:
        camera = kept.get("camera", of_camera, lambda: CameraPath.of(scene))
        medium, depths = kept.get("medium", (of_water, camera.sinks), lambda: _medium(scene, camera))
        light = LightReader(scene, medium.unit_table if medium is not None else None, camera)
        return Surroundings(scene.light, camera, medium, light, depths)

    return kept.get("surroundings", (of_camera, of_water, scene.light), made)


def surroundings_over_time(scene: Scene) -> Callable[[float], Surroundings]:
    """Return the function of time [s] that gives a scene's surroundings."""
    kept = KeptReads()
    return lambda time_s: load_surroundings(scene_at(scene, time_s), kept)


def _medium(scene: Scene, camera: CameraPath) -> tuple[Medium | None, MediumAtDepths | None]:
    """Return the medium at the scene's depth, and at all depths where the camera rises or sinks."""
    medium = scene.water.medium(scene.camera.depth_m)
    return medium, MediumAtDepths(medium) if medium is not None and camera.sinks else None
