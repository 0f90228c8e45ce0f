# SPDX-License-Identifier: Apache-2.0
"""How the light of the refracted cells is laid into a periodic map: by exact coverage, or as others do it.

`hit`: (N + 1, N + 1, 2) where the grid's rays meet the plane, in pixels of the map, the last row and column one period
on. `flux`: (N, N, 2) light of each cell's two triangles (a, b, c) and (a, c, d), a = (i, j), b = (i + 1, j), c =
(i + 1, j + 1), d = (i, j + 1). Maps are (size, size), row = z, light per pixel. Compiled; float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.cell import intensities, opened
from mr360uw.caustics.flux.compiled import compiled
from mr360uw.caustics.flux.edges import add_edge, running_sum

Array = NDArray[np.floating[Any]]

_LEAST_JACOBIAN = 1e-6


@compiled
def deposit_exact(hit: Array, flux: Array, size: int) -> Array:
    """Return each cell's flux shared over pixels by the area it covers of them; the sum is that of the flux.

    The light of a cell as wide as the whole map is spread evenly.
    """
    cells = flux.shape[0]
    change, start = np.zeros((size, size + 1)), np.zeros(size)
    light = np.zeros((cells + 1, cells + 1, 2))  # of each cell's triangles, behind a row and a column without cells
    evenly = 0.0
    for j in range(cells):
        for i in range(cells):
            flux_b, flux_d = flux[j, i, 0], flux[j, i, 1]
            if flux_b + flux_d == 0.0:
                continue
            ax, ay, bx, by, cx, cy, dx, dy = opened(
                hit[j, i, 0], hit[j, i, 1], hit[j, i + 1, 0], hit[j, i + 1, 1],
                hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], hit[j + 1, i, 0], hit[j + 1, i, 1],
            )  # fmt: skip
            wide = np.ceil(max(ax, bx, cx, dx)) - np.floor(min(ax, bx, cx, dx))
            high = np.ceil(max(ay, by, cy, dy)) - np.floor(min(ay, by, cy, dy))
            if wide >= size or high >= size:
                evenly += flux_b + flux_d
                continue
            in_b, in_d = intensities(ax, ay, bx, by, cx, cy, dx, dy, flux_b, flux_d)
            if bx == hit[j, i + 1, 0] and by == hit[j, i + 1, 1]:
                light[j + 1, i + 1, 0], light[j + 1, i + 1, 1] = in_b, in_d
                continue
            add_edge(change, start, ax, ay, bx, by, -in_b)
            add_edge(change, start, bx, by, cx, cy, -in_b)
            add_edge(change, start, ax, ay, cx, cy, in_b - in_d)
            add_edge(change, start, cx, cy, dx, dy, -in_d)
            add_edge(change, start, dx, dy, ax, ay, -in_d)
    light[0] = light[cells]  # rows close on themselves; columns close one tile on
    for j in range(cells):
        for i in range(cells):
            ax, ay = hit[j, i, 0], hit[j, i, 1]
            in_b, in_d = light[j + 1, i + 1, 0], light[j + 1, i + 1, 1]
            add_edge(change, start, ax, ay, hit[j, i + 1, 0], hit[j, i + 1, 1], light[j, i + 1, 1] - in_b)
            add_edge(change, start, ax, ay, hit[j + 1, i + 1, 0], hit[j + 1, i + 1, 1], in_b - in_d)
            add_edge(change, start, ax, ay, hit[j + 1, i, 0], hit[j + 1, i, 1], in_d - light[j + 1, i, 0])
        bx, by = hit[j, cells, 0], hit[j, cells, 1]
        add_edge(change, start, bx, by, hit[j + 1, cells, 0], hit[j + 1, cells, 1], -light[j + 1, cells, 0])
    return running_sum(change, start) + evenly / (size * size)


@compiled
def _inside(weight: float, ex: float, ey: float) -> bool:
    """Top-left rule: a pixel centre on an edge belongs to one of the two triangles that share it."""
    return weight > 0.0 or (weight == 0.0 and (ey > 0.0 or (ey == 0.0 and ex < 0.0)))


@compiled
def rasterise(hit: Array, flux: Array, light: Array, jacobian: Array, size: int) -> Array:
    """Return intensities drawn at pixel centres, sheets added up, as a graphics pipeline without coverage does.

    light: (N + 1, N + 1) per vertex, jacobian: the same; a pixel gets interpolated light over interpolated |jacobian|.
    An empty `light` (0, 0) draws each triangle with its own flux over its own area.
    """
    out = np.zeros((size, size))
    at = np.zeros((3, 2))
    flat = light.shape[0] == 0
    for j in range(flux.shape[0]):
        for i in range(flux.shape[1]):
            for half in range(2):
                rows = (j, j, j + 1) if half == 0 else (j, j + 1, j + 1)
                columns = (i, i + 1, i + 1) if half == 0 else (i, i + 1, i)
                for k in range(3):
                    at[k] = hit[rows[k], columns[k]]
                area = (at[1, 0] - at[0, 0]) * (at[2, 1] - at[0, 1]) - (at[1, 1] - at[0, 1]) * (at[2, 0] - at[0, 0])
                left, right = at[:, 0].min(), at[:, 0].max()
                top, bottom = at[:, 1].min(), at[:, 1].max()
                if area == 0.0 or right - left > size or bottom - top > size:
                    continue
                sign = 1.0 if area > 0.0 else -1.0
                for y in range(int(np.ceil(top - 0.5)), int(np.floor(bottom - 0.5)) + 1):
                    for x in range(int(np.ceil(left - 0.5)), int(np.floor(right - 0.5)) + 1):
                        value, below, hits = 0.0, 0.0, True
                        for k in range(3):
                            p, q = at[(k + 1) % 3], at[(k + 2) % 3]
                            ex, ey = sign * (q[0] - p[0]), sign * (q[1] - p[1])
                            w = ex * (y + 0.5 - p[1]) - ey * (x + 0.5 - p[0])
                            if not _inside(w, ex, ey):
                                hits = False
                                break
                            if not flat:
                                value += w * light[rows[k], columns[k]]
                                below += w * jacobian[rows[k], columns[k]]
                        if hits and flat:
                            out[y % size, x % size] += 2.0 * flux[j, i, half] / abs(area)
                        elif hits:
                            out[y % size, x % size] += value / max(abs(below), _LEAST_JACOBIAN * abs(area))
    return out


def _around_vertices(per_triangle: Array) -> Array:
    """Return the sums (N + 1, N + 1) over the six triangles around each vertex of values (N, N, 2)."""
    b, d = per_triangle[..., 0], per_triangle[..., 1]
    both = b + d
    total = both + np.roll(both, (1, 1), (0, 1)) + np.roll(b, 1, 1) + np.roll(d, 1, 0)
    return np.pad(total, ((0, 1), (0, 1)), mode="wrap")


def deposit_ratio(hit: Array, flux: Array, size: int) -> Array:
    """Return the ratio of areas of each triangle, drawn at pixel centres."""
    return rasterise(hit, flux, np.zeros((0, 0)), np.zeros((0, 0)), size)


def deposit_fan(hit: Array, flux: Array, size: int) -> Array:
    """Return the ratio of areas of the triangles around each vertex, interpolated (Thompson et al. 2019)."""
    a, b, c, d = hit[:-1, :-1], hit[:-1, 1:], hit[1:, 1:], hit[1:, :-1]
    area = 0.5 * np.abs(np.stack([_cross(b - a, c - a), _cross(c - a, d - a)], axis=-1))
    light = _around_vertices(flux) / np.maximum(_around_vertices(area), _LEAST_JACOBIAN)
    return rasterise(hit, flux, light, np.ones_like(light), size)


def deposit_jacobian(hit: Array, flux: Array, size: int) -> Array:
    """Return flux density over the Jacobian of the refraction, interpolated and divided in every pixel."""
    periodic = hit - np.stack(np.broadcast_arrays(*np.meshgrid(*(np.arange(hit.shape[0]),) * 2)), axis=-1) * (
        size / flux.shape[0]
    )
    core = periodic[:-1, :-1]
    step = size / flux.shape[0]
    du = 0.5 * (np.roll(core, -1, 1) - np.roll(core, 1, 1)) + np.array([step, 0.0])
    dv = 0.5 * (np.roll(core, -1, 0) - np.roll(core, 1, 0)) + np.array([0.0, step])
    jacobian = np.pad(_cross(du, dv), ((0, 1), (0, 1)), mode="wrap")
    return rasterise(hit, flux, _around_vertices(flux) / 3.0, jacobian, size)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
