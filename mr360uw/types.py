# SPDX-License-Identifier: Apache-2.0
"""The types that flow between the stages, and the conventions that hold everywhere.

Units: metres, seconds, radians; wavelength in nm; optical coefficients in 1/m. Bare floats carry the unit in the
name (`time_s`, `depth_m`).

Axes: right-handed, +y up, camera at the origin of the world at t = 0, forward = -z, right = +x. The mean water
surface is the plane y = surface_y_m, the depth of the camera at t = 0; the depth of a point is surface_y_m - y,
positive below the surface.
Equirectangular pixels: see `mr360uw.base.sphere`.

Directions are unit vectors. View directions point from the camera outwards, light directions *towards* the light;
a direction of travel says `_travel`. Phase functions take the cosine between the directions of travel before and
after a scattering event, forward = +1.

Colour is linear Rec.709 scene radiance, float32, alpha premultiplied; names say `_linear` or `_encoded`. Arrays are
images first: (H, W, 3), row 0 at the top. Random numbers depend on the seed and the frame index alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import Parts
from mr360uw.base.color import ColorSpec
from mr360uw.base.constants import PI, REFRACTIVE_INDEX_SEA
from mr360uw.base.sphere import Array, direction_from_frame, frame_from_direction, unit
from mr360uw.plot import Figure, Shown

__all__ = [
    "Array", "BeamSpread", "CausticStack", "Environment", "Floats", "Lamp", "Layer", "Light", "MediumTable",
    "Rectangle", "Sun", "Surface", "Tile", "View", "YuvImage",
]  # fmt: skip


# The viewing circle of omnidirectional stereo is where the rays of an eye's panorama start. A panorama for one eye
# cannot be taken from one point: whichever way the head turns, the eye is half the distance between both beside the
# middle of the head. Each column is therefore seen from its own point of a circle, a quarter turn beside its direction
# (Ishiguro 1992; Peleg 2001, section 2; Google 2015). Here the circle shrinks with the cosine of the latitude, to a
# point at the poles, where no column has a direction of its own:
#
#     start = e d x up = e cos(lat) (cos lon, 0, sin lon)        a ray sees start + t d
#     d direction of the pixel, up axis of the poles, e half the distance between the eyes, negative for the left one
#
# The start is perpendicular to the ray and linear in it. A point P = (x, y, z) from the middle, in the camera's axes,
# is seen at the distance t > 0 that solves (x^2 + z^2)/(t^2 + e^2) + y^2/t^2 = 1, at
#
#     d = (t x + e z, (t^2 + e^2) y/t, t z - e x)/(t^2 + e^2)
#
# so it lies atan(e/t) beside its direction from the middle. Of a point at the height of the camera at distance D that
# is asin(e/D): the disparity of both eyes is 2 asin(e/D). Shaders: composite/gl/shaders/eyes.glsl.


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
    (`base.sphere`), "perspective" with the horizontal angle `fov_rad`, or "orthographic", parallel rays over a width
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

    def pixel_directions(self) -> Floats:
        """Return the unit directions (height, width, 3) in the world of the pixels' centres."""
        return self.directions(np.arange(self.width) + 0.5, (np.arange(self.height) + 0.5)[:, None])

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
        if self.projection == "equirectangular":
            return PI / self.height
        return 0.0 if self.projection == "orthographic" else 2.0 * math.tan(0.5 * self.fov_rad) / self.width

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


