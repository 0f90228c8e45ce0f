# SPDX-License-Identifier: Apache-2.0
"""Camera, receiver and objects of one frame, for placing things by clicks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.composite.shot import Receiver
from mr360uw.errors import ParameterError
from mr360uw.preview.live import LivePreview
from mr360uw.scene.model import Scene
from mr360uw.tune import placing
from mr360uw.tune.placing import Point
from mr360uw.types import Floats, View

_WIDTH = 512
"""Width of the frames that are resolved for placing [pixels]; results do not depend on it."""
_RIM_POINTS = 97


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """An object as it is in a frame. position: (3,) in the world; rotation: (3, 3); hull: (h, 3, 3) of the mesh.

    with_camera: whether its settings are in the camera's axes. reach_m: radius about its position.
    """

    name: str
    position: Floats
    rotation: Floats
    scale: float
    hull: Floats
    with_camera: bool

    @property
    def reach_m(self) -> float:
        """Radius [m] of the ball around the position that holds it."""
        return self.scale * float(np.linalg.norm(self.hull, axis=-1).max())


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """A frame's camera, receiver (or None), and objects."""

    camera: View
    receiver: Receiver | None
    bodies: tuple[Body, ...]

    def standing(self, number: int, point: Point) -> Floats:
        """Return the position setting of an object that stands where a point shows the receiver."""
        if self.receiver is None:
            raise ParameterError("receiver - is not in the scene (got none) - add the sea floor first")
        body = self.bodies[number]
        place = placing.stand_at(self.camera, point, self.receiver, body.hull, body.rotation, body.scale)
        return self.setting_of(number, place)

    def swimming(self, number: int, point: Point) -> Floats:
        """Return the position setting of an object that is moved to a point, as far from the camera as it is."""
        return self.setting_of(number, placing.swim_to(self.camera, point, self.bodies[number].position))

    def setting_of(self, number: int, position: Floats) -> Floats:
        """Return the position setting of an object for a position (3,) in the world."""
        return placing.in_camera(self.camera, position) if self.bodies[number].with_camera else position

    def facing_yaw_deg(self, number: int) -> float:
        """Return the yaw setting [deg] of an object that turns its nose to the camera."""
        body = self.bodies[number]
        if body.with_camera:
            return placing.facing_yaw_deg(np.zeros(3), placing.in_camera(self.camera, body.position))
        return placing.facing_yaw_deg(self.camera.position, body.position)

    def shown(self, number: int) -> tuple[Point, float] | None:
        """Return the point that shows an object's position and its angular radius [rad]; None around the camera."""
        body = self.bodies[number]
        if not np.any(body.position != self.camera.position):
            return None
        seen = placing.shown_at(self.camera, body.position)
        return seen.point, float(np.arctan2(body.reach_m, seen.distance_m))

    def sun_angles_deg(self, point: Point) -> tuple[float, float]:
        """Return azimuth and elevation [deg] of a point in the levelled frame, as `light.sun_azimuth_deg` has them."""
        x, y, z = placing.ray(self.camera, point)
        return float(np.degrees(np.arctan2(x, -z))), float(np.degrees(np.arcsin(np.clip(y, -1.0, 1.0))))

    def rim(self) -> list[list[Point]]:
        """Return the line around the part of a level receiver that is changed; nothing for others."""
        if self.receiver is None or self.receiver.plane_y is None:
            return []
        around = np.linspace(-np.pi, np.pi, _RIM_POINTS)
        down = self.receiver.plane_y - float(self.camera.position[1])
        radius = np.sqrt(max(self.receiver.extent_m**2 - down**2, 0.0))
        if radius <= 0.0:
            return []
        places = np.stack([radius * np.sin(around), np.full_like(around, down), -radius * np.cos(around)], axis=-1)
        return [[placing.shown_at(self.camera, self.camera.position + place).point for place in places]]


def situation(preview: LivePreview, scene: Scene, index: int, time_s: float) -> Situation:
    """Return the situation of a frame; raises what loading the scene raises."""
    loaded = preview.loaded(scene, _WIDTH).at(time_s)
    view = loaded.view(time_s)
    bodies = []
    for number, one in enumerate(loaded.objects):
        placed = one.at(time_s, index, view.position, view.world_from_camera)
        with_camera = one.settings.attach == "camera"
        turned = placed.world_from_object[:3, :3] / placed.scale
        name = f"{number + 1} {one.settings.mesh.stem}"
        bodies.append(
            Body(name, placed.world_from_object[:3, 3].copy(), turned, placed.scale, placed.mesh.hull, with_camera)
        )
    receiver = None if loaded.receiver is None else loaded.receiver.at(index)
    return Situation(view, receiver, tuple(bodies))
