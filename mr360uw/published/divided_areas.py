# SPDX-License-Identifier: Apache-2.0
"""Caustics after published methods, which do not conserve energy.

By division of areas, drawn at pixel centres as a graphics pipeline does:

    ratio      flux of each triangle over the area of its image
    fan        flux over area of the triangles around each vertex, interpolated      Thompson et al. 2019
    jacobian   flux density over the Jacobian of the refraction, divided in each pixel

They lose light where a triangle covers no pixel centre and add light where areas shrink to nothing, so their mean is
not 1 beyond the first fold. `hit`, `flux` and maps: as in `caustics/flux/deposit.py`.

By scrolling two copies of one still map, the darker of which shows (Stam 1996; Monzon et al. 2022).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact

Array = NDArray[np.floating[Any]]

_LEAST_JACOBIAN = 1e-6
"""Least area, or Jacobian over area, that flux is divided by, because both vanish at a fold. Twice as large, the
brightest pixels of a fold are half as bright."""


_SCROLL = ((0.37, 0.21), (-0.29, 0.33))
"""Velocity [m/s] of the two copies over (x, z), about that of short waves; twice as large, the pattern moves as fast
as waves four times as long."""


@exact
def _inside(weight: float, ex: float, ey: float) -> bool:
    """Top-left rule: a pixel centre on an edge belongs to one of the two triangles that share it."""
    return weight > 0.0 or (weight == 0.0 and (ey > 0.0 or (ey == 0.0 and ex < 0.0)))


@exact
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


DEPOSITS: dict[str, Callable[[Array, Array, int], Array]] = {
    "ratio": deposit_ratio, "fan": deposit_fan, "jacobian": deposit_jacobian
}  # fmt: skip
"""The methods by the name that the settings give them."""


def scroll_offsets(tile_m: float, loop_s: float | None, time_s: float) -> Array:
    """Return how far (2, 2) over (x, z), in tiles, the two copies have moved; whole tiles in a loop."""
    rate = np.array(_SCROLL) / tile_m
    if loop_s is not None:
        rate = np.round(rate * loop_s) / loop_s
    return rate * time_s


def scroll(ratio: Array, tile_m: float, loop_s: float | None, time_s: float) -> Array:
    """Return the darker of two scrolled copies of a map (size, size), of mean 1; the second has x and z swapped."""
    size = ratio.shape[0]
    first, second = np.round(scroll_offsets(tile_m, loop_s, time_s) * size).astype(np.int64)
    darker = np.minimum(np.roll(ratio, (first[1], first[0]), (0, 1)), np.roll(ratio.T, (second[1], second[0]), (0, 1)))
    return darker / darker.mean()
