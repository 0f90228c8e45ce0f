# SPDX-License-Identifier: Apache-2.0
"""Caustics for the OpenGL renderer: the stack of `caustic_stack` in single precision, in half its time or less.

Each cell of the refracted surface is replaced by n x n points of equal flux on an even lattice, n chosen so that points
lie closer than a map's pixel or the blur of its plane resolves. Points are shared bilinearly by four pixels, and the
map is blurred by the sun's disc and by short waves in one Fourier transform. Time goes with the area of the cells'
images, 3 to 7 ns a point, and with the pixels: of the demo's 512 pixels and 192 cells, 6 ms a plane.

Bilinear interpolation between a cell's corners misplaces its points by (s - s^2)/2 of the second difference D of the
rays along x, and so along z, s the place in the cell. Its mean over the cell is D/12. The corners are moved by it, so
that the mean place of a cell's light is right to fourth order. Grids of three quarters of the cells have then a quarter
to a half of the error of coverage (`deposit`) with all of them.

Waves in the shadow of others, ripples, published methods and given grids too coarse for the sea are left to
`caustic_stack`.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.optics import into_water
from mr360uw.caustics.irradiance import (
    STEEPEST_RAY,
    Floats32,
    RefractedBeam,
    caustic_stack,
    pass_indices,
    slopes_of,
)
from mr360uw.caustics.settings import CausticSettings, Sea, cells_across, grid_of
from mr360uw.caustics.sun_disc import (
    GAUSSIAN_STEP,
    KERNEL_STEP,
    detail_footprint,
    disc_transform,
    footprint,
    gaussians,
    is_soft,
    soft_transform,
    steps_of,
    transform_of_steps,
)
from mr360uw.jit import exact, exact_making
from mr360uw.types import BeamSpread, CausticStack, Floats

_LEAST_BLUR = 0.2
"""Least standard deviation [pixel] of the blur of planes that are summed from points: sharper ones show them."""
_CLOSEST = 0.5
"""Least distance [pixel] that is kept between the points of a cell. Half as large, nothing gets better."""
_SPACING_OF_BLUR = 1.2
"""The same over the least standard deviation of a plane's blur. Twice as large, the lattice of points shows."""
_MOST_POINTS = 64.0
"""Points of a cell, as a mean over all, above which coverage takes no longer: deep below a sea without short waves."""
_MOST_ACROSS = 64
"""Points across one cell at the most, which bounds the time of a cell that is spread over the whole map."""
_SPARED = 0.25
"""Fraction of the cells across the tile that coverage needs and points do not (see above); those that shallow planes
need beyond are kept."""
_FOURTH = 1.0 / 12.0
"""Mean over a cell of (s - s^2)/2: fraction of the second difference that corners are moved by."""
_AT_ONCE = 256
"""Points whose shares are found together: half or twice as many take as long."""


def summed_stack(
    sea: Sea,
    sun_in_air: Floats,
    depths_m: Floats,
    time_s: float,
    settings: CausticSettings,
    refractive_index: float,
    spread: BeamSpread | None,
    ground_m: float | None = None,
) -> CausticStack:
    """Return the stack of `irradiance.caustic_stack` in single precision.

    sun_in_air: unit direction (3,) above the horizon. depths_m: (D,), ascending. ground_m: for its slopes.
    """
    from scipy.fft import irfft2

    sun_in_water = into_water(sun_in_air, refractive_index)
    travel, indices = -sun_in_water[[0, 2]] / sun_in_water[1], pass_indices(settings.chromatic, refractive_index)
    cells, blur_slope = _cells_of(sea, settings, float(depths_m[0]))
    lights: list[_Cells] = []
    for index in indices if cells else ():
        # Refract the surface's cells; waves that are turned away from the sun are left to coverage
        rays, flux = np.empty((8, cells + 1, cells + 1)), np.empty((cells, cells))
        vertex_rays(tuple(sea.grid_fields(cells, time_s)), sea.tile_m, sun_in_air, index, travel, rays)
        if cell_flux(rays, sun_in_air, flux) <= 0.0:
            break
        corners = np.empty((4, *rays.shape[1:]), np.float32)
        edge, share = cell_corners(rays, corners), (flux / flux.sum()).astype(np.float32)
        of_sea = sea, blur_slope, float(depths_m[0])
        lights.append(_Cells(*of_sea, sun_in_air, time_s, settings, index, travel, corners, share, edge))
    if len(lights) < len(indices):
        return caustic_stack(sea, sun_in_air, depths_m, time_s, settings, refractive_index, spread, ground_m)

    # Draw every plane, and that of the middle colour also as the light that has turned
    size, middle = settings.size, len(indices) // 2
    maps = np.empty((len(indices), len(depths_m), size, size), np.float32)
    turned = spread if is_soft(spread, depths_m[-1], sun_in_water) else None
    soft = None if turned is None else np.empty((*maps.shape[1:], 1), np.float32)
    for number, light in enumerate(lights):
        for plane, depth_m in enumerate(depths_m.tolist()):
            spectrum = light.draw(depth_m, maps[number, plane])
            if soft is not None and turned is not None and number == middle:
                spectrum *= _soft_factor(turned, tuple(sun_in_water.tolist()), depth_m, size, sea.tile_m)
                np.maximum(irfft2(spectrum, s=(size, size)), 0.0, out=soft[plane, ..., 0])
    slopes: tuple[Floats, ...] = ()
    if ground_m is not None:
        cells_of_middle = lights[middle].corners, lights[middle].flux
        slopes = slopes_of(*cells_of_middle, ground_m, sea, sun_in_air, settings, refractive_index)
    ratio = np.broadcast_to(np.moveaxis(maps, 0, -1), (*maps.shape[1:], 3))
    return CausticStack(ratio, depths_m, sea.tile_m, sun_in_water, soft, slopes)


