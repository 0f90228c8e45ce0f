# SPDX-License-Identifier: Apache-2.0
"""Caustics: the irradiance of the sun's refracted beam on horizontal planes, relative to that below a flat sea.

The surface is a grid of cells. Each triangle's incoming flux, Fresnel's losses included, goes to its refracted image
on the plane and is shared over the pixels there by exact coverage (`deposit`), sheet upon sheet, then blurred by the
sun's disc. Light is neither lost nor made: the mean is 1, and the map converges with the grid, folds or not. Dividing
areas (Stam 1996; Thompson et al. 2019) does neither.

A map lies on the world's grid. The maps of a stack lie along the beam: each is shifted by the beam's travel from the
surface, so that one place in all of them is one ray of the beam, and a point's light is the same mix of the same
pixels wherever along its ray the point lies. Maps on the world's grid would each be read at another part of a pixel,
which blurs filaments a pixel wide by 0.05 to 0.3 of the standard deviation, more than the mix does.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.caustics.flux.refracted_rays import Rays, facet_flux, refracted_rays
from mr360uw.caustics.flux.refraction import check_refractive_index, refract_to_water, sea_water_index
from mr360uw.caustics.flux.sun_disc import blur, footprint
from mr360uw.caustics.sea.gerstner import GerstnerSea
from mr360uw.caustics.sea.spectral import SpectralSea
from mr360uw.caustics.settings import CausticSettings, Method
from mr360uw.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.errors import ParameterError
from mr360uw.sphere import unit
from mr360uw.types import CausticStack, Surface

Array = NDArray[np.floating[Any]]
AnySea = GerstnerSea | SpectralSea

WAVELENGTHS_NM = (610.0, 550.0, 465.0)
"""Where the refractive index is taken for red, green and blue: the primaries' dominant wavelengths."""
DEEPEST_M = 11000.0
_SCROLL = ((0.37, 0.21), (-0.29, 0.33))
"""Scroll [m/s] of the two copies of `scrolling` over (x, z)."""


def caustic_map(
    sea: AnySea,
    sun_direction_in_air: ArrayLike,
    depth_m: float,
    time_s: float,
    size: int = 512,
    grid: int = 256,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    sun_half_angle_rad: float = SUN_HALF_ANGLE_RAD,
    method: Method = "exact",
    backend: str = "reference",
) -> Array:
    """Return the irradiance ratio (size, size), mean 1, on the plane depth_m below the mean surface.

    Column = +x, row = +z; pixel (0, 0) spans [0, tile_m/size) from the world's origin, not shifted along the sun.
    sun_direction_in_air: (3,) towards the sun, above the horizon. grid: cells of the surface across the tile. backend:
    "reference" (float64) or "gl". Raises `ParameterError` for arguments outside their domain.
    """
    sun = check_arguments(sun_direction_in_air, [depth_m], size, grid, refractive_index, sun_half_angle_rad)
    if backend == "gl":
        from mr360uw.caustics.gl.renderer import caustic_renderer

        renderer = caustic_renderer()
        return renderer.map(sea, sun, depth_m, time_s, size, grid, refractive_index, sun_half_angle_rad, method)
    if backend != "reference":
        raise ParameterError(f"backend - is not known (got {backend!r}) - use 'reference' or 'gl'")
    surface = sea.grid_surface(grid, 0.0 if method == "scrolling" else time_s)
    light = _SurfaceLight.of(surface, sun, sea.tile_m, refractive_index)
    ratio = light.on_plane(depth_m, size, sun_half_angle_rad, method, np.zeros(2))
    return scroll(ratio, sea, time_s) if method == "scrolling" else ratio


def caustic_stack(
    sea: AnySea,
    sun_direction_in_air: ArrayLike,
    depths_m: Sequence[float] | Array,
    time_s: float,
    settings: CausticSettings | None = None,
) -> CausticStack:
    """Return the irradiance ratio on planes `depths_m` (ascending) below the mean surface, along the beam, by the
    reference.

    `settings.planes` is not read here: `stack_depths` makes depths of a count.
    """
    s = settings or CausticSettings()
    sun = check_arguments(sun_direction_in_air, depths_m, s.size, s.grid, s.refractive_index, s.sun_half_angle_rad)
    depths = np.asarray(depths_m, np.float64)
    sun_in_water = refract_to_water(sun, s.refractive_index)
    travel = beam_slope(sun_in_water)
    surface = sea.grid_surface(s.grid, 0.0 if s.method == "scrolling" else time_s)
    indices = pass_indices(s)
    maps = np.zeros((len(depths), s.size, s.size, len(indices)))
    lights = [_SurfaceLight.of(surface, sun, sea.tile_m, index) for index in indices]

    def draw(number: int) -> None:
        plane, channel = divmod(number, len(lights))
        ratio = lights[channel].on_plane(float(depths[plane]), s.size, s.sun_half_angle_rad, s.method, travel)
        maps[plane, ..., channel] = scroll(ratio, sea, time_s) if s.method == "scrolling" else ratio

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(draw, range(len(depths) * len(lights))))  # to see their errors
    return CausticStack(np.broadcast_to(maps, (*maps.shape[:3], 3)), depths, sea.tile_m, sun_in_water)


def beam_slope(sun_in_water: Array) -> Array:
    """Return the horizontal travel (2,) over (x, z) of the beam for each metre of depth."""
    return -sun_in_water[[0, 2]] / sun_in_water[1]


