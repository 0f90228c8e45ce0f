# SPDX-License-Identifier: Apache-2.0
"""Caustics for the OpenGL renderer: `caustic_stack` in single precision, a tenth of its time where it blurs.

Where short waves blur a plane by pixels, how cells are shared over pixels no longer shows. There the light of a cell is
summed as points (`point_kernels`), bilinearly: the map's spectrum is then that of `deposit` times sinc k_x sinc k_z, k
in cycles a pixel, and the factor of the blur divides by it. Sampling folds frequencies k near 1 onto 1 - k, which the
blur leaves. Coverage keeps sinc k of them, bilinear points sinc^2 k: the difference of the two methods is mostly the
fold of coverage. Other planes are those of `caustic_stack`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import shared
from mr360uw.caustics.flux.irradiance import SurfaceLight, beam_slope, caustic_stack, check_arguments, pass_indices
from mr360uw.caustics.flux.sun_disc import (
    detail_footprint,
    disc_transform,
    footprint,
    gaussian_steps,
    gaussians,
    is_soft,
    kernel_steps,
    soft_transform,
    transform_of_steps,
)
from mr360uw.caustics.settings import CausticSettings, Sea, grid_of
from mr360uw.optics import refract_to_water
from mr360uw.types import BeamSpread, CausticStack

Array = NDArray[np.floating[Any]]
Spectrum = NDArray[np.complex64]

_LEAST_BLUR = 2.0
"""Least standard deviation [pixel] of the blur by short waves of planes that are summed from points.

The two methods differ by up to 0.03 of the mean there in all but one pixel of 10 000, mostly at the brightest ones, and
by a quarter of it at twice as much.
"""
_MOST_EDGE = 1.5
"""Greatest root mean square length of the cells' edges over that standard deviation: points further apart show.

The grids that seas choose for themselves stay below; at 1.4 the difference from coverage is not larger than at 0.5.
"""


def blurred_stack(
    sea: Sea,
    sun_in_air: Array,
    depths_m: Array,
    time_s: float,
    settings: CausticSettings,
    refractive_index: float,
    spread: BeamSpread | None,
) -> CausticStack:
    """Return the stack of `irradiance.caustic_stack` in single precision. Raises `ParameterError`."""
    check_arguments(
        sun_in_air, depths_m, settings.size, grid_of(settings, sea), refractive_index, settings.sun_half_angle_rad
    )
    sun_in_water, size, tile_m = refract_to_water(sun_in_air, refractive_index), settings.size, sea.tile_m
    lights = _point_lights(sea, sun_in_air, time_s, settings, refractive_index)
    factors = [[light.transfer(depth, settings) for depth in depths_m.tolist()] for light in lights]
    if not any(factor is not None for row in factors for factor in row):
        return caustic_stack(sea, sun_in_air, depths_m, time_s, settings, refractive_index, spread)
    maps = np.empty((len(lights), len(depths_m), size, size), np.float32)
    spectra = [light.draw(depths_m, settings, row, out) for light, row, out in zip(lights, factors, maps, strict=True)]
    soft = None
    if spread is not None and is_soft(spread, depths_m[-1], sun_in_water):
        towards = tuple(sun_in_water.tolist())
        turned = [_soft_factor(spread, towards, depth, size, tile_m) for depth in depths_m.tolist()]
        soft = _softened(spectra[len(lights) // 2], turned)
    ratio = np.moveaxis(maps, 0, -1)
    return CausticStack(np.broadcast_to(ratio, (*ratio.shape[:3], 3)), depths_m, tile_m, sun_in_water, soft)


@dataclass(frozen=True, slots=True)
class _PointLight:
    """Light of one refractive index below a sea, as points (5, n) of `edge_points`.

    travel: (2,) of the beam [m] for each metre of depth. total: flux of all points. edge: coefficients (3,) of the
    edges' mean square length.
    """

    sea: Sea
    sun: Array
    time_s: float
    refractive_index: float
    travel: Array
    points: NDArray[np.float32]
    total: float
    edge: tuple[float, float, float]

    def transfer(self, depth_m: float, settings: CausticSettings) -> Spectrum | None:
        """Return the factor on the spectrum of a plane's points; None where the plane is not blurred enough."""
        size, tile_m, slope = settings.size, self.sea.tile_m, self.sea.blur_slope
        through = tuple(self.sun.tolist()), self.refractive_index
        blur_m = _blur_m(*through, slope, depth_m)
        edge_m = math.sqrt(self.edge[0] + depth_m * (self.edge[1] + depth_m * self.edge[2]))
        if blur_m * size < _LEAST_BLUR * tile_m or edge_m > _MOST_EDGE * blur_m:
            return None
        return _blur_of_points(*through, slope, settings.sun_half_angle_rad, depth_m, size, tile_m)

    def draw(
        self, depths_m: Array, settings: CausticSettings, factors: list[Spectrum | None], maps: NDArray[np.float32]
    ) -> Spectrum:
        """Fill the maps (D, size, size) of planes; return their spectra (D, size, size/2 + 1)."""
        from scipy.fft import irfft2, rfft2

        from mr360uw.caustics.flux.point_kernels import sum_points

        size, tile_m = settings.size, self.sea.tile_m
        scratch, covered = np.empty((size + 2, size + 2), np.float32), None
        for depth_m, factor, out in zip(depths_m.tolist(), factors, maps, strict=True):
            if factor is not None:
                sum_points(self.points, depth_m, tile_m, size * size / self.total, scratch, out)
                continue
            covered = self._by_coverage(settings) if covered is None else covered
            out[:] = covered.on_plane(depth_m, size, settings.sun_half_angle_rad, "exact", self.travel)
        spectra: Spectrum = rfft2(maps)
        for number, factor in enumerate(factors):
            if factor is not None:
                spectra[number] *= factor
                np.maximum(irfft2(spectra[number], s=(size, size)), 0.0, out=maps[number])
        return spectra

    def _by_coverage(self, settings: CausticSettings) -> SurfaceLight:
        surface = self.sea.grid_surface(grid_of(settings, self.sea), self.time_s)
        return SurfaceLight(self.sea, surface, self.sun, self.refractive_index)


