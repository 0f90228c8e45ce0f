# SPDX-License-Identifier: Apache-2.0
"""The types that flow between the stages, and the conventions that hold everywhere.

Units: metres, seconds, radians; wavelength in nm; optical coefficients in 1/m. Bare floats carry the unit in the
name (`time_s`, `depth_m`).

Axes: right-handed, +y up, camera at the origin of the world at t = 0, forward = -z, right = +x. The mean water
surface is the plane y = surface_y_m, the depth of the camera at t = 0; the depth of a point is surface_y_m - y,
positive below the surface.
Equirectangular pixels: see `mr360uw.sphere`.

Directions are unit vectors. View directions point from the camera outwards, light directions *towards* the light;
a direction of travel says `_travel`. Phase functions take the cosine between the directions of travel before and
after a scattering event, forward = +1.

Colour is linear Rec.709 scene radiance, float32, alpha premultiplied; names say `_linear` or `_encoded`. Arrays are
images first: (H, W, 3), row 0 at the top. Random numbers depend on the seed and the frame index alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import ColorSpec
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.sphere import direction_from_frame

Floats = NDArray[np.floating[Any]]


class Rectangle(NamedTuple):
    """A part of a frame in pixels: top left corner and size. It may run over the seam: column + width > W."""

    column: int
    row: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera at one instant: what its frame shows of the world.

    width, height: of the frame in pixels. position: (3,) [m] in the world. world_from_camera: (3, 3) rotation.
    surface_y_m: height of the mean water surface in the world. projection: how pixels become directions
    (`mr360uw.sphere`).
    """

    width: int
    height: int
    position: Floats = field(default_factory=lambda: np.zeros(3))
    world_from_camera: Floats = field(default_factory=lambda: np.eye(3))
    surface_y_m: float = 5.0
    projection: Literal["equirectangular"] = "equirectangular"

    def directions(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the unit directions (..., 3) in the world seen at continuous frame coordinates."""
        return direction_from_frame(x, y, self.width, self.height) @ self.world_from_camera.T

    def depth_of(self, point: Floats) -> Floats:
        """Return the depth (...,) [m] below the mean surface of points (..., 3) from the camera, world axes."""
        return self.surface_y_m - (point[..., 1] + self.position[1])

    @property
    def key(self) -> tuple[object, ...]:
        """A value that is equal for views that show the same."""
        return (
            self.projection, self.width, self.height, self.position.tobytes(), self.world_from_camera.tobytes(),
            self.surface_y_m,
        )  # fmt: skip


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
class Sun:
    """A dominant light as the camera sees it (below the surface: after refraction).

    direction: (3,) unit, towards the sun. irradiance: (3,) linear RGB on a plane perpendicular to the beam, in plate
    radiance times sr. half_angle_rad: angular radius of the disc. confidence: 0 (a guess) to 1 (given or certain).
    """

    direction: Floats
    irradiance: Floats
    half_angle_rad: float
    confidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A point or spot light at one instant, in the world.

    position: (3,) [m]. axis: (3,) unit, the direction of travel along the middle of a spot. intensity: (3,) linear RGB
    along the axis, in plate radiance times m2: the irradiance at 1 m without water. cos_core, cos_edge: cosines of the
    angles from the axis up to which a spot is fully bright and from which on it is dark; both -1 for a point light.
    radius_m: of the ball that shines, for soft shadows. attenuation: (D, 3) effective beam attenuation [1/m] of its
    light over a path S in water, at t = S/(S + length_m) of the medium's table; None without water. casts_shadow:
    whether bodies take its light away behind them.
    """

    position: Floats
    axis: Floats
    intensity: Floats
    cos_core: float = -1.0
    cos_edge: float = -1.0
    radius_m: float = 0.0
    attenuation: Floats | None = None
    casts_shadow: bool = True


Light = Sun | Lamp
"""A source with a direction of its own; what comes from all around is the `Environment`."""


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """The light that reaches the camera, (32, 64, 3) equirectangular maps in plate radiance.

    radiance: of the expanded plate. irradiance: cosine integral of `radiance` over the hemisphere about each
    pixel's direction. sun: None where there is none. residual: `radiance` without the sun. ambient: cosine integral
    of `residual`, what surfaces receive besides the sun's beam. glossy: `residual` filtered by GGX lobes, (L, 32, 64,
    3), at the roughnesses `glossy_roughness` (L,), ascending; L = 0 where nothing needs them.
    """

    radiance: Floats
    irradiance: Floats
    sun: Sun | None
    residual: Floats
    ambient: Floats
    glossy: Floats
    glossy_roughness: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A displaced water surface at one time.

    position: (..., 3), y = height above the mean surface. normal: (..., 3) unit, y > 0. jacobian: (...,) determinant
    of the horizontal displacement, positive where the surface does not fold over.
    """

    position: Floats
    normal: Floats
    jacobian: Floats


@dataclass(frozen=True, slots=True, eq=False)
class BeamSpread:
    """Spread of sunlight that the water has turned by small angles, over a plane across the beam.

    scattering: by small angles [1/m]; times the path from the surface it is an optical depth. angle_rad: (k,) standard
    deviations of Gaussians over the path. optical_depth: (t,) ascending. weight: (t, k) of the Gaussians, each row of
    sum 1, for light that has turned.
    """

    scattering: float
    angle_rad: Floats
    optical_depth: Floats
    weight: Floats

    def unturned(self, path_m: float) -> float:
        """Return the fraction of the beam that has not turned after a path."""
        return float(np.exp(-self.scattering * path_m))

    def weights(self, path_m: float) -> Floats:
        """Return the weights (k,) of the Gaussians after a path, sum 1."""
        tau = self.scattering * path_m
        return np.array([np.interp(tau, self.optical_depth, column) for column in self.weight.T])


@dataclass(frozen=True, slots=True, eq=False)
class CausticStack:
    """Irradiance of the sun's refracted beam on horizontal planes, relative to a flat surface (mean 1).

    ratio: (D, size, size, 3) on planes `depth_m` (D,) below the mean surface, ascending; column = +x, row = +z,
    periodic. Maps lie along the beam: a pixel is where its ray comes from on the mean surface, and pixel (0, 0) spans
    [0, tile_m/size) there from the world's origin. sun_direction: (3,) unit, towards the sun, in the water. soft: (D,
    size, size, 1) the same of the light that the water has turned by small angles; None: even.
    """

    ratio: Floats
    depth_m: Floats
    tile_m: float
    sun_direction: Floats
    soft: Floats | None = None

    @property
    def softened(self) -> bool:
        """Whether light that has turned has a pattern."""
        return self.soft is not None


@dataclass(frozen=True, slots=True, eq=False)
class MediumTable:
    """Everything one pixel needs of the water, for one camera depth, in linear RGB.

    Distances S enter as t = S/(S + length_m) and depths d as d/(d + length_m), both uniform over [0, 1]; `up`, the y
    of the view direction, is uniform over [-1, 1].

    veil: (U, T, 3) radiance scattered into a camera ray of distance S, divided by 1 - exp(-S/length_m).
    attenuation: (D, T, 3) effective beam attenuation [1/m] of an object at depth d seen over distance S:
    transmittance = exp(-attenuation S).
    diffuse: (D, 3) effective attenuation [1/m] of the ambient irradiance between the camera's depth and d:
    E(d)/E(camera) = exp(-diffuse (d - camera_depth_m)).
    beam: (D, 3) effective attenuation [1/m] of the sun's beam over its path p = d/(y of its direction) from the
    surface, which enters like a depth: E(p)/E(0) = exp(-beam p). Light that has turned by small angles is still in it.
    unscattered: (D, 3) the same of the part of the beam that has not turned at all.
    refractive_index: of the water relative to air.
    """

    camera_depth_m: float
    length_m: float
    veil: Floats
    attenuation: Floats
    diffuse: Floats
    beam: Floats
    unscattered: Floats
    refractive_index: float = REFRACTIVE_INDEX_SEA


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
