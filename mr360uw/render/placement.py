# SPDX-License-Identifier: Apache-2.0
"""Placement checks: notes on objects that are above the water, around the camera, or smaller than a pixel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mr360uw.composite import PlacedObject, SceneObject
from mr360uw.render.camera import CameraPath
from mr360uw.scene.model import Scene
from mr360uw.types import Floats

_INSTANTS = 64
"""Most times at which an object is checked."""


def placement_notes(scene: Scene, objects: tuple[SceneObject, ...], camera: CameraPath, height: int) -> tuple[str, ...]:
    """Return a line for every object that is above the water, around the camera, or smaller than a pixel.

    height: of the frame in pixels. Checked at the keys of the object and of the camera.
    """
    return tuple(
        f"object[{number}] {placed.settings.mesh.name} - {note}"
        for number, placed in enumerate(objects)
        for note in _notes(scene, placed, camera, height)
    )


def _notes(scene: Scene, placed: SceneObject, camera: CameraPath, height: int) -> Iterator[str]:
    times = _times(placed, camera)
    poses = [camera.at(time) for time in times]
    views = [placed.at(time, 0, *pose) for time, pose in zip(times, poses, strict=True)]
    surface_m = scene.camera.depth_m
    above = [view.to_world(view.mesh.hull.reshape(-1, 3))[:, 1].min() - surface_m for view in views]
    if scene.water.type != "none" and min(above) > 0.0:
        yield (
            f"is wholly above the water's surface (got {min(above):.2f} m at the least) - lower its position_m, or set "
            "camera.depth_m to the camera's true depth"
        )
    inside = [time for time, (eye, _), view in zip(times, poses, views, strict=True) if _is_in_bounds(eye, view)]
    if inside and placed.settings.visible:
        yield (
            f"the camera is within its bounds (got time {inside[0]:.2f} s) - if that is not meant, move it by "
            "position_m, or set its size_m or scale"
        )
    pixels = [_pixels(eye, view, height) for (eye, _), view in zip(poses, views, strict=True)]
    if max(pixels) < 1.0 and placed.settings.visible:
        yield f"is smaller than a pixel (got {max(pixels):.2g} at the most) - set its scale, or move it nearer"


def _times(placed: SceneObject, camera: CameraPath) -> Floats:
    """Return the times [s] at which the object or the camera has a key, thinned out where there are many, and some of
    the clip that the object plays.
    """
    known = [np.zeros(1), placed.instants]
    known += [] if camera.track is None else [camera.track.time_s]
    known += [] if camera.depth_keys is None else [camera.depth_keys[:, 0]]
    times = np.unique(np.concatenate(known))
    return times[np.unique(np.linspace(0, len(times) - 1, _INSTANTS).round().astype(int))]


def _is_in_bounds(eye: Floats, view: PlacedObject) -> bool:
    """Return whether a point of the world is in an object's bounding box."""
    local = np.linalg.solve(view.world_from_object, [*eye, 1.0])[:3]
    return bool(np.all(np.abs(local - view.mesh.center_m) <= 0.5 * view.mesh.extent_m))


def _pixels(eye: Floats, view: PlacedObject, height: int) -> float:
    """Return the diameter of an object's bounding sphere in pixels."""
    distance = float(np.linalg.norm(view.to_world(view.mesh.center_m) - eye))
    return 2.0 * view.mesh.radius_m * view.scale / max(distance, 1e-9) * height / np.pi
