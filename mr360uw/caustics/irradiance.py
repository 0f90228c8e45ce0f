# SPDX-License-Identifier: Apache-2.0
"""Caustics: the irradiance of the sun's refracted beam on horizontal planes, relative to that below a flat sea.

The surface is a grid of cells. Each triangle's incoming flux, Fresnel's losses included, goes to its refracted image
on the plane and is shared over the pixels there by exact coverage (`deposit`), sheet upon sheet, then blurred by the
sun's disc. Light is neither lost nor made: the mean is 1, and the map converges with the grid, folds or not. Dividing
areas (Stam 1996; Thompson et al. 2019) does neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.caustics.rays import Rays, facet_flux, refracted_rays
from mr360uw.caustics.refraction import check_refractive_index, refract_to_water, sea_water_index
from mr360uw.caustics.settings import CausticSettings, Method
from mr360uw.caustics.spectral import SpectralSea
from mr360uw.caustics.sun_disc import blur, footprint
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
        from mr360uw.caustics.gl import caustic_renderer

        renderer = caustic_renderer()
        return renderer.map(sea, sun, depth_m, time_s, size, grid, refractive_index, sun_half_angle_rad, method)
    if backend != "reference":
        raise ParameterError(f"backend - is not known (got {backend!r}) - use 'reference' or 'gl'")
    surface = sea.grid_surface(grid, 0.0 if method == "scrolling" else time_s)
    ratio = blur(
        _ratio(surface, sun, sea.tile_m, depth_m, size, refractive_index, method),
        footprint(sun, refractive_index, sun_half_angle_rad, depth_m),
        sea.tile_m,
    )
    return scroll(ratio, sea, time_s) if method == "scrolling" else ratio


def caustic_stack(
    sea: AnySea,
    sun_direction_in_air: ArrayLike,
    depths_m: Sequence[float] | Array,
    time_s: float,
    settings: CausticSettings | None = None,
) -> CausticStack:
    """Return the irradiance ratio on planes `depths_m` (ascending) below the mean surface, by the reference.

    `settings.planes` is not read here: `stack_depths` makes depths of a count.
    """
    s = settings or CausticSettings()
    sun = check_arguments(sun_direction_in_air, depths_m, s.size, s.grid, s.refractive_index, s.sun_half_angle_rad)
    depths = np.asarray(depths_m, np.float64)
    indices = pass_indices(s)
    surface = sea.grid_surface(s.grid, 0.0 if s.method == "scrolling" else time_s)
    stack = np.zeros((len(depths), s.size, s.size, 3))
    for i, depth in enumerate(depths):
        for channel, index in enumerate(indices):
            ratio = _ratio(surface, sun, sea.tile_m, float(depth), s.size, index, s.method)
            ratio = blur(ratio, footprint(sun, index, s.sun_half_angle_rad, float(depth)), sea.tile_m)
            ratio = scroll(ratio, sea, time_s) if s.method == "scrolling" else ratio
            stack[i, :, :, channel if len(indices) == 3 else slice(None)] = (
                ratio if len(indices) == 3 else ratio[..., None]
            )
    return CausticStack(stack, depths, sea.tile_m, refract_to_water(sun, s.refractive_index))


def stack_depths(near_m: float, far_m: float, count: int) -> Array:
    """Return `count` ascending depths from near_m to far_m, in geometric progression."""
    if not (0.0 < near_m <= far_m < math.inf) or count < 1:
        raise ParameterError(
            f"stack - needs 0 < near <= far and a plane (got {near_m}, {far_m}, {count}) - correct the depths"
        )
    if count == 1 or near_m == far_m:
        return np.array([math.sqrt(near_m * far_m)])
    return np.geomspace(near_m, far_m, count)


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


def _ratio(
    surface: Surface, sun: Array, tile_m: float, depth_m: float, size: int, refractive_index: float, method: Method
) -> Array:
    from mr360uw.caustics import deposit

    methods = {
        "exact": deposit.deposit_exact,
        "ratio": deposit.deposit_ratio,
        "fan": deposit.deposit_fan,
        "jacobian": deposit.deposit_jacobian,
        "scrolling": deposit.deposit_exact,
    }
    if method not in methods:
        raise ParameterError(f"method - is not known (got {method!r}) - use one of {', '.join(methods)}")
    rays = refracted_rays(surface, sun, refractive_index)
    flux = cell_flux(surface, rays, sun, tile_m)
    hit = wrapped(rays.hit(depth_m), tile_m, columns=(0, 1)) * (size / tile_m)
    return methods[method](hit, flux, size) * (size * size / flux.sum())


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
