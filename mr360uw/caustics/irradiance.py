# SPDX-License-Identifier: Apache-2.0
"""Caustics: irradiance of the sun's refracted beam on horizontal planes, relative to that below a flat sea.

The surface is a grid of cells of two triangles. The flux into each triangle, Fresnel losses included, goes to its
refracted image on the plane and is shared over the pixels there by exact coverage (`deposit`). Overlapping images add
up, and the sum is blurred by the sun's disc and by waves too short for the grid (`sun_disc`). Flux is conserved, so
the mean is 1, and the map converges as the grid gets finer, beyond folds too. Dividing areas instead (Stam 1996;
Thompson et al. 2019; `published`) does neither.

A single map lies on the world's grid. The maps of a stack lie along the beam: each is shifted by the beam's horizontal
travel from the surface, so that one place in all maps is one ray. All maps are then read at the same part of a pixel.
On the world's grid they would be read at different parts, which blurs filaments one pixel wide by 0.05 to 0.3 of the
standard deviation, more than the interpolation between planes does.

A ray that enters at P with the refracted direction of travel t meets the plane at depth d at P.xz + slope (P.y + d),
slope = t.xz/-t.y. It is stored as `origin` = P.xz + slope P.y, where it crosses the mean surface, and `slope`: at any
depth d the hit is origin + slope d. A facet of area vector A takes in the flux T (L.A), L towards the sun in air and T
Fresnel's transmittance; its refracted image on the plane carries that flux.

Points of the surface whose ray to the sun meets the surface again are in shadow. From every point of the grid the ray
is followed in steps of a cell until it is above the highest wave. The surface there is that of the particle that has
moved below the ray: its place at rest is found from the last step's. A triangle takes the lit fraction of its corners.
Where no triangle is turned away from the sun, none is in shadow either. A shadowing function (Smith 1967) would give
the lit fraction of a random surface, but not where it is.

Closed form: on a periodic sea all light that comes in meets the surface once, so the lit triangles have together the
area tile^2 L_y across the beam. Without shadows it is more: the light of the shadowed triangles is counted twice.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.caustic_lookup import mip_levels
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.optics import check_refractive_index, refract_clamped

# Refraction at the surface is part of the calls of `mr360uw.caustics`; its formulas stand in `mr360uw.base.optics`
from mr360uw.base.optics import fresnel_reflectance as fresnel_reflectance
from mr360uw.base.optics import fresnel_transmittance as fresnel_transmittance
from mr360uw.base.optics import refract_to_air as refract_to_air
from mr360uw.base.optics import refract_to_water as refract_to_water
from mr360uw.base.optics import sea_water_index as sea_water_index
from mr360uw.base.parameters import checked, numbers, whole
from mr360uw.base.sphere import unit
from mr360uw.caustics.settings import DIVIDED_AREAS, CausticSettings, Method, Sea, grid_of
from mr360uw.caustics.sun_disc import (
    blur,
    detail_footprint,
    footprint,
    gaussian_transform,
    gaussians,
    is_soft,
    soft_light,
)
from mr360uw.errors import ParameterError
from mr360uw.jit import exact, exact_making, inlined
from mr360uw.types import BeamSpread, CausticStack, Floats, Surface

Floats32 = NDArray[np.float32]
_WAVELENGTHS_NM = (610.0, 550.0, 465.0)
"""Wavelengths [nm] at which the refractive index of red, green and blue is taken: the primaries' dominant ones."""
_DEEPEST_M = 11000.0
"""Greatest depth [m] of a plane: the deepest ocean."""


