# SPDX-License-Identifier: Apache-2.0
"""Radiance of the floor at one place: compiled.

f: (n, 3) texels of the albedo and of the light's patterns, each with its halves. fn: (k, 3) first texel, width and
height of every level of each. fk: (1 + p q, 2) first row of `fn` and number of levels of the albedo, then of the q
patterns of each of p planes. fe: (p, 4 + 3 q) of each plane: its depth and its even light, then the origin over (x, z)
of each pattern and whether the sun makes it. e: heights of `relief`.

A level floor has one plane. Between the planes of an uneven one light is interpolated, and every pattern followed along
its beam. A facet of it gets the sun's light times the cosine that it is lit at, over that of a level plane, and the
share (1 + n_y)/2 of the even light, that of an even sky over a slope.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.jit import exact
from mr360uw.surface.tracing.ray_optics import Vector
from mr360uw.surface.tracing.relief import Relief, in_shadow, relief_height, relief_slopes
from mr360uw.surface.tracing.table_reads import add, between, level_for, periodic, times


class LitFloor(NamedTuple):
    """The numbers of the floor. relief: its heights. albedo_m, light_m: after which albedo and patterns repeat.
    dry_sky, dry_sun: irradiance of a level plane above the water. sun_wet, sun_dry: directions to the sun in water and
    air.
    """

    relief: Relief
    albedo_m: float
    light_m: float
    dry_sky: Vector
    dry_sun: Vector
    sun_wet: Vector
    sun_dry: Vector


@exact
def floor_radiance(
    f: Any, fn: Any, fk: Any, fe: Any, e: Any, g: LitFloor, x: float, z: float, footprint: float, dry: bool
) -> Vector:
    """Return the radiance of the floor at (x, z), averaged over a footprint [m]; dry: above the water."""
    albedo = _picture(f, fn, fk[0, 0], fk[0, 1], g.albedo_m, x, z, footprint)
    r, sky, sun, depth = g.relief, 1.0, 1.0, -g.relief.y
    if r.low < r.high:
        to_sun = g.sun_dry if dry else g.sun_wet
        depth -= relief_height(e, r.tile_m, x, z)
        by_x, by_z = relief_slopes(e, r.tile_m, x, z, footprint)
        up = 1.0 / math.sqrt(1.0 + by_x * by_x + by_z * by_z)
        sky = 0.5 + 0.5 * up
        sun = max(up * (to_sun[1] - by_x * to_sun[0] - by_z * to_sun[2]) / to_sun[1], 0.0)
        if sun > 0.0 and in_shadow(e, r, x, z, to_sun):
            sun = 0.0
    if dry:
        light = add((0.0, 0.0, 0.0), g.dry_sky, sky)
        light = add(light, g.dry_sun, sun)
    else:
        lower, share = 0, 0.0
        while lower < len(fe) - 2 and fe[lower + 1, 0] < depth:
            lower += 1
        light = _plane_light(f, fn, fk, fe, lower, g.light_m, x, z, depth, footprint, sky, sun)
        if len(fe) > 1:
            share = min(max((depth - fe[lower, 0]) / (fe[lower + 1, 0] - fe[lower, 0]), 0.0), 1.0)
            below = _plane_light(f, fn, fk, fe, lower + 1, g.light_m, x, z, depth, footprint, sky, sun)
            light = between(light, below, share)
    value = times(albedo, light)
    return value[0] / math.pi, value[1] / math.pi, value[2] / math.pi


@exact
def _plane_light(
    f: Any, fn: Any, fk: Any, fe: Any, plane: int, tile_m: float, x: float, z: float, depth: float, footprint: float,
    sky: float, sun: float,
) -> Vector:  # fmt: skip
    """Return the irradiance by one plane at (x, z) and a depth; sky, sun: factors on even light and on the sun's."""
    count = (fe.shape[1] - 4) // 3
    light = sky * fe[plane, 1], sky * fe[plane, 2], sky * fe[plane, 3]
    along = depth / fe[plane, 0] if len(fe) > 1 else 1.0
    for k in range(count):
        row, at = 1 + plane * count + k, 4 + 3 * k
        share = sun if fe[plane, at + 2] > 0.0 else sky
        if share > 0.0:
            at_x, at_z = x - along * fe[plane, at], z - along * fe[plane, at + 1]
            light = add(light, _picture(f, fn, fk[row, 0], fk[row, 1], tile_m, at_x, at_z, footprint), share)
    return light


@exact
def _picture(f: Any, fn: Any, first: int, levels: int, tile_m: float, x: float, z: float, footprint: float) -> Vector:
    level = level_for(footprint, tile_m / fn[first, 1], levels - 1)
    return periodic(f, fn, first, levels, x / tile_m, z / tile_m, level)