@shared(keep=8)
def _cells_of(sea: Sea, settings: CausticSettings, depth_m: float) -> tuple[int, float]:
    """Return the cells across the tile, 0 where a sea's light cannot be summed from points; and its `blur_slope`.

    Cells that are given and too coarse for the sea are drawn as they are, as the reference draws them.
    """
    of_sea = sea, settings.sun_half_angle_rad
    enough = math.ceil(cells_across(*of_sea, depth_m) - _SPARED * cells_across(*of_sea))
    cells = enough if settings.grid is None else settings.grid
    summed = settings.method == "exact" and sea.detail(0.0) is None and cells >= enough
    return cells if summed else 0, sea.blur_slope


@dataclass(frozen=True, eq=False)
class _Cells:
    """Refracted cells of a sea's surface under the sun (3,), for one refractive index.

    blur_slope: of the sea. shallowest_m: depth of the first plane. travel: (2,) of the beam [m] for each metre of
    depth. corners: (4, N + 1, N + 1) of `cell_corners`. flux: (N, N), sum 1. edge: coefficients of 1, d and d^2 of the
    edges' mean square length [m^2] on the plane at depth d.
    """

    sea: Sea
    blur_slope: float
    shallowest_m: float
    sun: Floats
    time_s: float
    settings: CausticSettings
    refractive_index: float
    travel: Floats
    corners: Floats32
    flux: Floats32
    edge: tuple[float, float, float]

    def draw(self, depth_m: float, out: Floats32) -> NDArray[np.complex64]:
        """Write the map (size, size) of a plane, mean 1; return its spectrum (size, size/2 + 1)."""
        from scipy.fft import irfft2, rfft2

        size, tile_m, half_angle = len(out), self.sea.tile_m, self.settings.sun_half_angle_rad
        towards = tuple(self.sun.tolist())
        blur, factor = _blur_of(towards, self.refractive_index, self.blur_slope, half_angle, depth_m, size, tile_m)
        spacing = max(_CLOSEST, _SPACING_OF_BLUR * blur)
        edge_m2 = self.edge[0] + depth_m * (self.edge[1] + depth_m * self.edge[2])
        spectrum: NDArray[np.complex64]
        if blur < _LEAST_BLUR or edge_m2 * (size / tile_m / spacing) ** 2 > _MOST_POINTS:
            out[:] = self._covered.on_plane(depth_m, size, half_angle, "exact", self.travel)
            spectrum = rfft2(out)
            return spectrum
        sum_cells(self.corners, self.flux, depth_m, tile_m, float(size * size), spacing, out)
        spectrum = rfft2(out)
        spectrum *= factor
        np.maximum(irfft2(spectrum, s=out.shape), 0.0, out=out)
        return spectrum

    @functools.cached_property
    def _covered(self) -> RefractedBeam:
        surface = self.sea.grid_surface(grid_of(self.settings, self.sea, self.shallowest_m), self.time_s)
        return RefractedBeam(self.sea, surface, self.sun, self.refractive_index)