class UnlaidGround(Protocol):
    """Light on the ground of a frame, which no tile holds yet."""

    @property
    def lines(self) -> Any:
        """What lines of it are worked out from, for compiled functions: `tile_blend.GroundLines`."""

    def lay(self, tile: Tile) -> Tile:
        """Return a tile with its ratio and its veil on the ground."""

    def lines_of(self, part: Rectangle, first: int, step: int) -> tuple[Floats, Floats]:
        """Return ratio and veil (n, w, 3) of lines of a rectangle, the `first` one and each `step` lines further.

        The plate's own caustics are left out.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """What is laid over a plate: disjoint tiles of a height x width frame; everything else stays untouched.

    ground: light on the plate's ground that the tiles, which cover it, do not hold in their ratio and veil (`laid`);
    None where they do.
    """

    height: int
    width: int
    tiles: tuple[Tile, ...]
    ground: UnlaidGround | None = None

    def laid(self) -> Layer:
        """Return the layer with the light on the ground in its tiles."""
        if self.ground is None:
            return self
        return Layer(self.height, self.width, tuple(map(self.ground.lay, self.tiles)))

    def _full(self, name: str, background: float, channels: int) -> Floats:
        shape = (self.height, self.width, channels) if channels else (self.height, self.width)
        image = np.full(shape, background, np.float32)
        for tile in self.laid().tiles if name == "ratio" else self.tiles:
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


_LIGHT_SAMPLES_HZ = 8.0
"""Samples in a second. Waves of 2 s, the shortest that move the sun much, are sampled 16 times; the gain of the veil is
smoothed over two to four seconds afterwards. Twice as large, measuring takes twice as long."""


def sample_step(frame_rate: float) -> int:
    """Return the number of frames from one sample to the next, 1 or more; frames whose index it divides are samples."""
    return max(round(frame_rate / _LIGHT_SAMPLES_HZ), 1)


_PLANES_SHOWN, _RATIO_SHOWN = 4, 4.0
"""Planes of a stack that a notebook shows, and the irradiance ratio that is white there."""


def _exposed(radiance: Floats) -> Floats:
    """Return light over its 99 % quantile, so that a sun leaves the rest visible."""
    return np.asarray(radiance / max(float(np.quantile(radiance, 0.99)), 1e-12))


@dataclass(frozen=True, slots=True, eq=False)
class Sun(Parts):
    """A dominant light as the camera sees it (below the surface: after refraction).

    A level plane receives `irradiance` times the y of `direction`.

    Parameters
    ----------
    direction : ndarray
        Unit vector (3,) towards the sun.
    irradiance : ndarray
        Linear RGB (3,) on a plane perpendicular to the beam, in plate radiance times sr.
    half_angle_rad : float
        Angular radius [rad] of the disc.
    confidence : float
        How certain it is, 0 (a guess) to 1 (given or certain).
    shown : float
        How far strength and colour are those that a plate shows, 1, and not what others tell of a clipped disc, 0.
    share : float
        Fraction of the light of its spot in the plate that it is; the rest stays in the sky.

    See Also
    --------
    uw.ibl.detect_sun : Finds the sun of a plate.
    uw.caustics.refract_to_water : Turns a direction in air into that in water.
    uw.types.Lamp : A point or spot light.

    Examples
    --------
    >>> noon = uw.Sun(np.array([0.0, 1.0, 0.0]), np.ones(3), 0.00465, 1.0)
    >>> noon.confidence
    1.0
    """

    direction: Floats
    irradiance: Floats
    half_angle_rad: float
    confidence: float
    shown: float = 1.0
    share: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Lamp(Parts):
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

    @property
    def beam(self) -> NDArray[np.float64]:
        """How its light varies over directions, (2, 4), as `single_scattering.spot_of` and lamps.glsl read it."""
        return np.array([(self.cos_core, self.cos_edge, 0.0, 0.0), (*self.axis, 0.0)])


Light = Sun | Lamp
"""A source with a direction of its own; what comes from all around is the `Environment`."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Environment(Shown):
    """The light that reaches the camera, (32, 64, 3) equirectangular maps in plate radiance.

    A diffuse surface that faces a pixel's direction has the radiance albedo/pi times `irradiance` there. To let the sun
    cast shadows, take `sun` and `ambient` instead, which add up to it.

    Parameters
    ----------
    radiance : ndarray
        Radiance of the expanded plate (32, 64, 3), with the sun.
    irradiance : ndarray
        Cosine integral (32, 64, 3) of `radiance` over the hemisphere about each pixel's direction, with the sun.
    sun : Sun or None
        The sun, None where there is none.
    residual : ndarray
        The same as `radiance` (32, 64, 3), without the sun.
    ambient : ndarray
        Cosine integral (32, 64, 3) of `residual`: what surfaces receive besides the sun's beam.
    glossy : ndarray
        The `residual` filtered by GGX lobes, (L, 32, 64, 3), without the sun; L = 0 where nothing needs them.
    glossy_roughness : ndarray
        Roughnesses (L,) of `glossy`, ascending.
    detail : ndarray or None
        Map (128, 256, 3) that `residual` is the mean of, but for light of the sky that was restored later; None where
        it is not known.

    See Also
    --------
    uw.ibl.environment : Makes one from a plate.
    uw.ibl.irradiance : The integral by itself.
    uw.plot.show : Draws the radiance.

    Examples
    --------
    >>> light = uw.ibl.environment(plate, underwater=True)
    >>> light.radiance.shape, light.detail.shape
    ((32, 64, 3), (128, 256, 3))
    """

    radiance: Floats
    irradiance: Floats
    sun: Sun | None
    residual: Floats
    ambient: Floats
    glossy: Floats
    glossy_roughness: Floats
    detail: Floats | None = None

    def __repr__(self) -> str:
        mean = ", ".join(f"{c:.3g}" for c in np.mean(self.radiance, axis=(0, 1)))
        height, width = self.radiance.shape[:2]
        sun = "no sun" if self.sun is None else f"sun of confidence {self.sun.confidence:.2f}"
        return f"<Environment {height} x {width}, mean radiance ({mean}), {sun}>"

    def _figure(self) -> Figure:
        return Figure("radiance, white at its 99 % quantile", image=_exposed(self.radiance))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Surface(Shown):
    """A displaced water surface at one time.

    position: (..., 3), y = height above the mean surface. normal: (..., 3) unit, y > 0. jacobian: (...,) determinant
    of the horizontal displacement, positive where the surface does not fold over.
    """

    position: Floats
    normal: Floats
    jacobian: Floats

    def __repr__(self) -> str:
        height = self.position[..., 1]
        return f"<Surface {height.shape}, heights {np.min(height):.3g} to {np.max(height):.3g} m>"

    def _figure(self) -> Figure:
        height = np.asarray(self.position[..., 1], np.float64)
        if height.ndim != 2:
            return Figure("surface", np.arange(height.size), {"height": height.ravel()}, "point", "m")
        low, high = height.min(), height.max()
        return Figure("height, black to white", image=(height - low) / max(high - low, 1e-12))


