# SPDX-License-Identifier: Apache-2.0
"""Places a solved path in the world: up, the floor below the camera, scale, heading of the first frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.sphere import unit
from mr360uw.track.camera_track import Floor
from mr360uw.types import Floats

GUESSED_HEIGHT_M, GUESSED_DISTANCE_M = 2.0, 5.0
"""Height over the floor, or median distance of the points, that is assumed where no measure is given."""
_LARGEST_SLOPE = np.radians(30.0)
"""Largest angle between the floor's normal and up."""
_BELOW = np.sin(np.radians(20.0))
"""Sine of the depression below which points are looked at for a floor."""
_TRIALS = 400
_THICKNESS = 0.08
"""Distance from the plane over the camera's height up to which a point lies on it: sand ripples and stones."""
_LEAST_POINTS, _LEAST_SUPPORT = 30, 0.25
"""Fewest points, and least share of the points below the camera, of a floor."""
_LEVEL_SUPPORT, _LEVEL_SLOPE = 0.5, np.radians(15.0)
"""Least support and largest slope against the frames' own up of a floor that is taken for level."""
_LEVELLED = np.radians(1.0)
"""Largest rms angle of the frames' own up about its mean of a clip that is levelled by the camera."""
_SEED = 1


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Plane normal . x = offset, its share of the points below the camera and their number."""

    normal: Floats
    offset: float
    support: float
    points: int


def fit_floor(points: Floats, camera: Floats, up: Floats) -> Plane | None:
    """Return the plane that most points (n, 3) below a camera (3,) lie on; None where no plane has enough.

    Planes through three random points are tried (Fischler & Bolles 1981), and the best is fitted to its points. Its
    normal is within 30 degrees of `up` (3,), and it is below the camera.
    """
    away = points - camera
    below = away[(away @ up) < -_BELOW * np.linalg.norm(away, axis=1)]
    if len(below) < _LEAST_POINTS:
        return None
    rng = np.random.default_rng(_SEED)
    corner = below[rng.integers(0, len(below), (_TRIALS, 3))]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1)
    real = length > 1e-12
    normal, corner = normal[real] / length[real, None], corner[real]
    normal *= np.where(normal @ up < 0.0, -1.0, 1.0)[:, None]
    height = -np.sum(normal * corner[:, 0], axis=1)
    fit = (normal @ up > np.cos(_LARGEST_SLOPE)) & (height > 0.0)
    normal, height = normal[fit], height[fit]
    if not len(normal):
        return None
    off = np.abs(normal @ below.T + height[:, None])
    best = int(np.argmax(np.count_nonzero(off < _THICKNESS * height[:, None], axis=1)))
    n, h = normal[best], float(height[best])
    for _ in range(5):
        on = below[np.abs(below @ n + h) < _THICKNESS * h]
        if len(on) < 3:
            return None
        centre = on.mean(axis=0)
        n = np.linalg.svd(on - centre, full_matrices=False)[2][-1]
        n = n * np.sign(n @ up)
        h = -float(n @ centre)
        if h <= 0.0:
            return None
    inside = np.abs(below @ n + h) < _THICKNESS * h
    support = float(np.mean(inside))
    if np.count_nonzero(inside) < _LEAST_POINTS or support < _LEAST_SUPPORT:
        return None
    return Plane(n, float(n @ camera) - h, support, int(np.count_nonzero(inside)))


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Similarity from a solved scene to the world: x -> scale rotation (x - origin); sentences on up and scale."""

    origin: Floats
    rotation: Floats
    scale: float
    up: str
    scale_from: str
    floor: Floor | None

    def place(self, points: Floats) -> Floats:
        """Return points (n, 3) of the solved scene in the world [m]."""
        placed: Floats = self.scale * (points - self.origin) @ self.rotation.T
        return placed


def rotation_to_world(up: Floats, first: Floats) -> Floats:
    """Return the rotation (3, 3) that takes `up` to +y and the level heading of a camera (3, 3) to -z."""
    y = unit(up)
    forward = -first[:, 2]
    level = forward - (forward @ y) * y
    if np.linalg.norm(level) < 1e-3:  # it looks straight up or down: the top of its picture is the heading
        level = first[:, 1] - (first[:, 1] @ y) * y
    z = -unit(level)
    return np.stack([np.cross(y, z), y, z])


def world_of(
    position: Floats, rotation: Floats, points: Floats, gravity_up: Floats | None, height_m: float | None
) -> World:
    """Return where a solved scene is in the world.

    position (n, 3), rotation (n, 3, 3): cameras, the first at time 0. points (m, 3). gravity_up (n, 3): up in each
    camera's axes, of the clip's metadata, if there is. Else up is the frames' own on average; but of clips that roll
    and pitch, the normal of a floor that is nearly level for the frames. height_m: of the first camera over the floor,
    which sets the scale; else a guess does.
    """
    own = rotation[:, :, 1] if gravity_up is None else np.einsum("nij,nj->ni", rotation, gravity_up)
    up: Floats = unit(np.mean(own, axis=0))
    words = "the frames' own up on average" if gravity_up is None else "the clip's gravity"
    plane = fit_floor(points, position[0], up) if len(points) else None
    rolls = float(np.sqrt(np.mean(np.sum(np.square(own - up), axis=1)))) > _LEVELLED
    if gravity_up is None and rolls and plane is not None and plane.support >= _LEVEL_SUPPORT:
        slope = float(np.arccos(np.clip(plane.normal @ up, -1.0, 1.0)))
        if slope <= _LEVEL_SLOPE:
            up, words = plane.normal, f"the floor's normal, {np.degrees(slope):.1f} degrees off the frames' own up"
    turned = rotation_to_world(up, rotation[0])
    if plane is None:
        return _without_floor(position[0], turned, points, words, height_m)
    # along up from the first camera to the plane
    height = (float(plane.normal @ position[0]) - plane.offset) / float(plane.normal @ up)
    wanted = GUESSED_HEIGHT_M if height_m is None else height_m
    tilt = np.degrees(np.arccos(np.clip(plane.normal @ up, -1.0, 1.0)))
    floor = Floor(-wanted, float(tilt), plane.support, plane.points)
    sentence = f"the camera is {wanted:g} m over the floor at time 0, "
    sentence += "as given" if height_m is not None else "a guess: give --height"
    return World(position[0], turned, wanted / height, words, sentence, floor)


def _without_floor(origin: Floats, turned: Floats, points: Floats, up: str, height_m: float | None) -> World:
    """Return the world of a scene without a floor: the scale is a guess."""
    if not len(points):
        return World(origin, turned, 1.0, up, "none is needed: the camera stays where it is", None)
    distance = float(np.median(np.linalg.norm(points - origin, axis=1)))
    words = f"half of the points are nearer than {GUESSED_DISTANCE_M:g} m, a guess"
    words += ": no floor was found for --height" if height_m is not None else ": no floor was found"
    return World(origin, turned, GUESSED_DISTANCE_M / distance, up, words, None)