@shared(keep=64)
def _blur_of(
    sun_in_air: tuple[float, ...], refractive_index: float, slope: float, half_angle_rad: float, depth_m: float,
    size: int, tile_m: float,
) -> tuple[float, NDArray[np.complex64]]:  # fmt: skip
    """Return the least standard deviation [pixel] of a plane's blurs, and their factor on the spectrum of its map."""
    sun = np.array(sun_in_air)
    detail = detail_footprint(sun, refractive_index, slope, depth_m)
    disc = footprint(sun, refractive_index, half_angle_rad, depth_m)
    # A disc of radius r has the standard deviation r/2 along each axis
    blur_m = math.hypot(float(np.linalg.norm(detail, -2)), 0.5 * float(np.linalg.norm(disc, -2)))
    return blur_m * size / tile_m, _both_blurs(
        steps_of(detail, GAUSSIAN_STEP, size, tile_m), steps_of(disc, KERNEL_STEP, size, tile_m), size
    )


@shared(keep=64)
def _both_blurs(of_waves: tuple[float, ...], of_sun: tuple[float, ...], size: int) -> NDArray[np.complex64]:
    """Return the factor (size, size/2 + 1) of both blurs, of matrices in the steps of `sun_disc`."""
    return np.asarray(transform_of_steps(of_waves, size) * disc_transform(of_sun, size), np.complex64)


@shared(keep=64)
def _soft_factor(
    spread: BeamSpread, sun_in_water: tuple[float, ...], depth_m: float, size: int, tile_m: float
) -> Floats32:
    """Return the factor (size, size/2 + 1) on the spectrum of a plane's map that makes its light that has turned."""
    blurs = gaussians(spread, depth_m, np.array(sun_in_water), tile_m / size)
    return soft_transform(blurs, size, tile_m).astype(np.float32)


@exact_making
def vertex_rays(
    fields: tuple[Floats, ...], tile_m: float, sun: Floats, refractive_index: float, travel: Floats, out: Floats
) -> None:
    """Write the rays at the points of a grid of one tile from its `SurfaceFields`, (N, N) each.

    sun: (3,) towards it in air. travel: (2,) of the beam for each metre of depth, taken off the slopes. out: (8, N + 1,
    N + 1): position x, y, z, origin x, z, slope x, z, transmittance; the last row and column lie one tile on.
    """
    height, shift_x, shift_z, slope_x, slope_z, strain_xx, strain_zz, strain_xz = fields
    cells = len(height)
    cell_m, eta, row = tile_m / cells, 1.0 / refractive_index, np.empty((8, cells))
    for j in range(cells):
        for i in range(cells):  # into an array that nothing else refers to, which compilers vectorise
            across_x, across_z, shear = 1.0 + strain_xx[j, i], 1.0 + strain_zz[j, i], strain_xz[j, i]
            ny = across_x * across_z - shear * shear
            nx = slope_z[j, i] * shear - across_z * slope_x[j, i]
            nz = slope_x[j, i] * shear - across_x * slope_z[j, i]
            inverse = 1.0 / max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-30)
            nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
            cosine = nx * sun[0] + ny * sun[1] + nz * sun[2]
            bent = eta * cosine - np.sqrt(max(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0))
            run = 1.0 / max(eta * sun[1] - bent * ny, STEEPEST_RAY)
            along_x, along_z = (bent * nx - eta * sun[0]) * run, (bent * nz - eta * sun[2]) * run
            x, y, z = i * cell_m + shift_x[j, i], height[j, i], j * cell_m + shift_z[j, i]
            row[0, i], row[1, i], row[2, i] = x, y, z
            row[3, i], row[4, i] = x + along_x * y, z + along_z * y
            row[5, i], row[6, i] = along_x - travel[0], along_z - travel[1]
            c_i = max(cosine, 0.0)
            c_t = np.sqrt(1.0 - (1.0 - c_i * c_i) * eta * eta)
            s, p = c_i + refractive_index * c_t, refractive_index * c_i + c_t
            row[7, i] = 2.0 * refractive_index * c_i * c_t * (1.0 / (s * s) + 1.0 / (p * p))
        for field in range(8):
            for i in range(cells):
                out[field, j, i] = row[field, i]
            out[field, j, cells] = row[field, 0] + (tile_m if field in (0, 3) else 0.0)
    for field in range(8):
        for i in range(cells + 1):
            out[field, cells, i] = out[field, 0, i] + (tile_m if field in (2, 4) else 0.0)


