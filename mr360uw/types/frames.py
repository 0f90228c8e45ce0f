# SPDX-License-Identifier: Apache-2.0
"""A frame: its pixels, the camera that took it, its code values, and the layers that are laid over it.

Slow quantities are measured in some frames of a clip (`sample_step`) and interpolated between them.

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


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A rectangle of the frame that something was drawn into.

    column, row: top left pixel; 0 <= column < W and the tile never crosses the seam. All arrays are (h, w, ...).
    radiance: (h, w, 3) premultiplied by alpha. alpha: (h, w) coverage in [0, 1]. distance_m: (h, w) along the ray
    to the nearest object, infinity where there is none. ratio: (h, w, 3) factor on the surface part of the plate
    behind the object (shadow below 1, caustics about 1). veil: (h, w, 3) the part of the plate's radiance that the
    water between camera and receiver adds, on which no shadow falls. shafts: (h, w, 3) radiance that light in the water
    before the plate deviates by from the smooth veil, of either sign; None where it is zero.
    """

    column: int
    row: int
    radiance: Floats
    alpha: Floats
    distance_m: Floats
    ratio: Floats
    veil: Floats
    shafts: Floats | None = None

    @property
    def rectangle(self) -> Rectangle:
        """Where the tile lies in the frame."""
        height, width = self.alpha.shape
        return Rectangle(self.column, self.row, width, height)

    @property
    def window(self) -> tuple[slice, slice]:
        """The tile's rows and columns, to index a full frame with."""
        height, width = self.alpha.shape
        return slice(self.row, self.row + height), slice(self.column, self.column + width)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """What is laid over a plate: disjoint tiles of a height x width frame; everything else stays untouched."""

    height: int
    width: int
    tiles: tuple[Tile, ...]

    def _full(self, name: str, background: float, channels: int) -> Floats:
        shape = (self.height, self.width, channels) if channels else (self.height, self.width)
        image = np.full(shape, background, np.float32)
        for tile in self.tiles:
            if (values := getattr(tile, name)) is not None:
                image[tile.window] = values
        return image

    @property
    def radiance(self) -> Floats:
        """Premultiplied radiance of the whole frame, (H, W, 3)."""
        return self._full("radiance", 0.0, 3)

    @property
    def alpha(self) -> Floats:
        """Coverage of the whole frame, (H, W)."""
        return self._full("alpha", 0.0, 0)

    @property
    def distance_m(self) -> Floats:
        """Ray distance of the whole frame, (H, W), infinity where there is no object."""
        return self._full("distance_m", np.inf, 0)

    @property
    def ratio(self) -> Floats:
        """Receiver ratio of the whole frame, (H, W, 3), 1 where nothing changes."""
        return self._full("ratio", 1.0, 3)

    @property
    def shafts(self) -> Floats:
        """Deviation of the light in the water of the whole frame, (H, W, 3), of either sign."""
        return self._full("shafts", 0.0, 3)


LIGHT_SAMPLES_HZ = 8.0
"""Samples in a second. Waves of 2 s, the shortest that move the sun much, are sampled 16 times; the gain of the veil is
smoothed over two to four seconds afterwards. Twice as large, measuring takes twice as long."""


def sample_step(frame_rate: float) -> int:
    """Return the number of frames from one sample to the next, 1 or more; frames whose index it divides are samples."""
    return max(round(frame_rate / LIGHT_SAMPLES_HZ), 1)