def _point_lights(
    sea: Sea, sun: Array, time_s: float, settings: CausticSettings, refractive_index: float
) -> list[_PointLight]:
    """Return the light of each pass; empty where a method, ripples, shadows or no blur rule points out."""
    if settings.method != "exact" or sea.blur_slope == 0.0:
        return []
    from mr360uw.caustics.flux.point_kernels import edge_points, triangle_flux, vertex_rays

    cells, tile_m = grid_of(settings, sea), sea.tile_m
    fields, travel = np.stack(sea.grid_fields(cells, time_s)), beam_slope(refract_to_water(sun, refractive_index))
    rays, flux = np.empty((8, cells + 1, cells + 1)), np.empty((2, cells + 1, cells + 1))
    lights = []
    for index in pass_indices(settings.chromatic, refractive_index):
        vertex_rays(fields, tile_m, sun, index, travel, rays)
        if triangle_flux(rays, sun, flux) <= 0.0:
            return []
        points = np.empty((5, 3, cells, cells), np.float32)
        total, still, mixed, grown = edge_points(rays, flux, points)
        edge = still, mixed, grown
        lights.append(_PointLight(sea, sun, time_s, index, travel, points.reshape(5, -1), total, edge))
    return lights


def _softened(spectra: Spectrum, factors: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the maps (D, size, size, 1) of spectra times their factors, at least 0; the spectra are overwritten."""
    from scipy.fft import irfft2

    for number, factor in enumerate(factors):
        spectra[number] *= factor
    maps: NDArray[np.float32] = irfft2(spectra, s=(spectra.shape[1],) * 2, overwrite_x=True)
    return np.maximum(maps, 0.0, out=maps)[..., None]


@shared(keep=64)
def _soft_factor(
    spread: BeamSpread, sun_in_water: tuple[float, ...], depth_m: float, size: int, tile_m: float
) -> NDArray[np.float32]:
    """Return the factor (size, size/2 + 1) on the spectrum of a plane's map that makes its light that has turned."""
    blurs = gaussians(spread, depth_m, np.array(sun_in_water), tile_m / size)
    return soft_transform(blurs, size, tile_m).astype(np.float32)


@shared(keep=64)
def _blur_m(sun: tuple[float, ...], refractive_index: float, slope: float, depth_m: float) -> float:
    """Return the least standard deviation [m] of the blur of a plane by short waves."""
    return float(np.linalg.norm(detail_footprint(np.array(sun), refractive_index, slope, depth_m), -2))


@shared(keep=64)
def _blur_of_points(
    sun: tuple[float, ...], refractive_index: float, slope: float, half_angle_rad: float, depth_m: float, size: int,
    tile_m: float,
) -> Spectrum:  # fmt: skip
    """Return the factor (size, size/2 + 1) of both blurs of a plane over that of its points' bilinear shares."""
    detail = detail_footprint(np.array(sun), refractive_index, slope, depth_m)
    disc = footprint(np.array(sun), refractive_index, half_angle_rad, depth_m)
    of_waves = transform_of_steps(gaussian_steps(detail, size, tile_m), size)
    of_sun = disc_transform(kernel_steps(disc, size, tile_m), size)
    x, z = np.fft.rfftfreq(size), np.fft.fftfreq(size)[:, None]
    return np.asarray(of_waves * of_sun / (np.sinc(x) * np.sinc(z)), np.complex64)