@exact
def cell_flux(rays: Floats, sun: Floats, out: Floats) -> float:
    """Write the flux (N, N) [m^2] into the cells, per unit irradiance across the beam, as `irradiance.cell_flux`.

    rays: of `vertex_rays`. Returns the least flux of a triangle: where it is 0, one is turned away from the sun.
    """
    cells, least = len(out), np.inf
    for j in range(cells):
        for i in range(cells):
            # From corner a of the cell to the three others
            ax, ay, az = rays[0, j, i], rays[1, j, i], rays[2, j, i]
            bx, by, bz = rays[0, j, i + 1] - ax, rays[1, j, i + 1] - ay, rays[2, j, i + 1] - az
            cx, cy, cz = rays[0, j + 1, i + 1] - ax, rays[1, j + 1, i + 1] - ay, rays[2, j + 1, i + 1] - az
            dx, dy, dz = rays[0, j + 1, i] - ax, rays[1, j + 1, i] - ay, rays[2, j + 1, i] - az
            # Twice the triangles' area across the beam, times three times their transmittance
            middle = rays[7, j, i] + rays[7, j + 1, i + 1]
            b = sun[0] * (cy * bz - cz * by) + sun[1] * (cz * bx - cx * bz) + sun[2] * (cx * by - cy * bx)
            d = sun[0] * (dy * cz - dz * cy) + sun[1] * (dz * cx - dx * cz) + sun[2] * (dx * cy - dy * cx)
            b *= middle + rays[7, j, i + 1]
            d *= middle + rays[7, j + 1, i]
            out[j, i] = (max(b, 0.0) + max(d, 0.0)) / 6.0
            least = min(least, b, d)
    return least


@exact
def cell_corners(rays: Floats, out: Floats32) -> tuple[float, float, float]:
    """Write where rays cross the mean surface and their slopes, (4, N + 1, N + 1): x, z [m] and their rates, moved so
    that bilinear interpolation has the right mean over a cell. Returns `edge` of `_Cells`.
    """
    cells = rays.shape[1] - 1
    still, mixed, grown = 0.0, 0.0, 0.0
    for j in range(cells):
        before = j - 1 if j > 0 else cells - 1
        for i in range(cells):
            back = i - 1 if i > 0 else cells - 1
            for field in range(4):
                of = rays[3 + field]
                # Differences across the seam of the tile are those of its last row and column
                at = of[j, i]
                second = of[j, i + 1] - at - (of[j, back + 1] - of[j, back])
                second += of[j + 1, i] - at - (of[before + 1, i] - of[before, i])
                out[field, j, i] = at - _FOURTH * second
            for dj in range(2):
                x, z = rays[3, j + dj, i + 1 - dj] - rays[3, j, i], rays[4, j + dj, i + 1 - dj] - rays[4, j, i]
                u, v = rays[5, j + dj, i + 1 - dj] - rays[5, j, i], rays[6, j + dj, i + 1 - dj] - rays[6, j, i]
                still += x * x + z * z
                mixed += 2.0 * (x * u + z * v)
                grown += u * u + v * v
    # The last column and row lie one tile on
    for field in range(4):
        of = rays[3 + field]
        for j in range(cells):
            out[field, j, cells] = out[field, j, 0] + (of[0, cells] - of[0, 0])
        for i in range(cells + 1):
            out[field, cells, i] = out[field, 0, i] + (of[cells, 0] - of[0, 0])
    edges = 2.0 * cells * cells
    return still / edges, mixed / edges, grown / edges


