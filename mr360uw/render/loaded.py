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

from mr360uw.caustics import refract_to_air
from mr360uw.composite import SceneObject, Shot, load_objects
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.over import mean_layer
from mr360uw.ibl.lighting import turned
from mr360uw.medium import fit_gain
from mr360uw.medium.depths import MediumAtDepths
from mr360uw.render.backends import Backend, make_backend
from mr360uw.render.camera import CameraPath
from mr360uw.render.caustic_depths import CausticDepths
from mr360uw.render.lights import SceneLight
from mr360uw.render.mattes import Mattes, ReceiverClip
from mr360uw.render.placement import placement_notes
from mr360uw.render.plan import ObjectFacts, Plan, make_plan
from mr360uw.render.plate_map import plate_map
from mr360uw.scene.model import Scene
from mr360uw.types import Environment, Floats, Layer, MediumTable, Sun, YuvImage

_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in air below which its beam is too oblique and too weak for caustics."""


@dataclass(frozen=True, slots=True)
class FrameLight:
    """What a plate's frame says about the light.

    environment: in the axes of the camera. plate_map: (32, 64, 3) of the plate as it is, not expanded, levelled; None
    where the water does not need it. gain: (3,) of the veil, of a clip's track, or None.
    """

    environment: Environment
    plate_map: Floats | None
    gain: Floats | None = None


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


class SceneRenderer:
    """Renders the layers of a scene over frames of width x height.

    Loads the meshes and solves the water at once, and raises `SceneError`, `MeshError` or `ParameterError` there. With
    the gl backend, use it on the thread that made it; `light` may run on another.
    """

    def __init__(self, scene: Scene, width: int, height: int, backend: str = "auto") -> None:
        self.scene, self.width, self.height = scene, width, height
        self.objects = load_objects(scene.objects)
        self._receiver = ReceiverClip(scene.receiver, width, height) if scene.receiver is not None else None
        self._camera = CameraPath.of(scene)
        self._mattes = Mattes(scene, width, height)
        self._medium = scene.water.medium(scene.camera.depth_m)
        self._table = self._medium.unit_table if self._medium is not None else None
        self._at_depths = MediumAtDepths(self._medium) if self._medium is not None and self._camera.sinks else None
        self._light = SceneLight(scene, self._table, self._camera)
        still = self._receiver if scene.receiver is not None and scene.receiver.kind != "distance" else None
        ground = still.at(0) if still is not None else None
        self._caustic_depths = CausticDepths.of(scene, self.objects, ground, self._camera, height)
        self.plan: Plan = make_plan(scene, tuple(self._facts(o) for o in self.objects), self._table)
        self.backend: Backend
        self.backend, fallback = make_backend(backend)
        found = dict.fromkeys(note for o in self.objects for note in o.notes)
        self.notes = (*found, *placement_notes(scene, self.objects, self._camera, height), *filter(None, [fallback]))

    def check(self, stop: int) -> None:
        """Raise `VideoError` where a matte or a distance map ends before the plate's frame `stop`."""
        self._mattes.check(stop)
        if self._receiver is not None:
            self._receiver.check(stop)

    def light(
        self,
        plate: Floats | YuvImage,
        sun: Sun | Literal["scene"] | None = "scene",
        *,
        time_s: float = 0.0,
        gain: Floats | None = None,
    ) -> FrameLight:
        """Return the light of a plate's frame: linear RGB (H, W, 3) or decoded planes.

        sun: a smoothed track's, in the world, or None for none; "scene" does what the scene says, frame by frame.
        time_s: of the frame, for how the camera is tilted. gain: (3,) of the veil, of a clip's track; None fits it to
        this plate where the scene says "auto".
        """
        chosen = sun if self.plan.runs("sun") else None
        found = self._light.of(plate, chosen, time_s=time_s, glossy=self.plan.runs("glossy"))
        water = self.scene.water
        if self._medium is None or not (water.mode == "plate" or (water.fits_gain and gain is None)):
            return FrameLight(found, None, gain if water.fits_gain else None)
        return FrameLight(found, plate_map(plate, self._camera.at(time_s)[1][1]))

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
            return Rendered(Layer(self.height, self.width, ()), light, None, None)
        draw = self.scene.draw
        medium = self._water(light, time_s)
        moves = self._camera.moves or any(o.moves for o in self.objects)
        steps = draw.motion_samples if shutter_s > 0.0 and moves else 1
        instants = [time_s + ((step + 0.5) / steps - 0.5) * shutter_s for step in range(steps)]
        layers, found, caustics = [], None, None
        if variables:
            shot, caustics = self._lit_shot(light, medium, time_s, index)
            layer, found = self.backend.variables(shot)
            layers = [layer] if steps == 1 else []
        for instant in instants[len(layers) :]:
            shot, caustics = self._lit_shot(light, medium, instant, index)
            layers.append(self.backend.layer(shot))
        return Rendered(mean_layer(layers), light, medium, caustics, found)

    def _lit_shot(self, light: FrameLight, medium: MediumTable | None, time_s: float, index: int) -> tuple[Shot, Any]:
        shot = self.shot(light.environment, medium, time_s, index)
        caustics = self._caustics(shot, time_s)
        return dataclasses.replace(shot, caustics=caustics), caustics

    def shot(self, light: Environment, medium: MediumTable | None, time_s: float, index: int) -> Shot:
        """Return everything the layer of one instant depends on, but the caustics."""
        position, rotation = self._camera.at(time_s)
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
            receiver=self._receiver.at(index) if self._receiver is not None else None,
            holdout=matte,
            holdout_distance_m=matte_distance,
            samples=draw.samples,
            shading=draw.shading,
            sun_samples=draw.sun_samples,
            sun_spread_rad=np.radians(draw.sun_spread_deg),
        )

    def _facts(self, placed: SceneObject) -> ObjectFacts:
        depth_m = self._camera.depth_m - placed.highest_m(self._camera.highest_m)
        return ObjectFacts(depth_m, any(m.glossy for m in placed.meshes), placed.moves)

    def _water(self, light: FrameLight, time_s: float) -> MediumTable | None:
        """Return the water's table for the depth and in the exposure of a frame."""
        medium = self._medium if self._at_depths is None else self._at_depths.at(self._camera.depth_at(time_s))
        if medium is None:
            return None
        if light.gain is not None:
            return medium.scaled(light.gain).table
        if light.plate_map is None:
            return medium.table
        if self.scene.water.mode == "plate":
            return medium.with_map(light.plate_map).table
        return medium.scaled(fit_gain(medium, light.plate_map)[0]).table

    def _caustics(self, shot: Shot, time_s: float) -> Any:
        """Return the caustics on planes about the objects' depths, or None where there are none."""
        if not self.plan.runs("caustics") or shot.sun is None or shot.sun.direction[1] <= 0.0:
            return None
        index = self.scene.water.refractive_index
        sun_in_air = refract_to_air(shot.sun.direction, index)
        if sun_in_air[1] < _LOWEST_SUN:
            return None
        planes = self._caustic_depths.planes(shot)
        settings = self._caustic_depths.settings
        return self.backend.caustics(self.scene.sea, sun_in_air, planes, time_s, settings, index)
