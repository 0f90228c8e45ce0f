# SPDX-License-Identifier: Apache-2.0
"""Marks over a picture: where objects, lamps and the sun show, and the edge of the receiver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.sphere import direction_from_frame
from mr360uw.tune.placing import Point, shown_at
from mr360uw.types import Floats, View

if TYPE_CHECKING:
    from mr360uw.composite.shot import Receiver
    from mr360uw.render.loaded import Loaded
    from mr360uw.render.plate_light import FrameLight

Kind = Literal["object", "sun", "lamp", "spot"]
Handle = Literal["move", "turn", "scale"]
_AZIMUTHS, _ELEVATIONS = 180, 90
"""Directions in which the edge of a receiver is looked for: 2 degrees apart."""


@dataclass(frozen=True, slots=True)
class Marker:
    """A mark over the picture. name: unique. label: its text. radius: angular radius [rad] of an object, for handles.

    kind: an object, the sun, a lamp, or a spot (a clicked point). handles: those it has while it is selected.
    """

    name: str
    longitude: float
    latitude: float
    kind: Kind = "object"
    label: str = ""
    radius: float = 0.0
    handles: tuple[Handle, ...] = ("move", "turn", "scale")


def markers(loaded: Loaded, time_s: float, index: int, light: FrameLight | None) -> list[Marker]:
    """Return the marks of a frame: objects (object.0, ...), lamps (lamp.0, ...) and the sun, each where it shows.

    An object is marked at the centre of its bounding box. A lamp at the camera itself has no direction and no mark.
    """
    view = loaded.view(time_s)
    placed = [o.at(time_s, index, view.position, view.world_from_camera) for o in loaded.objects]
    found = []
    for number, (one, scene_object) in enumerate(zip(placed, loaded.objects, strict=True)):
        point, distance = _seen(view, one.to_world(one.mesh.center_m))
        if point is not None:
            radius = float(np.arctan2(one.mesh.radius_m * one.scale, distance))
            name, label = f"object.{number}", scene_object.settings.mesh.stem
            found.append(Marker(name, point.longitude, point.latitude, "object", label, radius))
    for number, lamp in enumerate(loaded.lamps):
        point, _ = _seen(view, lamp.at(time_s, view, placed).position)
        if point is not None:
            name = f"lamp.{number}"
            found.append(Marker(name, point.longitude, point.latitude, "lamp", f"lamp {number + 1}", 0.0, ("move",)))
    sun = None if light is None else light.environment.sun
    if sun is not None:
        point, _ = _seen(View(view.width, view.height), sun.direction)  # in the camera's axes
        assert point is not None
        found.append(Marker("sun", point.longitude, point.latitude, "sun", "sun", 0.0, ()))
    return found


def receiver_edge(camera: View, receiver: Receiver) -> list[list[Point]]:
    """Return lines of points along the far edge of a receiver: of a plane, where its extent ends; of another shape, the
    highest direction that meets it, where one does.
    """
    from mr360uw.composite.receiver.shape import ReceiverShape

    longitude = np.linspace(-np.pi, np.pi, _AZIMUTHS + 1)
    if receiver.plane_y is not None:
        height = receiver.plane_y - camera.position[1]
        if not 0.0 < abs(height) < receiver.extent_m:
            return []
        up = np.full(len(longitude), height / receiver.extent_m)
        level = np.sqrt(1.0 - up**2)
        world = np.stack([level * np.sin(longitude), up, -level * np.cos(longitude)], axis=-1)
        return [_points(world @ camera.world_from_camera)]
    x = (longitude / (2.0 * np.pi) + 0.5) * camera.width
    y = (np.arange(_ELEVATIONS) + 0.5)[:, None] * (camera.height / _ELEVATIONS)
    x, y = np.broadcast_arrays(x, y)
    seen = direction_from_frame(x, y, camera.width, camera.height)
    distance, _ = ReceiverShape(receiver, camera.position).meet_along(camera, x, y, seen @ camera.world_from_camera.T)
    hit = np.isfinite(distance)
    top, any_hit = np.argmax(hit, axis=0), np.any(hit, axis=0)
    rows = seen[top, np.arange(len(longitude))]
    breaks = np.flatnonzero(~any_hit | np.append(False, np.abs(np.diff(top)) > _ELEVATIONS // 8))
    parts = np.split(np.arange(len(longitude)), breaks)
    return [_points(rows[part[any_hit[part]]]) for part in parts if np.sum(any_hit[part]) > 1]


def _seen(view: View, position: Floats) -> tuple[Point | None, float]:
    try:
        return shown_at(view, position)
    except ParameterError:
        return None, 0.0


def _points(directions: Floats) -> list[Point]:
    longitude = np.arctan2(directions[:, 0], -directions[:, 2])
    latitude = np.arcsin(np.clip(directions[:, 1], -1.0, 1.0))
    return [Point(float(a), float(b)) for a, b in zip(longitude, latitude, strict=True)]
