# SPDX-License-Identifier: Apache-2.0
"""A frame: its pixels, the camera that took it, its code values.

The viewing circle of omnidirectional stereo is where the rays of an eye's panorama start. A panorama for one eye cannot
be taken from one point: whichever way the head turns, the eye is half the distance between both beside the middle of
the head. Each column is therefore seen from its own point of a circle, a quarter turn beside its direction (Ishiguro
1992; Peleg 2001, section 2; Google 2015). Here the circle shrinks with the cosine of the latitude, to a point at the
poles, where no column has a direction of its own:

    start = e d x up = e cos(lat) (cos lon, 0, sin lon)        a ray sees start + t d
    d direction of the pixel, up axis of the poles, e half the distance between the eyes, negative for the left one

The start is perpendicular to the ray and linear in it. A point P = (x, y, z) from the middle, in the camera's axes, is
seen at the distance t > 0 that solves (x^2 + z^2)/(t^2 + e^2) + y^2/t^2 = 1, at

    d = (t x + e z, (t^2 + e^2) y/t, t z - e x)/(t^2 + e^2)

so it lies atan(e/t) beside its direction from the middle. Of a point at the height of the camera at distance D that is
asin(e/D): the disparity of both eyes is 2 asin(e/D). Shaders: composite/gl/shaders/eyes.glsl.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.cache import Parts
from mr360uw.color import ColorSpec
from mr360uw.constants import PI
from mr360uw.sphere import direction_from_frame, frame_from_direction, unit

Array = NDArray[np.float64]


def ray_starts(direction: ArrayLike, up: ArrayLike, eye_m: float) -> Array:
    """Return where an eye's rays start, (..., 3) [m] from the middle between the eyes, in the axes of the arguments.

    direction: (..., 3) unit. up: (3,) unit, the axis of the frame's poles. eye_m: of the eye to the right of the
    middle, negative to the left.
    """
    return np.asarray(eye_m * np.cross(np.asarray(direction), np.asarray(up)), np.float64)


def seen_direction(point: ArrayLike, eye_m: float) -> Array:
    """Return the unit directions (..., 3) in which an eye sees points (..., 3) [m] from the middle, camera's axes."""
    p, squared = np.asarray(point, np.float64), eye_m * eye_m
    y2 = np.square(p[..., 1])
    over = 0.5 * (np.sum(np.square(p), axis=-1) - squared)
    t2 = np.maximum(over + np.sqrt(np.square(over) + y2 * squared), 1e-24)
    t = np.sqrt(t2)
    level = 1.0 / (t2 + squared)
    x, z = (t * p[..., 0] + eye_m * p[..., 2]) * level, (t * p[..., 2] - eye_m * p[..., 0]) * level
    return np.stack([x, p[..., 1] / t, z], axis=-1)


Floats = NDArray[np.floating[Any]]


class Rectangle(NamedTuple):
    """A part of a frame in pixels: top left corner and size. It may run over the seam: column + width > W."""

    column: int
    row: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, eq=False)
