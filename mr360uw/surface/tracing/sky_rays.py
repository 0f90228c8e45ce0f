# SPDX-License-Identifier: Apache-2.0
"""Rays from the floor up to the sky through waves: compiled.

A ray finds the surface by the fixed point t = (depth + height(x + t v))/v_y on a map of heights, of which three steps
leave 1 % of the height of waves of slope 0.2 at the edge of Snell's window. It meets a facet of the mean slope there
plus a slope of its own, weighted by what the ray sees of it: (v.n)/n_y over that of the mean slope.
"""

from __future__ import annotations

import math
from typing import Any

from mr360uw.jit import exact, inlined
from mr360uw.surface.tracing.bare_arrays import bare
from mr360uw.surface.tracing.ray_optics import Vector, bent, reflectance
from mr360uw.surface.tracing.table_reads import add, sky_radiance

_STEPS = 3


@exact
def gather_row(
    w: Any, d: Any, dn: Any, rays: Any, tile_m: float, row: int, depth: float, index: float, footprint: float, out: Any
) -> None:
    """Write the sums (size, 3) of radiance over n^2 that the rays of a row of the floor's pixels see.

    w: (n, n, 3) height [m] and slopes over (x, z) of the surface, n a power of two. d, dn: the dome, as of
    `sky_radiance`. rays: (k, 7) direction up, place in the pixel over (x, z) in [0, 1), and slope of the facet.
    footprint: of each ray in the sky [rad].
    """
    w, d, dn, rays, out = bare(w), bare(d), bare(dn), bare(rays), bare(out)
    step = tile_m / len(out)
    for column in range(len(out)):
        light = (0.0, 0.0, 0.0)
        for k in range(len(rays)):
            v = rays[k, 0], rays[k, 1], rays[k, 2]
            x, z = (column + rays[k, 3]) * step, (row + rays[k, 4]) * step
            p = (0.0, 0.0, 0.0)
            for _ in range(_STEPS):
                t = (depth + p[0]) / v[1]
                p = _surface(w, tile_m, x + t * v[0], z + t * v[2])
            seen = v[1] - p[1] * v[0] - p[2] * v[2]
            sx, sz = p[1] + rays[k, 5], p[2] + rays[k, 6]
            facet = v[1] - sx * v[0] - sz * v[2]
            if seen > 0.0 and facet > 0.0:
                up = 1.0 / math.sqrt(1.0 + sx * sx + sz * sz)
                lost, _ = reflectance(facet * up, 1.0 / index)
                if lost < 1.0:
                    a = bent(v[0], v[1], v[2], sx * up, -up, sz * up, index)
                    light = add(light, sky_radiance(d, dn, a[0], a[1], a[2], footprint), (1.0 - lost) * facet / seen)
        out[column, 0], out[column, 1], out[column, 2] = light


@inlined
def _surface(w: Any, tile_m: float, x: float, z: float) -> Vector:
    """Return height and slopes over (x, z) at a place, between the points of the map."""
    size, last = len(w), len(w) - 1
    u, v = x * size / tile_m, z * size / tile_m
    column, row = math.floor(u), math.floor(v)
    i, j, fx, fy = int(column), int(row), u - column, v - row
    i0, i1, j0, j1 = i & last, (i + 1) & last, j & last, (j + 1) & last
    a, b, c, d = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        a * w[j0, i0, 0] + b * w[j0, i1, 0] + c * w[j1, i0, 0] + d * w[j1, i1, 0],
        a * w[j0, i0, 1] + b * w[j0, i1, 1] + c * w[j1, i0, 1] + d * w[j1, i1, 1],
        a * w[j0, i0, 2] + b * w[j0, i1, 2] + c * w[j1, i0, 2] + d * w[j1, i1, 2],
    )
