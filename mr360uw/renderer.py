# SPDX-License-Identifier: Apache-2.0
"""One scene at one frame size: what is loaded and solved once, and the stages of a frame.

    plate -> environment -> caustics -> layer -> composite

Each stage gets everything it needs and returns a frozen type of `mr360uw.types`; frame k depends on the scene, its
plate and k alone. What a scene does not need, the plan leaves out.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mr360uw.backends import Backend, make_backend
from mr360uw.caustics import refract_to_air, stack_depths
from mr360uw.composite import SceneObject, Shot, load_object, load_receiver, read_camera_track
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.over import mean_layer
from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.ibl.level import LevelTrack, keyed_level, level_from_gpmf
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.mattes import Mattes
from mr360uw.medium import fit_gain
from mr360uw.plan import ObjectFacts, Plan, make_plan
from mr360uw.plate_map import plate_map
from mr360uw.scene import Scene
from mr360uw.scene_light import SceneLight
from mr360uw.sphere import directions
from mr360uw.types import Environment, Floats, Layer, MediumTable, Sun, YuvImage
from mr360uw.video import open_video

_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in air below which its beam is too oblique and too weak for caustics."""
_NEAREST_PLANE_M = 0.1
"""Depth of the first plane of caustics under objects that break the surface."""
_PLANE_SPACING_M = 1.5
"""Depth that one plane of caustics serves well, followed along the beam; a scene's `planes` is the most it gets."""


@dataclass(frozen=True, slots=True)
class FrameLight:
    """What a plate's frame says about the light.

    plate_map: (32, 64, 3) of the plate as it is, not expanded; None where the water does not follow the plate.
    """

    environment: Environment
    plate_map: Floats | None


@dataclass(frozen=True, slots=True)
class Rendered:
    """One frame's layer and what it was made with.

    caustics: in the backend's own form, or None. variables: the layer's output variables where they were asked for.
    """

    layer: Layer
    light: FrameLight | None
    medium: MediumTable | None
    caustics: Any
    variables: Aovs | None = None


def turned(light: Environment, world_from_camera: Floats) -> Environment:
    """Return the light that a camera saw, in the axes of the world."""
    if np.array_equal(world_from_camera, np.eye(3)):
        return light
    seen = directions(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS) @ world_from_camera
    maps = {
        name: environment_lookup(getattr(light, name), seen).astype(np.float32)
        for name in ("radiance", "irradiance", "residual", "ambient")
    }
    glossy = np.array([environment_lookup(level, seen) for level in light.glossy], np.float32)
    sun = light.sun
    if sun is not None:
        sun = dataclasses.replace(sun, direction=world_from_camera @ sun.direction)
    return dataclasses.replace(light, **maps, glossy=glossy if len(glossy) else light.glossy, sun=sun)


def level_track(scene: Scene) -> LevelTrack | None:
    """Return how a plate is tilted over time: by a GoPro's gravity, by keys, or fixed; None where it is level.

    A camera track holds the whole orientation and goes first.
    """
    camera = scene.camera
    if camera.gravity is not None:
        from mr360uw.video.gpmf import gpmf_payloads

        with open_video(scene.plate.path, eye=scene.plate.eye) as video:
            rate = float(video.frame_rate)
        return level_from_gpmf(gpmf_payloads(camera.gravity), rate)
    keys = [(t, np.radians(roll), np.radians(pitch)) for t, roll, pitch in camera.tilt_keys]
    if not keys and (camera.roll_deg, camera.pitch_deg) != (0.0, 0.0):
        keys = [(0.0, np.radians(camera.roll_deg), np.radians(camera.pitch_deg))]
    return keyed_level(keys) if keys else None