class View(Parts):
    """A camera at one instant: what its frame shows of the world.

    width, height: of the frame in pixels. position: (3,) [m] in the world. world_from_camera: (3, 3) rotation.
    surface_y_m: height of the mean water surface in the world. projection: how pixels become rays: "equirectangular"
    (`mr360uw.sphere`), "perspective" with the horizontal angle `fov_rad`, or "orthographic", parallel rays over a width
    of `width_m` [m]; square pixels. The composite's views are equirectangular. eye_m: of an eye's panorama, the radius
    [m] of the viewing circle on which its rays start, negative for the left eye; 0 for rays from `position`.
    """

    width: int
    height: int
    position: Floats = field(default_factory=lambda: np.zeros(3))
    world_from_camera: Floats = field(default_factory=lambda: np.eye(3))
    surface_y_m: float = 5.0
    projection: Literal["equirectangular", "perspective", "orthographic"] = "equirectangular"
    fov_rad: float = 0.5 * PI
    width_m: float = 10.0
    eye_m: float = 0.0

    def directions(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the unit directions (..., 3) in the world seen at continuous frame coordinates."""
        if self.projection == "equirectangular":
            return direction_from_frame(x, y, self.width, self.height) @ self.world_from_camera.T
        right, up = self._from_middle(x, y)
        half = math.tan(0.5 * self.fov_rad) if self.projection == "perspective" else 0.0
        return unit(np.stack([half * right, half * up, -np.ones(right.shape)], axis=-1)) @ self.world_from_camera.T

    def origins(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return where the rays of continuous frame coordinates start in the world, (..., 3) [m]."""
        right, up = self._from_middle(x, y)
        half = 0.5 * self.width_m if self.projection == "orthographic" else 0.0
        beside = np.stack([half * right, half * up, np.zeros(right.shape)], axis=-1)
        return self.position + beside @ self.world_from_camera.T

    def starts(self, direction: Floats) -> Floats:
        """Return where a panorama's rays in directions (..., 3) start, (..., 3) [m] from `position`, world axes."""
        if not self.eye_m:
            return np.zeros(direction.shape)
        return ray_starts(direction, self.world_from_camera[:, 1], self.eye_m)

    def points(self, direction: Floats, distance_m: Floats) -> Floats:
        """Return the points (..., 3) [m], from `position`, at distances (...) along rays in directions (..., 3)."""
        along = direction * distance_m[..., None]
        return along + self.starts(direction) if self.eye_m else along

    def from_middle(self, direction: Floats, distance_m: Floats) -> tuple[Floats, Floats]:
        """Return the unit directions (n, 3) and distances (n,) from `position` of the points at ends of rays."""
        if not self.eye_m:
            return direction, distance_m
        point = self.points(direction, distance_m)
        length = np.linalg.norm(point, axis=-1)
        return point / np.maximum(length, 1e-12)[..., None], length

    def seen(self, point: Floats) -> Floats:
        """Return the unit directions (..., 3), in the camera's axes, in which a panorama shows points (..., 3) [m].

        point: from `position`, world axes.
        """
        local = point @ self.world_from_camera
        if self.eye_m:
            return seen_direction(local, self.eye_m)
        return np.asarray(local / np.maximum(np.linalg.norm(local, axis=-1, keepdims=True), 1e-12))

    def places(self, point: Floats) -> tuple[Floats, Floats]:
        """Return the frame coordinates x, y (...) at which a panorama shows points (..., 3) [m] from `position`."""
        local = point @ self.world_from_camera
        return frame_from_direction(seen_direction(local, self.eye_m) if self.eye_m else local, self.width, self.height)

    @property
    def pixel_rad(self) -> float:
        """Width [rad] of a pixel in the middle of the frame; 0 for parallel rays."""
        if self.projection == "orthographic":
            return 0.0
        return (
            PI / self.height
            if self.projection == "equirectangular"
            else 2.0 * math.tan(0.5 * self.fov_rad) / self.width
        )

    @property
    def pixel_m(self) -> float:
        """Width [m] of a pixel at the camera: that of parallel rays, else 0."""
        return self.width_m / self.width if self.projection == "orthographic" else 0.0

    def _from_middle(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Return coordinates to the right and up from the middle of the frame, in halves of its width."""
        right, up = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        return 2.0 * right / self.width - 1.0, (self.height - 2.0 * up) / self.width

    def depth_of(self, point: Floats) -> Floats:
        """Return the depth (...,) [m] below the mean surface of points (..., 3) from the camera, world axes."""
        return self.surface_y_m - (point[..., 1] + self.position[1])


@dataclass(frozen=True, slots=True, eq=False)
class YuvImage:
    """The planes of a decoded video frame, as code values.

    y: (H, W); u, v: (H/2, W/2) for 4:2:0, (H, W/2) for 4:2:2, (H, W) for 4:4:4; uint8, or uint16 above 8 bits. Chroma
    of 4:2:0 is sited left, as H.264 and HEVC do. spec: how the codes are to be read.
    """

    y: NDArray[np.unsignedinteger[Any]]
    u: NDArray[np.unsignedinteger[Any]]
    v: NDArray[np.unsignedinteger[Any]]
    spec: ColorSpec