@dataclass(frozen=True, slots=True, eq=False)
class BeamSpread(Parts):
    """Spread of light that the water has turned by small angles: of sunlight over a plane across the beam, or of that
    of bodies over the angles that they are seen at.

    scattering: by small angles [1/m], or (3,) of each channel; times the path it is an optical depth. angle_rad: (k,)
    standard deviations of Gaussians over the path. optical_depth: (t,) ascending. weight: (t, k) of the Gaussians, each
    row of sum 1, for light that has turned. kept: (3,) what of the scattering [1/m] the extinction of bodies counts as
    lost.
    """

    scattering: Floats | float
    angle_rad: Floats
    optical_depth: Floats
    weight: Floats
    kept: Floats | float = 0.0

    def unturned(self, path_m: float) -> float:
        """Return the fraction of the beam that has not turned after a path."""
        return float(np.exp(-self.scattering * path_m))

    def weights(self, path_m: Floats | float) -> Floats:
        """Return the weights (..., k) of the Gaussians after paths (...), sum 1, linear between the rows."""
        depth = np.asarray(path_m * self.scattering)
        return np.stack([np.interp(depth, self.optical_depth, column) for column in self.weight.T], axis=-1)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CausticStack(Shown):
    """Irradiance of the sun's refracted beam on horizontal planes, relative to a flat surface (mean 1).

    It multiplies the sun's direct light, not that of the sky. Between two planes the ratio is their linear mix.

    Parameters
    ----------
    ratio : ndarray
        Irradiance ratio (D, size, size, 3); column = +x, row = +z, periodic. Maps lie along the beam: a pixel is where
        its ray comes from on the mean surface, and pixel (0, 0) spans [0, tile_m/size) there from the world's origin.
    depth_m : ndarray
        Depths (D,) [m] of the planes below the mean surface, ascending.
    tile_m : float
        Length [m] after which the maps repeat.
    sun_direction : ndarray
        Unit vector (3,) towards the sun, in the water.
    soft : ndarray or None
        The ratio (D, size, size, 1) of the light that the water has turned by small angles; None: even.
    slopes : tuple of ndarray
        How waves turn the beam that falls on a ground, (1, s, s, 4) and its halves down to one pixel: sums over its
        light w, mean 1, of w, w s along x and z, and w |s|^2. A slope s is that of a ray over that below a flat
        surface, in metres across for each of depth. Empty where no ground was named.

    See Also
    --------
    uw.caustics.caustic_stack : Makes one.
    uw.datasets.of_caustics : Contrast and quantiles by depth.
    uw.plot.show : Draws up to four planes.

    Examples
    --------
    >>> sea, settings = uw.caustics.GerstnerSea(wave_count=4), uw.caustics.CausticSettings(size=16, grid=16)
    >>> uw.caustics.caustic_stack(sea, [0.0, 1.0, 0.0], [1.0, 4.0], 0.0, settings).ratio.shape
    (2, 16, 16, 3)
    """

    ratio: Floats
    depth_m: Floats
    tile_m: float
    sun_direction: Floats
    soft: Floats | None = None
    slopes: tuple[Floats, ...] = ()

    def __repr__(self) -> str:
        depth, contrast = self.depth_m, np.std(self.ratio, axis=(1, 2))[:, 1]
        return (
            f"<CausticStack {len(depth)} x {self.ratio.shape[1]} x {self.ratio.shape[2]}, {depth[0]:.3g} to "
            f"{depth[-1]:.3g} m deep, tile of {self.tile_m:g} m, contrast {contrast.min():.2f} to {contrast.max():.2f}>"
        )

    def _figure(self) -> Figure:
        shown = np.linspace(0, len(self.depth_m) - 1, min(len(self.depth_m), _PLANES_SHOWN)).astype(int)
        side_by_side = np.concatenate([self.ratio[plane] for plane in shown], axis=1)
        return Figure("irradiance ratio, white is 4, shallow to deep", image=side_by_side / _RATIO_SHOWN)


