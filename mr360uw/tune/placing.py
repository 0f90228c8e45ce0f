# SPDX-License-Identifier: Apache-2.0
"""Placement by clicks and drags in a picture: positions, angles and sizes of objects.

A point of a picture is a direction in the camera's axes, given by longitude and latitude [rad] as `mr360uw.base.sphere`
defines them: right of the centre and up are positive. Positions are in the world [m]; an object that is attached to the
camera has its own in the camera's axes (`in_camera`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.base.sphere import direction_from_angles, frame_from_direction, unit
from mr360uw.errors import ParameterError
from mr360uw.types import Floats, View

if TYPE_CHECKING:
    from mr360uw.composite.shot import Receiver

_WIDEST_RAD = 1.4
_NARROWEST_RAD = 1e-3
"""Angles from an object's centre between which a drag scales it: near a right angle the tangent has no bound, at the
centre the ratio of two has none."""


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a picture. longitude, latitude: [rad] in the camera's axes."""

    longitude: float
    latitude: float

    @property
    def direction(self) -> Floats:
        """Unit direction (3,) in the camera's axes."""
        return direction_from_angles(self.longitude, self.latitude)


def pixel_of_point(point: Point, width: int, height: int) -> tuple[float, float]:
    """Return the continuous coordinates (x, y) of a point in an equirectangular picture."""
    x, y = frame_from_direction(point.direction, width, height)
    return float(x), float(y)


def ray(camera: View, point: Point) -> Floats:
    """Return the unit direction (3,) of a point in the world."""
    return camera.world_from_camera @ point.direction


def at_distance(camera: View, point: Point, distance_m: float) -> Floats:
    """Return the position (3,) that a point shows at a distance [m] along its ray; raise `ParameterError`."""
    if not 0.0 < distance_m < np.inf:
        raise ParameterError(f"distance - must be above 0 m (got {distance_m:g}) - give the distance from the camera")
    return camera.position + distance_m * ray(camera, point)


def swim_to(camera: View, point: Point, position: Floats) -> Floats:
    """Return the position (3,) in the direction of a point, as far from the camera as `position`."""
    return at_distance(camera, point, float(np.linalg.norm(position - camera.position)))


def shown_at(camera: View, position: Floats) -> tuple[Point, float]:
    """Return the point that shows a position of the world, its distance [m]; `ParameterError` at the camera itself."""
    away = np.asarray(position, np.float64) - camera.position
    distance = float(np.linalg.norm(away))
    if not distance > 0.0:
        raise ParameterError(f"position - is the camera's own (got {np.round(position, 3).tolist()}) - move it away")
    d = unit(camera.world_from_camera.T @ away)
    return Point(float(np.arctan2(d[0], -d[2])), float(np.arctan2(d[1], np.hypot(d[0], d[2])))), distance


def in_camera(camera: View, position: Floats) -> Floats:
    """Return a position of the world in the camera's axes, as objects have it that are attached to the camera."""
    return camera.world_from_camera.T @ (position - camera.position)


def meets(camera: View, point: Point, receiver: Receiver) -> Floats:
    """Return the position (3,) at which a point's ray meets the receiver; raise `ParameterError` where it does not."""
    from mr360uw.composite.receiver.shape import ReceiverShape

    x, y = pixel_of_point(point, camera.width, camera.height)
    column, row, direction = np.array([x]), np.array([y]), ray(camera, point)[None]
    distance, _ = ReceiverShape(receiver, camera.position).meet(camera, column, row, direction)
    if not np.isfinite(distance[0]):
        raise ParameterError(
            f"receiver - is not in this direction (got none within {receiver.extent_m:g} m) - click on the floor, or "
            "set receiver.extent_m"
        )
    return camera.position + distance[0] * direction[0]


def foot(hull: Floats, rotation: Floats, scale: float) -> Floats:
    """Return the middle (3,) of the bottom of an object's bounding box, from its position, in the world's axes [m].

    hull: triangles (h, 3, 3) of the mesh's hull. rotation: (3, 3).
    """
    corners = scale * hull.reshape(-1, 3) @ rotation.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    return np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])


