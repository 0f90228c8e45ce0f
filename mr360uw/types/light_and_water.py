# SPDX-License-Identifier: Apache-2.0
"""What lights a scene (sun, lamps, environment), and what the sea and the water do to light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.cache import Parts
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.plot import Figure, Shown
from mr360uw.types.frames import Floats

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
