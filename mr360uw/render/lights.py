# SPDX-License-Identifier: Apache-2.0
"""Environment and sun of a plate's frame by the `[light]` settings of its scene, in the axes of the camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from mr360uw.caustics import refract_to_water
from mr360uw.ibl import LightSettings, environment, environment_from_yuv
from mr360uw.ibl.expansion import checked_plate
from mr360uw.ibl.plate import LinearPlate, Plate
from mr360uw.ibl.sun.closure import WaterLight
from mr360uw.ibl.sun.given import given_direction
from mr360uw.ibl.sun.words import sun_in_words
from mr360uw.ibl.yuv import plate_of_yuv
from mr360uw.medium.lookup import ambient_ratio, beam_ratio
from mr360uw.render.camera import CameraPath
from mr360uw.scene.model import Scene
from mr360uw.types import Environment, Floats, MediumTable, Sun, YuvImage

_TYPICAL_SUN_UP = 0.85
"""Sine of the elevation, in the water, of that sun."""


class LightReader:
    """Measures the light of frames by a scene's `[light]` settings. table: of its water, or None.

    Suns of the scene and of a track are in world axes; `of` returns its result in camera axes.
    """

    def __init__(self, scene: Scene, table: MediumTable | None, camera: CameraPath) -> None:
        self._underwater, self._camera = table is not None, camera
        self._refractive_index = scene.water.refractive_index
        settings = scene.light
        self._water = None if table is None else water_light(table)
        self._settings: LightSettings = settings
        self._sun: Floats | Literal["detect"] | None = "detect"
        if settings.sun == "none":
            self._sun = None
        elif settings.sun in ("given", "date"):
            self._sun = given_direction(settings)
            if self._sun is not None and settings.sun == "date" and self._underwater:
                self._sun = refract_to_water(self._sun, scene.water.refractive_index)

    def of(
        self,
        plate: Floats | YuvImage,
        sun: Sun | Literal["scene"] | None = "scene",
        *,
        time_s: float = 0.0,
        glossy: bool = False,
    ) -> Environment:
        """Return the light of a linear plate (H, W, 3) or of decoded planes.

        sun: "scene" takes the scene's own; a smoothed track gives its own, or None. time_s: of the frame, for the
        tilt of the camera.
        """
        world_from_camera = self.world_from_camera(time_s)
        chosen = self._sun if isinstance(sun, str) else sun
        if isinstance(chosen, Sun):
            chosen = replace(chosen, direction=chosen.direction @ world_from_camera)
        elif isinstance(chosen, np.ndarray):
            chosen = chosen @ world_from_camera
        options: Any = {
            "underwater": self._underwater, "refractive_index": self._refractive_index, "glossy": glossy,
            "up": world_from_camera[1], "water": self._water,
        }  # fmt: skip
        if isinstance(plate, YuvImage):
            return environment_from_yuv(plate, self._settings, sun=chosen, **options)
        return environment(plate, self._settings, sun=chosen, **options)

    def sun_in_words(self, plate: Floats | YuvImage, time_s: float) -> str:
        """Return one line on the sun that is detected in a plate's frame, or on the candidate that comes nearest."""
        world_from_camera, settings = self.world_from_camera(time_s), self._settings
        options: Any = {"up": world_from_camera[1], "refractive_index": self._refractive_index}
        if isinstance(plate, YuvImage):
            seen: Plate = plate_of_yuv(plate, settings, **options)
        else:
            seen = LinearPlate.of(checked_plate(plate), settings, **options)
        return sun_in_words(seen, world_from_camera, settings.minimum_confidence, underwater=self._underwater)

    def world_from_camera(self, time_s: float) -> Floats:
        """Return the rotation (3, 3) of the camera at `time_s`."""
        return self._camera.at(time_s)[1]

    def sun(self, plate: Floats | YuvImage, time_s: float) -> Sun | None:
        """Return the sun of a plate's frame in world axes; None if there is none."""
        sun = self.of(plate, time_s=time_s).sun
        return None if sun is None else replace(sun, direction=self.world_from_camera(time_s) @ sun.direction)


def water_light(table: MediumTable) -> WaterLight:
    """Return the fractions of the beam and of all downward light at the surface that reach the camera.

    The beam fades faster than the whole; light scattered out of it forwards becomes diffuse.
    """
    return WaterLight(1.0 / beam_ratio(table, 0.0, _TYPICAL_SUN_UP), 1.0 / ambient_ratio(table, 0.0))