def stand_at(
    camera: View, point: Point, receiver: Receiver, hull: Floats, rotation: Floats, scale: float = 1.0
) -> Floats:
    """Return the position (3,) of an object that stands on the receiver where a point's ray meets it.

    Its foot is above or at the clicked place, and none of its hull is below the receiver. On a mesh that is not flat it
    is raised until its hull touches: vertices of both are compared, edges that cross are not. On a distance map, which
    says nothing of what is hidden, it stands on the level plane through the clicked place. Raises `ParameterError`.
    """
    place = meets(camera, point, receiver)
    position = place - foot(hull, rotation, scale)
    if receiver.mesh is None:
        return position
    body = scale * hull @ rotation.T + position
    return position + np.array([0.0, _sunk(body, receiver.mesh), 0.0])


def _sunk(body: Floats, ground: Floats) -> float:
    """Return the height [m] by which a convex body (h, 3, 3) must rise to stand on triangles (T, 3, 3); may be < 0."""
    low, high = body.reshape(-1, 3).min(axis=0), body.reshape(-1, 3).max(axis=0)
    near = np.all((ground.min(axis=1) <= high)[:, ::2] & (ground.max(axis=1) >= low)[:, ::2], axis=-1)
    ground = ground[near]
    points, tops = np.unique(body.reshape(-1, 3), axis=0), np.unique(ground.reshape(-1, 3), axis=0)
    over = float(max(high[1], ground[..., 1].max(initial=high[1]))) + 1.0
    under = float(min(low[1], ground[..., 1].min(initial=low[1]))) - 1.0
    sunk = np.concatenate([
        _first_height(ground, points, over) - points[:, 1],
        tops[:, 1] - _first_height(body, tops, under),
    ])  # fmt: skip
    sunk = sunk[np.isfinite(sunk)]
    return float(sunk.max()) if len(sunk) else 0.0


def _first_height(triangles: Floats, points: Floats, start_y: float) -> Floats:
    """Return the height (n,) at which vertical lines through points first meet triangles from `start_y`, or NaN."""
    from mr360uw.base.rays import RayScene, barycentric

    origins = points.copy()
    origins[:, 1] = start_y
    down = np.zeros_like(points)
    down[:, 1] = np.sign(points[:, 1].mean() - start_y) if len(points) else 1.0
    found = RayScene(triangles).first_hit(origins, down)
    height, hit = np.full(len(points), np.nan), found >= 0
    _, along = barycentric(triangles[found[hit]] - origins[hit, None], down[hit])
    height[hit] = start_y + along * down[hit, 1]
    return height


def yaw_by_drag(yaw_deg: float, center: Point, start: Point, end: Point, step_deg: float = 0.0) -> float:
    """Return the yaw [deg], in (-180, 180], of an object after a drag, as if its near side were gripped.

    The angle by which the pointer moves to the right, seen from the camera, over that between the object's centre and
    the start of the drag, is the turn in quarters: a drag by the length of the handle's arm turns by 90 degrees.
    step_deg: the result is a multiple of it; 0: any angle.
    """
    arm = max(_angle(center, start), _NARROWEST_RAD)
    across = np.array([np.cos(center.longitude), 0.0, np.sin(center.longitude)])  # to the right in the picture
    moved = float(np.arcsin(np.clip(across @ end.direction, -1.0, 1.0)))
    moved -= float(np.arcsin(np.clip(across @ start.direction, -1.0, 1.0)))
    yaw = yaw_deg - 90.0 * moved / arm
    if step_deg > 0.0:
        yaw = step_deg * round(yaw / step_deg)
    return float(180.0 - (180.0 - yaw) % 360.0)


def scale_by_drag(scale: float, center: Point, start: Point, end: Point) -> float:
    """Return the scale, or the size, of an object after a drag of its edge from one point to another.

    Sizes go with the tangents of the angles from the object's centre.
    """
    first, last = (float(np.clip(_angle(center, p), _NARROWEST_RAD, _WIDEST_RAD)) for p in (start, end))
    return scale * float(np.tan(last) / np.tan(first))


def _angle(one: Point, other: Point) -> float:
    """Return the angle [rad] between two points, exact for small ones too."""
    a, b = one.direction, other.direction
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