def pass_indices(settings: CausticSettings) -> tuple[float, ...]:
    """Return the refractive index of each pass: one, or those of red, green and blue (Quan & Fry 1995)."""
    if settings.chromatic == 1:
        return (settings.refractive_index,)
    green = float(sea_water_index(WAVELENGTHS_NM[1]))
    return tuple(settings.refractive_index + float(sea_water_index(w)) - green for w in WAVELENGTHS_NM)


def check_arguments(
    sun_direction_in_air: ArrayLike,
    depths_m: Sequence[float] | Array,
    size: int,
    grid: int,
    refractive_index: float,
    sun_half_angle_rad: float,
) -> Array:
    """Return the unit direction towards the sun; raise `ParameterError` for what cannot be computed."""
    sun = unit(sun_direction_in_air)
    if sun.shape != (3,) or sun[1] <= 0.0:
        raise ParameterError(
            f"sun_direction_in_air - must be one direction above the horizon (got {sun.tolist()}) - "
            "there are no caustics without a sun"
        )
    depths = np.asarray(depths_m, np.float64)
    if depths.ndim != 1 or not len(depths) or not np.all((depths >= 0.0) & (depths <= DEEPEST_M)):
        raise ParameterError(f"depth_m - must lie in [0, {DEEPEST_M:.0f}] (got {depths.tolist()!r:.80}) - give metres")
    if np.any(np.diff(depths) <= 0.0):
        raise ParameterError(f"depths_m - must ascend (got {depths.tolist()!r:.80}) - sort them")
    if not (1 <= size <= 16384 and 2 <= grid <= 8192):
        raise ParameterError(f"size, grid - outside [1, 16384], [2, 8192] (got {size}, {grid}) - choose fewer pixels")
    check_refractive_index(refractive_index)
    if not 0.0 <= sun_half_angle_rad <= 0.5:
        raise ParameterError(f"sun_half_angle_rad - outside [0, 0.5] (got {sun_half_angle_rad}) - the sun has 0.00465")
    return sun


def cell_flux(surface: Surface, rays: Rays, sun: Array, tile_m: float) -> Array:
    """Return the flux (N, N, 2) [m^2] into each cell's two triangles, per unit irradiance across the beam."""
    position = wrapped(surface.position, tile_m, columns=(0, 2))
    a, b, c, d = position[:-1, :-1], position[:-1, 1:], position[1:, 1:], position[1:, :-1]
    t = np.pad(rays.transmittance, ((0, 1), (0, 1)), mode="wrap")
    ta, tb, tc, td = t[:-1, :-1], t[:-1, 1:], t[1:, 1:], t[1:, :-1]
    # the grid's x and z axes span a downward normal: corners in reverse order face up
    return np.stack(
        [facet_flux(a, c, b, (ta + tb + tc) / 3.0, sun), facet_flux(a, d, c, (ta + tc + td) / 3.0, sun)], axis=-1
    )


def wrapped(values: Array, period: float, columns: tuple[int, int]) -> Array:
    """Return values (N, N, k) of a periodic grid with one more row and column, one period on in `columns` (x, z)."""
    out = np.pad(values, ((0, 1), (0, 1), (0, 0)), mode="wrap")
    out[:, -1, columns[0]] += period
    out[-1, :, columns[1]] += period
    return out


@dataclass(frozen=True, slots=True)
class _SurfaceLight:
    """The rays of one sun below one surface, and the flux of its cells."""

    rays: Rays
    flux: Array
    sun: Array
    tile_m: float
    refractive_index: float

    @classmethod
    def of(cls, surface: Surface, sun: Array, tile_m: float, refractive_index: float) -> _SurfaceLight:
        rays = refracted_rays(surface, sun, refractive_index)
        return cls(rays, cell_flux(surface, rays, sun, tile_m), sun, tile_m, refractive_index)

    def on_plane(self, depth_m: float, size: int, half_angle_rad: float, method: Method, travel: Array) -> Array:
        """Return the ratio (size, size) on a plane. travel: (2,) what the map is shifted back by for each metre."""
        from mr360uw.caustics.flux import deposit

        methods = {
            "exact": deposit.deposit_exact,
            "ratio": deposit.deposit_ratio,
            "fan": deposit.deposit_fan,
            "jacobian": deposit.deposit_jacobian,
            "scrolling": deposit.deposit_exact,
        }
        if method not in methods:
            raise ParameterError(f"method - is not known (got {method!r}) - use one of {', '.join(methods)}")
        hit = wrapped(self.rays.hit(depth_m) - travel * depth_m, self.tile_m, columns=(0, 1)) * (size / self.tile_m)
        ratio = methods[method](hit, self.flux, size) * (size * size / self.flux.sum())
        return blur(ratio, footprint(self.sun, self.refractive_index, half_angle_rad, depth_m), self.tile_m)


def scroll_offsets(sea: AnySea, time_s: float) -> Array:
    """Return how far (2, 2) over (x, z), in tiles, the two copies of method "scrolling" have moved."""
    rate = np.array(_SCROLL) / sea.tile_m
    if sea.loop_s is not None:
        rate = np.round(rate * sea.loop_s) / sea.loop_s
    return rate * time_s


def scroll(ratio: Array, sea: AnySea, time_s: float) -> Array:
    """Return the darker of two scrolled copies of a map, the second one turned by a quarter, with mean 1."""
    size = ratio.shape[0]
    first, second = np.round(scroll_offsets(sea, time_s) * size).astype(np.int64)
    darker = np.minimum(np.roll(ratio, (first[1], first[0]), (0, 1)), np.roll(ratio.T, (second[1], second[0]), (0, 1)))
    return darker / darker.mean()
