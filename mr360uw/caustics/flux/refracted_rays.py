# SPDX-License-Identifier: Apache-2.0
"""Refracted sun rays below a surface, the flux into its triangles, and waves in the shadow of other waves.

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

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact
from mr360uw.optics import fresnel_transmittance, refract_clamped
from mr360uw.types import Surface

Array = NDArray[np.floating[Any]]

IN_SHADOW = 1e-6
"""Lit fraction of a point in shadow: a coarse grid that a low sun does not see at all gets its map without shadows."""


def lit_corners(surface: Surface, sun: Array, tile_m: float) -> Array:
    """Return 1 for each point (N, N) of a grid surface that the sun sees, else `IN_SHADOW`. sun: unit, upwards."""
    size = len(surface.position)
    cell = tile_m / size
    at = np.arange(size) * cell
    fields = np.stack(
        [surface.position[..., 0] - at, surface.position[..., 2] - at[:, None], surface.position[..., 1]], axis=-1
    )
    steps = shadow_steps(float(np.ptp(surface.position[..., 1])), sun, tile_m, size)
    if steps == 0:
        return np.ones((size, size))
    flat = math.hypot(float(sun[0]), float(sun[2]))
    return _lit(fields / cell, float(sun[0]) / flat, float(sun[2]) / flat, float(sun[1]) / flat, steps)


def shadow_steps(range_m: float, sun: Array, tile_m: float, size: int) -> int:
    """Return the cells that the longest shadow reaches, at most those of a tile. range_m: of the surface's heights."""
    flat = math.hypot(float(sun[0]), float(sun[2]))
    reach = range_m * flat / float(sun[1]) * size / tile_m
    return min(math.ceil(reach), size) if reach > 1.0 else 0


@exact
def _read(fields: Array, channel: int, x: float, z: float) -> float:
    n = fields.shape[0]
    i, j = math.floor(x), math.floor(z)
    fx, fz = x - i, z - j
    i0, j0 = int(i) % n, int(j) % n
    i1, j1 = (i0 + 1) % n, (j0 + 1) % n
    above = fields[j0, i0, channel] * (1.0 - fx) + fields[j0, i1, channel] * fx
    below = fields[j1, i0, channel] * (1.0 - fx) + fields[j1, i1, channel] * fx
    value: float = above * (1.0 - fz) + below * fz
    return value


@exact
def _lit(fields: Array, along_x: float, along_z: float, rise: float, steps: int) -> Array:
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
                    lit[j, i] = IN_SHADOW
                    break
    return lit


STEEPEST_RAY = 0.05
"""Least downward component of a refracted ray's direction (3 degrees below the horizon); it keeps slopes finite.

Only facets tilted by more than 39 degrees can reach it. Twice as large, their light lands half as far.
"""


def ray_slope(normal: Array, sun_in_air: Array, refractive_index: float) -> Array:
    """Return the horizontal travel (..., 2) of refracted sunlight for each metre of depth."""
    t = refract_clamped(-sun_in_air, normal, 1.0 / refractive_index)
    return t[..., [0, 2]] / np.maximum(-t[..., 1:2], STEEPEST_RAY)


def refracted_rays(surface: Surface, sun_in_air: Array, refractive_index: float) -> tuple[Array, Array, Array]:
    """Return the rays that enter at each point of a surface.

    Where they cross the mean surface (..., 2) over (x, z), their slope (..., 2) in metres per metre of depth, and the
    fraction (...,) of the sun's flux that is let through, 0 where the surface is turned away from it.
    """
    slope = ray_slope(surface.normal, sun_in_air, refractive_index)
    origin = surface.position[..., [0, 2]] + slope * surface.position[..., 1:2]
    return origin, slope, fresnel_transmittance(surface.normal @ sun_in_air, refractive_index)


def facet_flux(a: Array, b: Array, c: Array, transmittance: Array, sun_in_air: Array) -> Array:
    """Return the flux (...,) into the water through triangles (..., 3), per unit irradiance across the beam.

    transmittance: of the triangle. The corners run so that (b - a) x (c - a) points up; facets turned away get nothing.
    """
    u, v = b - a, c - a
    twice = (
        sun_in_air[..., 0] * (u[..., 1] * v[..., 2] - u[..., 2] * v[..., 1])
        + sun_in_air[..., 1] * (u[..., 2] * v[..., 0] - u[..., 0] * v[..., 2])
        + sun_in_air[..., 2] * (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
    )
    return 0.5 * transmittance * np.maximum(twice, 0.0)
