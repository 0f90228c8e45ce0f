# SPDX-License-Identifier: Apache-2.0
"""Radiance of the floor at one place: compiled.

array   shape           what
f       (n, 3)          texels of the albedo and of the light's patterns, each with its halves
fn      (k, 3)          first texel, width and height of every level of each
fk      (1 + p q, 2)    first row of `fn` and levels of the albedo, then of the q patterns of each of p planes
fe      (p, 3 + 2 q)    of each plane: even light, then the origin over (x, z) of each pattern
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.caustics.flux.compiled import compiled
from mr360uw.surface.tracing.ray_optics import Vector
from mr360uw.surface.tracing.table_reads import add, level_for, periodic, times


class Ground(NamedTuple):
    """The numbers of the floor. y: over the mean surface. albedo_m, light_m: after which albedo and patterns repeat.
    dry: irradiance above the water.
    """

    y: float
    albedo_m: float
    light_m: float
    dry: Vector


@compiled
def floor_radiance(
    f: Any, fn: Any, fk: Any, fe: Any, ground: Ground, x: float, z: float, footprint: float, dry: bool
) -> Vector:
    """Return the radiance of the floor at (x, z), averaged over a footprint [m]; dry: above the water."""
    albedo = _picture(f, fn, fk[0, 0], fk[0, 1], ground.albedo_m, x, z, footprint)
    light = ground.dry if dry else plane_light(f, fn, fk, fe, 0, ground.light_m, x, z, footprint)
    value = times(albedo, light)
    return value[0] / math.pi, value[1] / math.pi, value[2] / math.pi


@compiled
def plane_light(
    f: Any, fn: Any, fk: Any, fe: Any, plane: int, tile_m: float, x: float, z: float, footprint: float
) -> Vector:
    """Return the irradiance of one plane at (x, z)."""
    count = (fe.shape[1] - 3) // 2
    light = fe[plane, 0], fe[plane, 1], fe[plane, 2]
    for k in range(count):
        row, at = 1 + plane * count + k, 3 + 2 * k
        at_x, at_z = x - fe[plane, at], z - fe[plane, at + 1]
        light = add(light, _picture(f, fn, fk[row, 0], fk[row, 1], tile_m, at_x, at_z, footprint), 1.0)
    return light


@compiled
def _picture(f: Any, fn: Any, first: int, levels: int, tile_m: float, x: float, z: float, footprint: float) -> Vector:
    level = level_for(footprint, tile_m / fn[first, 1], levels - 1)
    return periodic(f, fn, first, levels, x / tile_m, z / tile_m, level)