@checked
def caustic_map(
    sea: Sea,
    sun_direction_in_air: ArrayLike,
    depth_m: float,
    time_s: float,
    size: int = 512,
    grid: int = 256,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    sun_half_angle_rad: float = SUN_HALF_ANGLE_RAD,
    method: Method = "exact",
) -> Floats:
    """Return the irradiance of the sun's refracted beam on a level plane, over that below a flat sea.

    Where it is 3, the plane gets three times the sunlight that a flat sea lets through; light of the sky is not in it.
    For bodies that reach over several depths take `caustic_stack`.

    Parameters
    ----------
    sea : GerstnerSea or SpectralSea
        The surface.
    sun_direction_in_air : array_like
        Direction (3,) towards the sun, above the horizon.
    depth_m : float
        Depth [m] of the plane below the mean surface, 0 to 11000.
    time_s : float
        Time [s] of the sea.
    size : int
        Pixels across the tile, 1 to 16384.
    grid : int
        Cells of the surface across the tile, 2 to 8192.
    refractive_index : float
        Index of the water relative to air, above 1 and up to 4.
    sun_half_angle_rad : float
        Angular radius [rad] of the sun's disc in air, 0 to 0.5.
    method : {"exact", "ratio", "fan", "jacobian", "scrolling"}
        Exact coverage conserves energy; the others are published methods, for comparison.

    Returns
    -------
    ndarray
        Ratio (size, size), float64, mean 1. Column = +x, row = +z; pixel (0, 0) spans [0, tile_m/size) from the world's
        origin, not shifted along the sun.

    Raises
    ------
    ParameterError
        If an argument is outside its domain.

    See Also
    --------
    uw.caustics.caustic_stack : Planes at several depths, along the beam.
    uw.caustics.export_tiles : Sequences of pictures that loop.
    uw.caustics.GerstnerSea : Makes a sea.

    Notes
    -----
    The flux of each cell of the surface goes to its refracted image and is shared over the pixels there by exact
    coverage, so that it is conserved (after Stam 1996, who divides areas instead).

    Examples
    --------
    >>> sea = uw.caustics.GerstnerSea(wind_speed=4.0)
    >>> ratio = uw.caustics.caustic_map(sea, [0.3, 0.9, -0.3], depth_m=3.0, time_s=0.5, size=32, grid=32)
    >>> ratio.shape, round(ratio.mean(), 6)
    ((32, 32), np.float64(1.0))
    """
    sun = check_arguments(sun_direction_in_air, [depth_m], size, refractive_index, sun_half_angle_rad)
    surface = sea.grid_surface(whole("grid", grid, 2, 8192), 0.0 if method == "scrolling" else time_s)
    light = RefractedBeam(sea, surface, sun, refractive_index)
    ratio = light.on_plane(depth_m, size, sun_half_angle_rad, method, np.zeros(2))
    return _scrolled(ratio, sea, time_s) if method == "scrolling" else ratio


