# SPDX-License-Identifier: Apache-2.0
"""Kernels of `blurred_stack`: rays and flux of a displaced surface, its light as points, sums of points in maps.

The light of a triangle is replaced by a third of it at the middle of each edge, which keeps its flux, its centre and
its variance: the rule of the three midpoints is exact for quadratic polynomials. Edges are shared, so a cell has three
points: on its edges a-b and a-d and on its diagonal a-c, with the corners of `deposit`. Compiled. Twin: sea/base.py,
refracted_rays.py (`displaced_surface`, `refracted_rays`, `facet_flux`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.refracted_rays import STEEPEST_RAY
from mr360uw.jit import exact

Array = NDArray[np.floating[Any]]

_HALF = np.float32(0.5)
_AT_ONCE = 256
"""Points whose shares are found together: half or twice as many take as long."""


@exact
def vertex_rays(fields: Array, tile_m: float, sun: Array, refractive_index: float, travel: Array, out: Array) -> None:
    """Write the rays at the points of a grid of one tile from its `SurfaceFields`, (8, N, N).

    sun: (3,) towards it in air. travel: (2,) of the beam for each metre of depth, taken off the slopes. out: (8, N + 1,
    N + 1): position x, y, z, origin x, z, slope x, z, transmittance; the last row and column lie one tile on.
    """
    cells = fields.shape[1]
    cell_m, eta, row = tile_m / cells, 1.0 / refractive_index, np.empty((8, cells))
    for j in range(cells):
        of = fields[:, j]
        for i in range(cells):  # into an array that nothing else refers to, which compilers vectorise
            across_x, across_z, shear = 1.0 + of[5, i], 1.0 + of[6, i], of[7, i]
            ny = across_x * across_z - shear * shear
            nx = of[4, i] * shear - across_z * of[3, i]
            nz = of[3, i] * shear - across_x * of[4, i]
            inverse = 1.0 / max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-30)
            nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
            cosine = nx * sun[0] + ny * sun[1] + nz * sun[2]
            bent = eta * cosine - np.sqrt(max(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0))
            run = 1.0 / max(eta * sun[1] - bent * ny, STEEPEST_RAY)
            along_x, along_z = (bent * nx - eta * sun[0]) * run, (bent * nz - eta * sun[2]) * run
            x, y, z = i * cell_m + of[1, i], of[0, i], j * cell_m + of[2, i]
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
def triangle_flux(rays: Array, sun: Array, out: Array) -> float:
    """Write the flux [m^2] into the triangles of each cell, per unit irradiance across the beam.

    rays: of `vertex_rays`. out: (2, N + 1, N + 1), of the triangles (a, b, c) and (a, c, d) of cell (j, i) in row j + 1
    and column i + 1; the first row and column lie one tile back. Returns the least flux: where it is 0, a triangle is
    turned away from the sun.
    """
    cells, least = rays.shape[1] - 1, np.inf
    for j in range(cells):
        for i in range(cells):
            ax, ay, az = rays[0, j, i], rays[1, j, i], rays[2, j, i]
            bx, by, bz = rays[0, j, i + 1] - ax, rays[1, j, i + 1] - ay, rays[2, j, i + 1] - az
            cx, cy, cz = rays[0, j + 1, i + 1] - ax, rays[1, j + 1, i + 1] - ay, rays[2, j + 1, i + 1] - az
            dx, dy, dz = rays[0, j + 1, i] - ax, rays[1, j + 1, i] - ay, rays[2, j + 1, i] - az
            middle = rays[7, j, i] + rays[7, j + 1, i + 1]
            b = sun[0] * (cy * bz - cz * by) + sun[1] * (cz * bx - cx * bz) + sun[2] * (cx * by - cy * bx)
            d = sun[0] * (dy * cz - dz * cy) + sun[1] * (dz * cx - dx * cz) + sun[2] * (dx * cy - dy * cx)
            out[0, j + 1, i + 1] = max(b, 0.0) * (middle + rays[7, j, i + 1]) / 6.0
            out[1, j + 1, i + 1] = max(d, 0.0) * (middle + rays[7, j + 1, i]) / 6.0
        for i in range(cells):
            least = min(least, out[0, j + 1, i + 1], out[1, j + 1, i + 1])
    for k in range(2):
        for i in range(cells + 1):
            out[k, 0, i] = out[k, cells, i]
        for j in range(cells + 1):
            out[k, j, 0] = out[k, j, cells]
    return least


@exact
def edge_points(rays: Array, flux: Array, points: Array) -> tuple[float, float, float, float]:
    """Write the light of the cells as points: origin x, z, slope x, z and flux, (5, 3, N, N), in single precision.

    rays, flux: of `vertex_rays`, `triangle_flux`. Returns the sum of the flux [m^2] and, weighted by it, the mean
    square of the edges' length [m^2] on the plane at depth d as the coefficients of 1, d and d^2.
    """
    cells = rays.shape[1] - 1
    total, still, mixed, grown = 0.0, 0.0, 0.0, 0.0
    for edge in range(3):  # a-b, a-c, a-d
        down, right = (1 if edge > 0 else 0), (1 if edge < 2 else 0)
        for j in range(cells):
            for i in range(cells):
                x, z, u, v = rays[3, j, i], rays[4, j, i], rays[5, j, i], rays[6, j, i]
                ex, ez = rays[3, j + down, i + right] - x, rays[4, j + down, i + right] - z
                eu, ev = rays[5, j + down, i + right] - u, rays[6, j + down, i + right] - v
                # of the two triangles that share the edge
                light = (flux[0, j + 1, i + right] + flux[1, j + down, i + 1]) / 3.0
                points[0, edge, j, i], points[1, edge, j, i] = x + 0.5 * ex, z + 0.5 * ez
                points[2, edge, j, i], points[3, edge, j, i] = u + 0.5 * eu, v + 0.5 * ev
                points[4, edge, j, i] = light
                total += light
                still += light * (ex * ex + ez * ez)
                mixed += light * 2.0 * (ex * eu + ez * ev)
                grown += light * (eu * eu + ev * ev)
    return total, still / total, mixed / total, grown / total


@exact
def sum_points(points: Array, depth_m: float, tile_m: float, gain: float, padded: Array, out: Array) -> None:
    """Write the sum (size, size) of points (5, n) of `edge_points` on a plane, each shared bilinearly by four pixels.

    gain: factor on the flux. padded: (size + 2, size + 2) room.
    """
    size, wide = out.shape[0], np.uint32(padded.shape[1])
    flat, right, below = padded.reshape(-1), np.uint32(1), wide + np.uint32(1)
    at, share = np.empty(_AT_ONCE, np.int32), np.empty((4, _AT_ONCE), np.float32)
    padded[:] = 0.0
    for start in range(0, points.shape[1], _AT_ONCE):
        part = slice(start, min(start + _AT_ONCE, points.shape[1]))
        _share_points(  # each row by itself is contiguous, which compilers can tell
            points[0, part], points[1, part], points[2, part], points[3, part], points[4, part], depth_m, tile_m, gain,
            size, at, share,
        )  # fmt: skip
        for k in range(part.stop - start):
            own = np.uint32(at[k])
            flat[own] += share[0, k]
            flat[own + right] += share[1, k]
            flat[own + wide] += share[2, k]
            flat[own + below] += share[3, k]
    padded[1] += padded[size + 1]
    padded[size] += padded[0]
    for j in range(size):
        row = padded[j + 1]
        row[1] += row[size + 1]
        row[size] += row[0]
        for i in range(size):
            out[j, i] = row[i + 1]


@exact
def _share_points(
    origin_x: Array, origin_z: Array, slope_x: Array, slope_z: Array, flux: Array, depth_m: float, tile_m: float,
    gain: float, size: int, at: NDArray[np.int32], share: Array,
) -> None:  # fmt: skip
    """Write the padded pixel above and left of each point, and the light of it and its three neighbours (4, n).

    A loop of its own, which compilers vectorise.
    """
    depth, across, gained, side = np.float32(depth_m), np.float32(1.0 / tile_m), np.float32(gain), np.float32(size)
    above_left, above_right, below_left, below_right = share[0], share[1], share[2], share[3]
    for k in range(len(flux)):
        u, v = (origin_x[k] + slope_x[k] * depth) * across, (origin_z[k] + slope_z[k] * depth) * across
        x, z = (u - np.floor(u)) * side + _HALF, (v - np.floor(v)) * side + _HALF
        column, row = np.floor(x), np.floor(z)
        at[k] = np.int32(row) * np.int32(size + 2) + np.int32(column)
        right, down, light = x - column, z - row, flux[k] * gained
        lower = light * down
        upper = light - lower
        upper_right, lower_right = upper * right, lower * right
        above_left[k], above_right[k] = upper - upper_right, upper_right
        below_left[k], below_right[k] = lower - lower_right, lower_right