@exact_making
def sum_cells(
    corners: Floats32, flux: Floats32, depth_m: float, tile_m: float, gain: float, spacing: float, out: Floats32
) -> None:
    """Write the light of cells on a plane to a map (size, size), each cell as points shared bilinearly by four pixels.

    corners, flux: of `_Cells`. gain: factor on the flux. spacing: [pixel] greatest distance of a cell's points.
    """
    cells, size = len(flux), len(out)
    padded = np.zeros((size + 2, size + 2), np.float32)
    place, share = np.empty((3, _AT_ONCE), np.float32), np.empty((4, _AT_ONCE), np.float32)
    at = np.empty(_AT_ONCE, np.int32)
    row = np.empty((4, cells + 1), np.float32)
    half, one, closer = np.float32(0.5), np.float32(1.0), np.float32(1.0 / spacing)
    count = 0
    _place_row(corners, 0, depth_m, size / tile_m, row[2], row[3])
    for j in range(cells):
        # Corners of the row of cells in pixels: above and below
        for i in range(cells + 1):  # one by one, see `jit`
            row[0, i], row[1, i] = row[2, i], row[3, i]
        _place_row(corners, j + 1, depth_m, size / tile_m, row[2], row[3])
        for i in range(cells):
            # Bilinear patch a + s b + t d + s t e, of as many points across as its longest side needs
            ax, az = row[0, i], row[1, i]
            bx, bz, dx, dz = row[0, i + 1] - ax, row[1, i + 1] - az, row[2, i] - ax, row[3, i] - az
            ex, ez = row[2, i + 1] - ax - bx - dx, row[3, i + 1] - az - bz - dz
            opposite = max((bx + ex) ** 2 + (bz + ez) ** 2, (dx + ex) ** 2 + (dz + ez) ** 2)
            side = max(bx * bx + bz * bz, dx * dx + dz * dz, opposite)
            across = min(max(int(np.ceil(np.sqrt(side) * closer)), 1), _MOST_ACROSS)
            step = one / np.float32(across)
            light = flux[j, i] * np.float32(gain) * step * step
            t = half * step
            for _ in range(across):
                x, z, run_x, run_z = ax + t * dx, az + t * dz, bx + t * ex, bz + t * ez
                s = half * step
                for _ in range(across):
                    place[0, count], place[1, count], place[2, count] = x + s * run_x, z + s * run_z, light
                    s += step
                    count += 1
                    if count == _AT_ONCE:
                        _add_points(place[0], place[1], place[2], size, at, share, padded)
                        count = 0
                t += step
    place[:, count:] = 0.0
    _add_points(place[0], place[1], place[2], size, at, share, padded)
    _close(padded, out)


@exact
def _place_row(corners: Floats32, j: int, depth_m: float, pixels_per_m: float, x: Floats32, z: Floats32) -> None:
    """Write where a row of corners meets a plane [pixel]."""
    depth, scale = np.float32(depth_m), np.float32(pixels_per_m)
    for i in range(len(x)):
        x[i] = (corners[0, j, i] + corners[2, j, i] * depth) * scale
        z[i] = (corners[1, j, i] + corners[3, j, i] * depth) * scale


@exact
def _add_points(
    x: Floats32, z: Floats32, light: Floats32, size: int, at: NDArray[np.int32], share: Floats32, padded: Floats32
) -> None:
    """Add points (n,) [pixel] to a map (size + 2, size + 2) with its other side around it. at, share: room."""
    # Find the pixel above and left of each point, and the light of it and its neighbours, as compilers vectorise
    half, side, inverse, wide = np.float32(0.5), np.float32(size), np.float32(1.0 / size), np.int32(size + 2)
    above_left, above_right, below_left, below_right = share[0], share[1], share[2], share[3]
    for k in range(len(x)):
        u, v = x[k] * inverse, z[k] * inverse
        column, row = (u - np.floor(u)) * side + half, (v - np.floor(v)) * side + half
        i, j = np.int32(column), np.int32(row)
        right, low = column - np.float32(i), (row - np.float32(j)) * light[k]
        high = light[k] - low
        at[k] = j * wide + i
        above_right[k], below_right[k] = high * right, low * right
        above_left[k], below_left[k] = high - above_right[k], low - below_right[k]
    # Add it
    flat, one, down = padded.reshape(-1), np.uint32(1), np.uint32(size + 2)
    for k in range(len(x)):
        own = np.uint32(at[k])
        flat[own] += above_left[k]
        flat[own + one] += above_right[k]
        flat[own + down] += below_left[k]
        flat[own + down + one] += below_right[k]


@exact
def _close(padded: Floats32, out: Floats32) -> None:
    """Write a map (size, size) from one with its other side around it, whose light is added where it belongs."""
    size = len(out)
    for i in range(size + 2):
        padded[1, i] += padded[size + 1, i]
        padded[size, i] += padded[0, i]
    for j in range(size):
        row = padded[j + 1]
        row[1] += row[size + 1]
        row[size] += row[0]
        for i in range(size):
            out[j, i] = row[i + 1]