@dataclass(frozen=True, slots=True, eq=False)
class MediumTable:
    """Everything one pixel needs of the water, for one camera depth, in linear RGB.

    Distances S enter as t = S/(S + length_m) and depths d as d/(d + length_m), both uniform over [0, 1]; `up`, the y
    of the view direction, is uniform over [-1, 1].

    veil: (U, T, 3) radiance scattered into a camera ray of distance S, divided by 1 - exp(-S/length_m).
    attenuation: (D, T, 3) effective beam attenuation [1/m] of an object at depth d seen over distance S:
    transmittance = exp(-attenuation S).
    diffuse: (N, D, 3) effective attenuation [1/m] of the ambient irradiance between the camera's depth and d, on
    normals whose y is uniform over [-1, 1]: E(d)/E(camera) = exp(-diffuse (d - camera_depth_m)).
    beam: (D, 3) effective attenuation [1/m] of the sun's beam over its path p = d/(y of its direction) from the
    surface, which enters like a depth: E(p)/E(0) = exp(-beam p). Light that has turned by small angles is still in it.
    unscattered: (D, 3) the same of the part of the beam that has not turned at all.
    refractive_index: of the water relative to air.
    glow: (U, T, 3) veil that a floor of radiance 1 adds, like `veil`, while level light stays what it is; None: no
    floor. plate_ratio: (H, W, 3) equirectangular map in the world's axes, or None for 1: the light of a plate's open
    water in each direction over that of these tables, or without a plate's that of the solved light about the sun. It
    multiplies the veil.
    """

    camera_depth_m: float
    length_m: float
    veil: Floats
    attenuation: Floats
    diffuse: Floats
    beam: Floats
    unscattered: Floats
    refractive_index: float = REFRACTIVE_INDEX_SEA
    glow: Floats | None = None
    plate_ratio: Floats | None = None
