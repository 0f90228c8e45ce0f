# SPDX-License-Identifier: Apache-2.0
"""The sun, mirrored or refracted by facets of the surface: compiled, for one ray at a time.

A sun of solid angle W is seen by the facets in an area A = W |ds/dw| of slopes about the one that points it at the ray.
Where facets hardly differ, its disc is drawn. Symbols: slopes.py.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mr360uw.jit import exact
from mr360uw.surface.tracing.facet_draws import LEAST, SHARP, Facets, facets_of, facing
from mr360uw.surface.tracing.ray_optics import Vector, bent, mirrored, reflectance

_DARK = 80.0
"""Square of the distance in standard deviations at which 1e-17 of the facets are left."""


class Disc(NamedTuple):
    """The sun in the air: its direction, cosine of its angular radius, solid angle [sr], and its radiance; the solid
    angle is 0 where there is none over the horizon.
    """

    x: float
    y: float
    z: float
    edge: float
    solid_angle: float
    red: float
    green: float
    blue: float


@exact
def sunlight(sun: Disc, travel: Vector, normal: Vector, facets: Facets, side: float, index: float) -> float:
    """Return the radiance that the facets send back along a ray, over that of the sun.

    From above (side 1) it is mirrored, from below (-1) refracted. normal: of the mean slope, up. Jacobians of half
    vectors: Walter et al. 2007 eq. 14 and 17.
    """
    dx, dy, dz = travel
    hx, hy, hz = sun.x - dx, sun.y - dy, sun.z - dz
    if side < 0.0:
        hx, hy, hz = index * dx - sun.x, index * dy - sun.y, index * dz - sun.z
    length = max(math.sqrt(hx * hx + hy * hy + hz * hz), LEAST)
    nx, ny, nz = hx / length, hy / length, hz / length
    cosine = -side * (dx * nx + dy * ny + dz * nz)
    at_sun = sun.x * nx + sun.y * ny + sun.z * nz
    per_direction = max(at_sun, 0.0) / (length * length)
    image = max(sun.solid_angle * per_direction / max(abs(ny), 1e-3) ** 3, LEAST)
    own = image / (4.0 * math.pi)  # variance of the sun's image in slopes, along each axis
    # the covariance and its determinant, of its root
    cxx, cxz = facets.xx * facets.xx, facets.xx * facets.zx
    czz = facets.zx * facets.zx + facets.zz * facets.zz
    if facets.xx * facets.zz < SHARP * own:
        return _disc(sun, travel, normal, side, index)
    if at_sun <= 0.0 or cosine <= 0.0 or ny <= 0.0:
        return 0.0
    slope_x, slope_z = -nx / max(ny, LEAST), -nz / max(ny, LEAST)
    off_x, off_z = slope_x - facets.slope_x, slope_z - facets.slope_z
    xx, xz, zz = cxx + own, cxz, czz + own
    determinant = max(xx * zz - xz * xz, 1e-300)
    square = (zz * off_x * off_x - 2.0 * xz * off_x * off_z + xx * off_z * off_z) / determinant
    if square > _DARK:
        return 0.0
    share = min(image * math.exp(-0.5 * square) / (2.0 * math.pi * math.sqrt(determinant)), 1.0)
    weight = max(facing(dx, dy, dz, slope_x, slope_z, side), 0.0) / facets.seen
    factor = reflectance(min(cosine, 1.0), index)[0]
    if side < 0.0:
        factor = (1.0 - reflectance(min(at_sun, 1.0), index)[0]) * index * index
    return share * weight * factor


@exact
def glitter(sun: Disc, travel: Any, normal: Any, covariance: Any, side: float, index: float) -> Any:
    """Return `sunlight` (n,) of n rays (n, 3). covariance: (n, 3) xx, xz, zz of the slopes that each meets."""
    light = np.zeros(len(travel))
    for k in range(len(travel)):
        d = travel[k, 0], travel[k, 1], travel[k, 2]
        n = normal[k, 0], normal[k, 1], normal[k, 2]
        facets = facets_of(d, n, (covariance[k, 0], covariance[k, 1], covariance[k, 2]), side)
        light[k] = sunlight(sun, d, n, facets, side, index)
    return light


@exact
def _disc(sun: Disc, travel: Vector, normal: Vector, side: float, index: float) -> float:
    """Return the radiance of the sun's disc over its own, seen by facets of the mean slope alone."""
    dx, dy, dz = travel
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    cosine = min(max(-(dx * nx + dy * ny + dz * nz), 0.0), 1.0)
    if side < 0.0:
        x, y, z = bent(dx, dy, dz, nx, ny, nz, index)
        factor = (1.0 - reflectance(cosine, 1.0 / index)[0]) * index * index
    else:
        x, y, z = mirrored(dx, dy, dz, nx, ny, nz)
        factor = reflectance(cosine, index)[0]
    return factor if x * sun.x + y * sun.y + z * sun.z >= sun.edge else 0.0


@exact
def sun_seen(sun: Disc, half_angle: float, dx: float, dy: float, dz: float, spread: float) -> float:
    """Return the radiance of the sun that a ray sees without the sea, over that of its own disc.

    Wide footprints see it wider and dimmer.
    """
    seen = max(min(spread / math.sqrt(math.pi), 1.0), half_angle)
    if dx * sun.x + dy * sun.y + dz * sun.z <= math.cos(seen):
        return 0.0
    return sun.solid_angle / (2.0 * math.pi * (1.0 - math.cos(seen)))