@checked
def caustic_stack(
    sea: Sea,
    sun_direction_in_air: ArrayLike,
    depths_m: Sequence[float] | Floats,
    time_s: float,
    settings: CausticSettings | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    spread: BeamSpread | None = None,
    ground_m: float | None = None,
) -> CausticStack:
    """Return the irradiance ratio on several planes, along the beam.

    Maps lie along the refracted beam, so that a mix of two of them moves the pattern over a body as the light does.

    Parameters
    ----------
    sea : GerstnerSea or SpectralSea
        The surface.
    sun_direction_in_air : array_like
        Direction (3,) towards the sun, above the horizon.
    depths_m : array_like
        Depths (D,) [m] of the planes below the mean surface, ascending; `stack_depths` makes good ones.
    time_s : float
        Time [s] of the sea.
    settings : CausticSettings, optional
        Size of the maps, method and the sun's disc; `planes` is not read here.
    refractive_index : float
        Index of the water at 550 nm relative to air, above 1 and up to 4.
    spread : BeamSpread, optional
        Spread of the light that the water turns by small angles; None: without its pattern.
    ground_m : float, optional
        Depth [m] of the ground on which bodies cast shadows, whose `slopes` are then found.

    Returns
    -------
    CausticStack
        Maps (D, size, size, 3), float64, mean 1.

    Raises
    ------
    ParameterError
        If an argument is outside its domain.

    See Also
    --------
    uw.caustics.stack_depths : Depths for the planes.
    uw.caustics.caustic_map : A single plane, on the world's grid.
    uw.datasets.of_caustics : Statistics of the maps.

    Examples
    --------
    >>> sea, settings = uw.caustics.GerstnerSea(wave_count=4), uw.caustics.CausticSettings(size=16, grid=16)
    >>> stack = uw.caustics.caustic_stack(sea, [0.0, 1.0, 0.0], [1.0, 4.0], 0.0, settings)
    >>> stack.ratio.shape, stack.depth_m.tolist()
    ((2, 16, 16, 3), [1.0, 4.0])
    """
    s = settings or CausticSettings()
    sun = check_arguments(sun_direction_in_air, depths_m, s.size, refractive_index, s.sun_half_angle_rad)
    depths = np.asarray(depths_m, np.float64)
    grid = grid_of(s, sea, float(depths[0]))
    sun_in_water = refract_to_water(sun, refractive_index)
    travel = -sun_in_water[[0, 2]] / sun_in_water[1]
    surface = sea.grid_surface(grid, 0.0 if s.method == "scrolling" else time_s)
    indices = pass_indices(s.chromatic, refractive_index)
    maps = np.zeros((len(depths), s.size, s.size, len(indices)))
    soft = np.zeros((len(depths), s.size, s.size, 1)) if is_soft(spread, depths[-1], sun_in_water) else None
    lights = [RefractedBeam(sea, surface, sun, index) for index in indices]

    def draw(number: int) -> None:
        plane, channel = divmod(number, len(lights))
        ratio = lights[channel].on_plane(float(depths[plane]), s.size, s.sun_half_angle_rad, s.method, travel)
        maps[plane, ..., channel] = _scrolled(ratio, sea, time_s) if s.method == "scrolling" else ratio
        if soft is not None and spread is not None and channel == len(lights) // 2:
            blurs = gaussians(spread, float(depths[plane]), sun_in_water, sea.tile_m / s.size)
            soft[plane, ..., 0] = soft_light(maps[plane, ..., channel], blurs, sea.tile_m)

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(draw, range(len(depths) * len(lights))))  # to see their errors
    ratio = np.broadcast_to(maps, (*maps.shape[:3], 3))
    slopes: tuple[Floats, ...] = ()
    if ground_m is not None:
        light = lights[len(lights) // 2]
        rays = wrapped(np.concatenate([light.origin, light.slope - travel], axis=-1), sea.tile_m, columns=(0, 1))
        corners, flux = np.moveaxis(rays, -1, 0).copy(), light.flux.sum(axis=-1)
        slopes = slopes_of(corners, flux, ground_m, sea, sun, s, refractive_index)
    return CausticStack(ratio, depths, sea.tile_m, sun_in_water, soft, slopes)


# --- Slopes of the beam on the ground -------------------------------------------------------------------------------

# Light that waves have bent casts bent shadows: on the ground below a body it arrives along a slope of its own, which
# differs from place to place. A place gets light from one cell of the surface, or behind a fold from three or more.
# Its mean slope moves the edge of a shadow there, in straight pieces along the cells of the caustics, and its spread
# about the mean softens it, as a wider sun would. Both follow from sums over the light w of rays of slope s that fall
# into a pixel, of w, w s and w |s|^2 (`caustic_lookup.mean_slopes`). Sums add up over pixels: those over a footprint
# are those of the level whose pixels are as wide. Against photons that a ball stops 2 m above the ground, in 3 m/s of
# wind, light within 0.2 m of the edge is off by 0.06, where that of parallel light is off by 0.26.


_SLOPE_M = 0.035
"""Width [m] of a pixel of the maps of slopes, at most: twice as wide, light at edges is off by 0.07 instead of 0.06."""
_SPACING, _MOST_POINTS = 2.0, 64
"""Greatest distance [pixel] of the points that stand for a cell's light in these maps, and most of them across it."""


def slopes_of(
    corners: Floats, flux: Floats, depth_m: float, sea: Sea, sun: Floats, settings: CausticSettings,
    refractive_index: float,
) -> tuple[Floats, ...]:  # fmt: skip
    """Return `CausticStack.slopes` of cells on a plane.

    corners: (4, N + 1, N + 1), where rays cross the mean surface x, z [m], and their slopes x, z over that of the beam.
    flux: (N, N) of the cells, of any sum.
    """
    size = min(settings.size, 1 << math.ceil(math.log2(max(sea.tile_m / _SLOPE_M, 1.0))))
    sums, short = np.zeros((size, size, 4), np.float32), _short_waves(tuple(sun.tolist()), refractive_index, sea)
    cells = corners.astype(np.float32, copy=False), flux.astype(np.float32, copy=False)
    _sum_slopes(*cells, depth_m, size / sea.tile_m, size * size / float(flux.sum()), short, sums)
    return tuple(mip_levels(sums[None]))


@shared(keep=8)
def _short_waves(sun: tuple[float, ...], refractive_index: float, sea: Sea) -> float:
    """Return the variance of the beam's slopes that waves too short for the cells make."""
    return float(np.sum(detail_footprint(np.array(sun), refractive_index, sea.blur_slope, 1.0) ** 2))


@inlined
def _patch(of: Any, j: Any, i: Any) -> Any:
    """Return the coefficients of 1, s, t and s t between the corners of a cell (j, i)."""
    a = of[j, i]
    b, d = of[j, i + 1] - a, of[j + 1, i] - a
    return a, b, d, of[j + 1, i + 1] - a - b - d


@inlined
def _add_to_pixel(flat: Any, pixel: Any, light: Any, u: Any, v: Any, square: Any) -> None:
    """Add a light of slope (u, v) to the four sums of a pixel."""
    first = np.uint64(4 * pixel)
    flat[first] += light
    flat[first + np.uint64(1)] += light * u
    flat[first + np.uint64(2)] += light * v
    flat[first + np.uint64(3)] += light * square


@exact
def _sum_slopes(
    corners: Floats32,
    flux: Floats32,
    depth_m: float,
    scale: float,
    gain: float,
    short: float,
    sums: Floats32,
) -> None:
    """Add the light of cells on a plane to sums (size, size, 4) over pixels: of w, w s (2) and w (|s|^2 + short), as
    points shared bilinearly by four pixels.

    corners, flux: of `slopes_of`. scale: pixels for a metre. gain: factor on the flux.
    """
    cells, size = len(flux), len(sums)
    flat, last = sums.reshape(-1), size - 1  # a power of two less one, whose bits are those of places in the tile
    one, half, closer = np.float32(1.0), np.float32(0.5), np.float32(1.0 / _SPACING)
    depth, pixels, more = np.float32(depth_m), np.float32(scale), np.float32(short)
    for j in range(cells):
        for i in range(cells):
            # Slopes and places [pixel] between the corners of a cell
            (ua, ub, ud, ue), (va, vb, vd, ve) = _patch(corners[2], j, i), _patch(corners[3], j, i)
            (ax, bx, dx, ex), (az, bz, dz, ez) = _patch(corners[0], j, i), _patch(corners[1], j, i)
            ax, az = (ax + ua * depth) * pixels - half, (az + va * depth) * pixels - half
            bx, bz, dx, dz = bx + ub * depth, bz + vb * depth, dx + ud * depth, dz + vd * depth
            bx, bz, dx, dz = bx * pixels, bz * pixels, dx * pixels, dz * pixels
            ex, ez = (ex + ue * depth) * pixels, (ez + ve * depth) * pixels
            # As many points across as its longest side needs
            opposite = max((bx + ex) ** 2 + (bz + ez) ** 2, (dx + ex) ** 2 + (dz + ez) ** 2)
            side = max(bx * bx + bz * bz, dx * dx + dz * dz, opposite)
            across = min(max(int(np.ceil(np.sqrt(side) * closer)), 1), _MOST_POINTS)
            step = one / np.float32(across)
            light = flux[j, i] * np.float32(gain) * step * step
            t = half * step
            for _ in range(across):
                x, z, run_x, run_z = ax + t * dx, az + t * dz, bx + t * ex, bz + t * ez
                u, v, run_u, run_v = ua + t * ud, va + t * vd, ub + t * ue, vb + t * ve
                s = half * step
                for _ in range(across):
                    at_x, at_z, to_u, to_v = x + s * run_x, z + s * run_z, u + s * run_u, v + s * run_v
                    left, top = np.int32(np.floor(at_x)), np.int32(np.floor(at_z))
                    i0, j0, i1, j1 = left & last, top & last, (left + 1) & last, (top + 1) & last
                    right, low = at_x - np.float32(left), (at_z - np.float32(top)) * light
                    high, square = light - low, to_u * to_u + to_v * to_v + more
                    _add_to_pixel(flat, j0 * size + i0, high - high * right, to_u, to_v, square)
                    _add_to_pixel(flat, j0 * size + i1, high * right, to_u, to_v, square)
                    _add_to_pixel(flat, j1 * size + i0, low - low * right, to_u, to_v, square)
                    _add_to_pixel(flat, j1 * size + i1, low * right, to_u, to_v, square)
                    s += step
                t += step


@functools.cache
def pass_indices(chromatic: Literal[1, 3], refractive_index: float) -> tuple[float, ...]:
    """Return the refractive index of each pass: that at 550 nm, or those of red, green and blue.

    The index less 1 varies over wavelength as sea water's does (Quan & Fry 1995 at 20 degC and 35 psu).
    """
    if chromatic == 1:
        return (refractive_index,)
    over_air = sea_water_index(_WAVELENGTHS_NM) - 1.0
    return tuple((1.0 + (refractive_index - 1.0) * over_air / over_air[1]).tolist())


def check_arguments(
    sun_direction_in_air: ArrayLike,
    depths_m: Sequence[float] | Floats,
    size: int,
    refractive_index: float,
    sun_half_angle_rad: float,
) -> Floats:
    """Return the unit direction towards the sun; raise `ParameterError` for what cannot be computed."""
    sun = unit(sun_direction_in_air)
    if sun.shape != (3,) or sun[1] <= 0.0:
        raise ParameterError(
            f"sun_direction_in_air - must be one direction above the horizon (got {sun.tolist()}) - "
            "there are no caustics without a sun"
        )
    depths = numbers("depth_m", depths_m).astype(np.float64)
    if depths.ndim != 1 or not len(depths) or not np.all((depths >= 0.0) & (depths <= _DEEPEST_M)):
        raise ParameterError(f"depth_m - must lie in [0, {_DEEPEST_M:.0f}] (got {depths.tolist()!r:.80}) - give metres")
    if np.any(np.diff(depths) <= 0.0):
        raise ParameterError(f"depths_m - must ascend (got {depths.tolist()!r:.80}) - sort them")
    whole("size", size, 1, 16384)
    check_refractive_index(refractive_index)
    if not 0.0 <= sun_half_angle_rad <= 0.5:
        raise ParameterError(f"sun_half_angle_rad - outside [0, 0.5] (got {sun_half_angle_rad}) - the sun has 0.00465")
    return sun


def cell_flux(surface: Surface, transmittance: Floats, sun: Floats, tile_m: float) -> Floats:
    """Return the flux (N, N, 2) [m^2] into each cell's two triangles, per unit irradiance across the beam.

    transmittance: (N, N) of the surface at its points.
    Triangles in the shadow of other waves get none; where none is turned away from the sun, none is in shadow.
    """
    position = wrapped(surface.position, tile_m, columns=(0, 2))
    a, b, c, d = position[:-1, :-1], position[:-1, 1:], position[1:, 1:], position[1:, :-1]
    t = np.pad(transmittance, ((0, 1), (0, 1)), mode="wrap")
    ta, tb, tc, td = t[:-1, :-1], t[:-1, 1:], t[1:, 1:], t[1:, :-1]
    # the grid's x and z axes span a downward normal: corners in reverse order face up
    flux = np.stack(
        [_facet_flux(a, c, b, (ta + tb + tc) / 3.0, sun), _facet_flux(a, d, c, (ta + tc + td) / 3.0, sun)], axis=-1
    )
    if flux.min() > 0.0:
        return flux
    lit = np.pad(lit_corners(surface, sun, tile_m), ((0, 1), (0, 1)), mode="wrap")
    la, lb, lc, ld = lit[:-1, :-1], lit[:-1, 1:], lit[1:, 1:], lit[1:, :-1]
    return flux * np.stack([la + lb + lc, la + lc + ld], axis=-1) / 3.0


def wrapped(values: Floats, period: float, columns: tuple[int, int]) -> Floats:
    """Return values (N, N, k) of a periodic grid with one more row and column, one period on in `columns` (x, z)."""
    out = np.pad(values, ((0, 1), (0, 1), (0, 0)), mode="wrap")
    out[:, -1, columns[0]] += period
    out[-1, :, columns[1]] += period
    return out


class RefractedBeam:
    """Light of one sun (3,) in air below a surface of the whole tile, (N, N): origin and slope (N, N, 2) of its
    `refracted_rays`, and the flux (N, N, 2) of its cells.
    """

    def __init__(self, sea: Sea, surface: Surface, sun: Floats, refractive_index: float) -> None:
        self.origin, self.slope, transmittance = refracted_rays(surface, sun, refractive_index)
        self.flux = cell_flux(surface, transmittance, sun, sea.tile_m)
        self.sun, self.refractive_index = sun, refractive_index
        self.tile_m, self.blur_slope = sea.tile_m, sea.blur_slope

    def on_plane(self, depth_m: float, size: int, half_angle_rad: float, method: Method, travel: Floats) -> Floats:
        """Return the ratio (size, size) on a plane. travel: (2,) shift of the map [m] per metre of depth, taken off."""
        deposit = _deposit_of(method)
        on_plane = self.origin + self.slope * depth_m - travel * depth_m
        hit = wrapped(on_plane, self.tile_m, columns=(0, 1)) * (size / self.tile_m)
        ratio = deposit(hit, self.flux, size) * (size * size / self.flux.sum())
        detail = detail_footprint(self.sun, self.refractive_index, self.blur_slope, depth_m)
        disc = footprint(self.sun, self.refractive_index, half_angle_rad, depth_m)
        return blur(ratio, disc, self.tile_m, gaussian_transform(detail, size, self.tile_m))


def _scrolled(ratio: Floats, sea: Sea, time_s: float) -> Floats:
    """Return the map at a time of the method that scrolls it."""
    from mr360uw.published import scroll

    return scroll(ratio, sea.tile_m, sea.loop_s, time_s)


def _deposit_of(method: Method) -> Callable[[Floats, Floats, int], Floats]:
    """Return the function of (hit, flux, size) that makes a method's map; compiled kernels load at first use."""
    if method in DIVIDED_AREAS:
        from mr360uw.published import DEPOSITS

        return DEPOSITS[method]
    return deposit_exact


_IN_SHADOW = 1e-6
"""Lit fraction of a point in shadow: a coarse grid that a low sun does not see at all gets its map without shadows."""


def lit_corners(surface: Surface, sun: Floats, tile_m: float) -> Floats:
    """Return 1 for each point (N, N) of a grid surface that the sun sees, else `_IN_SHADOW`. sun: unit, upwards."""
    size = len(surface.position)
    cell = tile_m / size
    at = np.arange(size) * cell
    fields = np.stack(
        [surface.position[..., 0] - at, surface.position[..., 2] - at[:, None], surface.position[..., 1]], axis=-1
    )
    steps = shadow_steps(float(np.ptp(surface.position[..., 1])), sun, tile_m, size)
    if steps == 0:
        return np.ones((size, size))
    along = sun[[0, 2, 1]] / math.hypot(float(sun[0]), float(sun[2]))
    return _lit(fields / cell, float(along[0]), float(along[1]), float(along[2]), steps)


def shadow_steps(range_m: float, sun: Floats, tile_m: float, size: int) -> int:
    """Return the cells that the longest shadow reaches, at most those of a tile. range_m: of the surface's heights."""
    flat = math.hypot(float(sun[0]), float(sun[2]))
    reach = range_m * flat / float(sun[1]) * size / tile_m
    return min(math.ceil(reach), size) if reach > 1.0 else 0


@exact
def _read(fields: Floats, channel: int, x: float, z: float) -> float:
    n = fields.shape[0]
    i, j = math.floor(x), math.floor(z)
    fx, fz = x - i, z - j
    i0, j0 = int(i) % n, int(j) % n
    i1, j1 = (i0 + 1) % n, (j0 + 1) % n
    above = fields[j0, i0, channel] * (1.0 - fx) + fields[j0, i1, channel] * fx
    below = fields[j1, i0, channel] * (1.0 - fx) + fields[j1, i1, channel] * fx
    return float(above * (1.0 - fz) + below * fz)


@exact_making
def _lit(fields: Floats, along_x: float, along_z: float, rise: float, steps: int) -> Floats:
    """Return the lit points. fields: (N, N, 3) shift x, shift z, height in cells. along: towards the sun. rise: tan."""
    n = fields.shape[0]
    lit = np.ones((n, n))
    highest = fields[..., 2].max()
    for j in range(n):
        for i in range(n):
            x, z, height = i + fields[j, i, 0], j + fields[j, i, 1], fields[j, i, 2]
            rest_x, rest_z = float(i), float(j)
            for _ in range(steps):
                x, z, height = x + along_x, z + along_z, height + rise
                if height >= highest:
                    break
                guess_x, guess_z = rest_x + along_x, rest_z + along_z
                rest_x = x - _read(fields, 0, guess_x, guess_z)
                rest_z = z - _read(fields, 1, guess_x, guess_z)
                if _read(fields, 2, rest_x, rest_z) > height:
                    lit[j, i] = _IN_SHADOW
                    break
    return lit


STEEPEST_RAY = 0.05
"""Least downward component of a refracted ray's direction (3 degrees below the horizon); it keeps slopes finite.

Only facets tilted by more than 39 degrees can reach it. Twice as large, their light lands half as far.
"""


def ray_slope(normal: Floats, sun_in_air: Floats, refractive_index: float) -> Floats:
    """Return the horizontal travel (..., 2) of refracted sunlight for each metre of depth."""
    t = refract_clamped(-sun_in_air, normal, 1.0 / refractive_index)
    return t[..., [0, 2]] / np.maximum(-t[..., 1:2], STEEPEST_RAY)


def refracted_rays(surface: Surface, sun_in_air: Floats, refractive_index: float) -> tuple[Floats, Floats, Floats]:
    """Return the rays that enter at each point of a surface.

    Where they cross the mean surface (..., 2) over (x, z), their slope (..., 2) in metres per metre of depth, and the
    fraction (...,) of the sun's flux that is let through, 0 where the surface is turned away from it.
    """
    slope = ray_slope(surface.normal, sun_in_air, refractive_index)
    origin = surface.position[..., [0, 2]] + slope * surface.position[..., 1:2]
    return origin, slope, fresnel_transmittance(surface.normal @ sun_in_air, refractive_index)


def _facet_flux(a: Floats, b: Floats, c: Floats, transmittance: Floats, sun_in_air: Floats) -> Floats:
    """Return the flux (...,) into the water through triangles (..., 3), per unit irradiance across the beam.

    transmittance: of the triangle. The corners run so that (b - a) x (c - a) points up; facets turned away get nothing.
    """
    return 0.5 * transmittance * np.maximum(np.cross(b - a, c - a) @ sun_in_air, 0.0)


# --- Flux of cells, by exact coverage -------------------------------------------------------------------------------

# Deposits the flux of refracted surface cells into a periodic map by exact pixel coverage.
#
# `hit`: (N + 1, N + 1, 2) where the grid's rays meet the plane, in pixels of the map, the last row and column one
# period on. `flux`: (N, N, 2) flux of each cell's two triangles (a, b, c) and (a, c, d), a = (i, j), b = (i + 1, j), c
# = (i + 1, j + 1), d = (i, j + 1). Maps are (size, size), row = z, flux per pixel. Compiled; float64.
#
# Each triangle has an intensity, flux over signed area [1/pixel^2]. Intensity times signed coverage is the flux in a
# pixel, for folded triangles too. It is accumulated along edges. In one row of pixels, a triangle's covered area is the
# area right of its edges that run down less the area right of those that run up. Each edge stores the *change* of that
# area from pixel to pixel where it crosses the row, times the intensity. A running sum along the row then gives the
# flux. The work grows with the length of the edges, not with the area of the triangles, and two triangles share an
# edge. Font rasterisers work the same way; `coverage` gives the same result pixel by pixel. In a periodic row an edge
# in the n-th tile lies right of the row's beginning n times, which `start` accounts for.


_UPRIGHT = 1e-150
"""Width [pixel] of an edge up to which it is upright: where it crosses a pixel's side its slope may overflow."""


@exact
def add_edge(change: Floats, start: Floats, ax: float, ay: float, bx: float, by: float, light: float) -> None:
    """Add the intensity `light` [1/pixel^2] right of the edge from a to b [pixel], positive where it runs down (+y).

    change: (size, size + 1) difference of each pixel to the one left of it; the last column belongs to the next tile
    and is not summed. start: (size,) value of each row before its first pixel. Both are changed in place.
    """
    if light == 0.0 or ay == by:
        return
    size = start.shape[0]
    if ay > by:
        ax, ay, bx, by, light = bx, by, ax, ay, -light
    run, low, high = (bx - ax) / (by - ay), min(ax, bx), max(ax, bx)
    bottom = np.floor(ay)
    row = int(bottom)
    if row < 0 or row >= size:
        row %= size
    x0, y0 = ax, ay
    while y0 < by:
        bottom += 1.0
        y1 = min(bottom, by)
        # the slope of an edge that hardly falls may overflow
        x1 = min(high, max(low, ax + run * (y1 - ay))) if bottom < by else bx
        height = light * (y1 - y0)
        left, right = min(x0, x1), max(x0, x1)
        pixel = np.floor(left)
        column = int(pixel)
        if column < 0 or column >= size:  # divisions are slow, and most edges lie in the first tile
            tile = column // size
            column -= tile * size
            start[row] -= height * tile
        before = 0.0
        if right > pixel + 1.0 and right - left > _UPRIGHT:
            slope = height / (right - left)
            while right > pixel + 1.0:
                # the part of the pixel right of an edge that enters it, or enters and leaves it
                inside = 0.5 * slope * (pixel + 1.0 - left) ** 2 if left > pixel else slope * (pixel + 0.5 - left)
                change[row, column] += inside - before
                before = inside
                pixel += 1.0
                column += 1
                if column == size:
                    column = 0
                    start[row] -= height - before
            inside = height - 0.5 * slope * (right - pixel) ** 2
        else:
            inside = height * (pixel + 1.0 - 0.5 * (left + right))
        change[row, column] += inside - before
        change[row, column + 1] += height - inside
        x0, y0 = x1, y1
        row = row + 1 if row + 1 < size else 0


_THINNEST = 2e-3
"""Twice the area [pixel^2] below which a triangle gives its flux to the other one of its cell.

Single precision resolves no smaller areas. Twice as large, cells at folds are drawn twice as wide, which is still about
a hundredth of a pixel.
"""

Cell = tuple[float, float, float, float, float, float, float, float]


@exact
def _twice_area(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle, positive if a, b, c run from +x to +y."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@exact
def opened(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> Cell:
    """Return the corners, pulled apart where both triangles are thinner than `_THINNEST`.

    At a fold of the caustic a cell becomes a line without area. The longer diagonal stays (or is drawn out to a
    twentieth of a pixel) and becomes a c; the two other corners move to either side of it.
    """
    if abs(_twice_area(ax, ay, bx, by, cx, cy)) >= _THINNEST or abs(_twice_area(ax, ay, cx, cy, dx, dy)) >= _THINNEST:
        return ax, ay, bx, by, cx, cy, dx, dy
    if (dx - bx) ** 2 + (dy - by) ** 2 > (cx - ax) ** 2 + (cy - ay) ** 2:
        ax, ay, cx, cy = bx, by, dx, dy
    ex, ey = cx - ax, cy - ay
    length2 = ex * ex + ey * ey
    if length2 < 0.0025:
        ex, ey, length2 = 0.05, 0.0, 0.0025
        cx, cy = ax + ex, ay
    wide = 1.5 * _THINNEST / length2
    mx, my = ax + 0.5 * ex, ay + 0.5 * ey
    return ax, ay, mx + wide * ey, my - wide * ex, cx, cy, mx - wide * ey, my + wide * ex


@exact
def intensities(corners: Cell, flux_b: float, flux_d: float) -> tuple[float, float]:
    """Return the signed intensities of the triangles (a, b, c) and (a, c, d) of an opened cell.

    A triangle thinner than `_THINNEST` gives its flux to the other one.
    """
    ax, ay, bx, by, cx, cy, dx, dy = corners
    b = _twice_area(ax, ay, bx, by, cx, cy)
    d = _twice_area(ax, ay, cx, cy, dx, dy)
    if abs(b) < _THINNEST:
        return 0.0, 2.0 * (flux_b + flux_d) / d
    if abs(d) < _THINNEST:
        return 2.0 * (flux_b + flux_d) / b, 0.0
    return 2.0 * flux_b / b, 2.0 * flux_d / d


def deposit_exact(hit: Floats, flux: Floats, size: int) -> Floats:
    """Return each cell's flux shared over pixels by the area it covers of them; the sum is that of the flux.

    The light of a cell as wide as the whole map is spread evenly.
    """
    cells = flux.shape[0]
    change, start = np.zeros((size, size + 1)), np.zeros(size)
    evenly = _add_cells(hit, flux, change, start, np.zeros((cells + 1, cells + 1, 2)))
    # Sum the edges along the rows; negative values are roundings
    light = np.concatenate([start[:, None], change[:, :-1]], axis=1).cumsum(axis=1)
    return np.maximum(light[:, 1:], 0.0) + evenly / (size * size)


@exact
def _add_cells(hit: Floats, flux: Floats, change: Floats, start: Floats, light: Floats) -> float:
    """Add the edges of all cells, see `add_edge`; return the flux of cells as wide as the map.

    light: (N + 1, N + 1, 2) zeros, room for that of each cell's triangles behind a row and a column without cells.
    """
    cells, size = flux.shape[0], start.shape[0]
    evenly = 0.0
    for j in range(cells):
        for i in range(cells):
            flux_b, flux_d = flux[j, i, 0], flux[j, i, 1]
            if flux_b + flux_d == 0.0:
                continue
            corners = opened(
                hit[j, i, 0], hit[j, i, 1], hit[j, i + 1, 0], hit[j, i + 1, 1],
                hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], hit[j + 1, i, 0], hit[j + 1, i, 1],
            )  # fmt: skip
            ax, ay, bx, by, cx, cy, dx, dy = corners
            wide = np.ceil(max(ax, bx, cx, dx)) - np.floor(min(ax, bx, cx, dx))
            high = np.ceil(max(ay, by, cy, dy)) - np.floor(min(ay, by, cy, dy))
            if wide >= size or high >= size:
                evenly += flux_b + flux_d
                continue
            in_b, in_d = intensities(corners, flux_b, flux_d)
            if bx == hit[j, i + 1, 0] and by == hit[j, i + 1, 1]:
                light[j + 1, i + 1, 0], light[j + 1, i + 1, 1] = in_b, in_d
                continue
            add_edge(change, start, ax, ay, bx, by, -in_b)
            add_edge(change, start, bx, by, cx, cy, -in_b)
            add_edge(change, start, ax, ay, cx, cy, in_b - in_d)
            add_edge(change, start, cx, cy, dx, dy, -in_d)
            add_edge(change, start, dx, dy, ax, ay, -in_d)
    for i in range(cells + 1):  # rows close on themselves; columns close one tile on
        light[0, i, 0], light[0, i, 1] = light[cells, i, 0], light[cells, i, 1]
    for j in range(cells):
        for i in range(cells):
            ax, ay = hit[j, i, 0], hit[j, i, 1]
            in_b, in_d = light[j + 1, i + 1, 0], light[j + 1, i + 1, 1]
            add_edge(change, start, ax, ay, hit[j, i + 1, 0], hit[j, i + 1, 1], light[j, i + 1, 1] - in_b)
            add_edge(change, start, ax, ay, hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], in_b - in_d)
            add_edge(change, start, ax, ay, hit[j + 1, i, 0], hit[j + 1, i, 1], in_d - light[j + 1, i, 0])
        bx, by = hit[j, cells, 0], hit[j, cells, 1]
        add_edge(change, start, bx, by, hit[j + 1, cells, 0], hit[j + 1, cells, 1], -light[j + 1, cells, 0])
    return evenly