class SceneRenderer:
    """Renders the layers of a scene over frames of width x height.

    Loads the meshes and solves the water at once, and raises `SceneError`, `MeshError` or `ParameterError` there. With
    the gl backend, use it on the thread that made it; `light` may run on another.
    """

    def __init__(self, scene: Scene, width: int, height: int, backend: str = "auto") -> None:
        self.scene, self.width, self.height = scene, width, height
        self.objects = tuple(load_object(settings) for settings in scene.objects)
        self._receiver = load_receiver(scene.receiver) if scene.receiver is not None else None
        self._camera = read_camera_track(scene.camera.track) if scene.camera.track is not None else None
        self._level = level_track(scene)
        self._mattes = Mattes(scene, width, height)
        self._medium = scene.water.medium(scene.camera.depth_m)
        self._table = self._medium.table if self._medium is not None else None
        water = scene.water
        self._follows_plate = self._medium is not None and (water.gain == "auto" or water.mode == "plate")
        self._light = SceneLight(scene, self._table)
        self.plan: Plan = make_plan(scene, tuple(self._facts(o) for o in self.objects), self._table)
        self.backend: Backend
        self.backend, fallback = make_backend(backend)
        self.notes = tuple(note for o in self.objects for note in o.notes) + ((fallback,) if fallback else ())

    def light(self, plate: Floats | YuvImage, sun: Sun | Literal["scene"] | None = "scene") -> FrameLight:
        """Return the light of a plate's frame: linear RGB (H, W, 3) or decoded planes.

        sun: a smoothed track's, or None for none; "scene" does what the scene says, frame by frame.
        """
        found = self._light.of(plate, sun, glossy=self.plan.runs("glossy"))
        return FrameLight(found, plate_map(plate) if self._follows_plate else None)

    def render(
        self,
        light: FrameLight | None,
        time_s: float,
        index: int,
        shutter_s: float = 0.0,
        *,
        variables: bool = False,
    ) -> Rendered:
        """Return the layer of the frame `index` at a time. light: None where the plan runs no environment.

        shutter_s: how long the shutter is open, for motion blur where the scene asks for it. variables: also return
        output variables, which have no motion blur.
        """
        if light is None or not self.plan.runs("layer"):
            return Rendered(Layer(self.height, self.width, ()), light, self._table, None)
        draw = self.scene.draw
        medium = self._water(light)
        if variables:
            shot = self.shot(light.environment, medium, time_s, index)
            caustics = self._caustics(shot, time_s)
            layer, found = self.backend.variables(dataclasses.replace(shot, caustics=caustics))
            return Rendered(layer, light, medium, caustics, found)
        steps = draw.motion_samples if shutter_s > 0.0 and any(o.moves for o in self.objects) else 1
        layers, caustics = [], None
        for step in range(steps):
            instant = time_s + ((step + 0.5) / steps - 0.5) * shutter_s if steps > 1 else time_s
            shot = self.shot(light.environment, medium, instant, index)
            caustics = self._caustics(shot, instant)
            layers.append(self.backend.layer(dataclasses.replace(shot, caustics=caustics)))
        return Rendered(mean_layer(layers), light, medium, caustics)

    def shot(self, light: Environment, medium: MediumTable | None, time_s: float, index: int) -> Shot:
        """Return everything the layer of one instant depends on, but the caustics."""
        position: Floats = np.zeros(3)
        rotation: Floats = np.eye(3)
        if self._camera is not None:
            pose = self._camera.at(time_s)
            position, rotation = pose[:3, 3], pose[:3, :3]
        elif self._level is not None:
            rotation = self._level.at(time_s)
        light = turned(light, rotation)
        draw = self.scene.draw
        matte, matte_distance = self._mattes.at(index)
        return Shot(
            width=self.width,
            height=self.height,
            objects=tuple(o.at(time_s, index, position, rotation) for o in self.objects),
            environment=light,
            sun=light.sun,
            camera_position=position,
            world_from_camera=rotation,
            camera_depth_m=self.scene.camera.depth_m,
            medium=medium,
            receiver=self._receiver,
            holdout=matte,
            holdout_distance_m=matte_distance,
            samples=draw.samples,
            shading=draw.shading,
            sun_samples=draw.sun_samples,
            sun_spread_rad=np.radians(draw.sun_spread_deg),
        )

    def _facts(self, placed: SceneObject) -> ObjectFacts:
        mesh = placed.at(0.0, 0, np.zeros(3), np.eye(3))
        y = float(mesh.to_world(mesh.mesh.center_m)[1])
        return ObjectFacts(self.scene.camera.depth_m - y, any(m.glossy for m in placed.meshes), placed.moves)

    def _water(self, light: FrameLight) -> MediumTable | None:
        """Return the water's table in the exposure of this frame."""
        if self._medium is None or self._table is None or light.plate_map is None:
            return self._table
        if self.scene.water.mode == "plate":
            return self._medium.with_map(light.plate_map).table
        black = not np.all(light.plate_map.max(axis=(0, 1)) > 0.0)
        gain = np.zeros(3) if black else fit_gain(self._medium, light.plate_map)[0]
        return dataclasses.replace(self._table, veil=(self._table.veil * gain).astype(np.float32))

    def _caustics(self, shot: Shot, time_s: float) -> Any:
        """Return the caustics on planes through the objects' depths, or None where there are none."""
        if not self.plan.runs("caustics") or shot.sun is None or shot.sun.direction[1] <= 0.0:
            return None
        sun_in_air = refract_to_air(shot.sun.direction, self.scene.caustics.refractive_index)
        if sun_in_air[1] < _LOWEST_SUN:
            return None
        depths = []
        for placed in shot.objects:
            height = placed.to_world(placed.mesh.hull)[..., 1]
            depths += [shot.camera_depth_m - float(height.max()), shot.camera_depth_m - float(height.min())]
        if shot.receiver is not None and shot.receiver.caustics and shot.receiver.plane_y is not None:
            depths.append(shot.camera_depth_m - shot.receiver.plane_y)
        near = max(min(depths), _NEAREST_PLANE_M)
        far = max(*depths, near)
        count = min(self.scene.caustics.planes, 1 + int((far - near) / _PLANE_SPACING_M))
        planes = stack_depths(near, far, count)
        return self.backend.caustics(self.scene.sea, sun_in_air, planes, time_s, self.scene.caustics)
