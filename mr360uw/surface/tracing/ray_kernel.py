# SPDX-License-Identifier: Apache-2.0
"""Rays that part at the surface, compiled: each hit sends one on by reflection and one by refraction, in water and air.

A ray and all that becomes of it are followed one after the other, the rest waiting in `stack`, a row for each: origin
and direction, weight of its radiance in the pixel's, width of its footprint, its growth per metre, the angle between
samples of facets, the key of its random numbers, the hits behind it, and its side, 1 in the air and -1 in the water.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.caustics.flux.compiled import compiled
from mr360uw.surface.intersection import Hit, Waves, first_hit
from mr360uw.surface.ray_tree import FAINTEST, FARTHEST_M, GENERATIONS, OFF_M, WIDEST
from mr360uw.surface.tracing.facet_draws import drawn, facets_of
from mr360uw.surface.tracing.floor_light import Ground, floor_radiance
from mr360uw.surface.tracing.random_keys import next_key
from mr360uw.surface.tracing.ray_optics import Vector, bent, mirrored, reflectance
from mr360uw.surface.tracing.ripples import Ripples, level_slopes, tilted
from mr360uw.surface.tracing.sun_in_waves import Disc, sun_seen, sunlight
from mr360uw.surface.tracing.table_reads import WaterTable, add, sky_radiance, times, transmittance, veil

STACK = GENERATIONS + 2, 15
"""Rows and columns of the stack."""


class World(NamedTuple):
    """The numbers of what rays can meet. samples: rays of one pixel, which take different facets. murky: whether the
    water dims light. sky, sun_light: its tables for rays from the surface, the next in the arrays for those from the
    camera; sky_below, sun_below: the irradiance that each is times.
    """

    sea: Waves
    ripples: Ripples
    ground: Ground
    sun: Disc
    half_angle: float
    refractive_index: float
    samples: int
    murky: bool
    sky: tuple[WaterTable, WaterTable]
    beam: tuple[WaterTable, WaterTable]
    sky_below: Vector
    beam_below: Vector


@compiled
def to_floor(w: World, origin: Vector, direction: Vector, side: float) -> float:
    """Return the distance of the floor along a ray if there were no surface, infinity for none."""
    if direction[1] >= 0.0 or (side > 0.0 and w.ground.y <= w.sea.lowest_m):
        return math.inf
    return max((w.ground.y - origin[1]) / direction[1], 0.0)


@compiled
def through_water(wv: Any, wa: Any, w: World, distance: float, up: float, first: bool) -> tuple[Vector, Vector]:
    """Return transmittance and veil of a ray in the water from the camera (first) or from the surface."""
    at = 1 if first else 0
    sky, sun = w.sky[at], w.beam[at]
    light = times(w.sky_below, veil(wv, sky, distance, up))
    if w.sun.solid_angle > 0.0:
        light = add(light, times(w.beam_below, veil(wv, sun, distance, up)), 1.0)
    if distance == math.inf:
        return (0.0, 0.0, 0.0), light
    return transmittance(wa, sky, distance, up), light


@compiled
def put(
    stack: Any, row: int, origin: Vector, direction: Vector, weight: Vector, footprint: Vector, key: int,
    generation: int, side: float,
) -> None:  # fmt: skip
    """Write a ray into a row of the stack. footprint: width, its growth per metre, angle between samples."""
    s = stack[row]
    s[0], s[1], s[2] = origin
    s[3], s[4], s[5] = direction
    s[6], s[7], s[8] = weight
    s[9], s[10], s[11] = footprint
    s[12], s[13], s[14] = key, generation, side


@compiled
def followed(
    c: Any, n: Any, h: Any, s: Any, m: Any, steepest: Any, lost: Any, r: Any, f: Any, fn: Any, fk: Any, fe: Any, d: Any,
    dn: Any, wv: Any, wa: Any, w: World, stack: Any, start: Hit, known: bool,
) -> Vector:  # fmt: skip
    """Return the radiance of the ray in the first row of the stack times its weight.

    c to steepest: of `first_hit`. lost: (L, 3) of `SampledSea.lost_slope`; r: slopes of ripples; f to fe: of
    `floor_radiance`; d, dn: texels and table of the dome; wv, wa: the water's veils and attenuations. start: what the
    ray meets first, if that is known.
    """
    waiting, light = 1, (0.0, 0.0, 0.0)
    while waiting > 0:
        waiting -= 1
        ray = stack[waiting]
        o, v, weight = (ray[0], ray[1], ray[2]), (ray[3], ray[4], ray[5]), (ray[6], ray[7], ray[8])
        width, spread, lobe, generation, side = ray[9], ray[10], ray[11], int(ray[13]), ray[14]
        key, in_water = int(ray[12]), side < 0.0
        floor = to_floor(w, o, v, side)
        if known and generation == 0:
            hit = start
        else:
            hit = first_hit(
                c, n, h, s, m, steepest, w.sea, o, v, side, width, spread, min(floor, FARTHEST_M)
            )  # fmt: skip
        distance = min(hit.distance, floor)
        if in_water and w.murky:
            passed, scattered = through_water(wv, wa, w, distance, v[1], generation == 0)
            light = add(light, times(weight, scattered), 1.0)
            weight = times(weight, passed)
        if hit.distance < math.inf:
            glint, waiting = _part(
                lost, r, w, stack, waiting, o, v, weight, width, spread, lobe, key, generation, side, hit
            )
            light = add(light, (weight[0] * w.sun.red, weight[1] * w.sun.green, weight[2] * w.sun.blue), glint)
        elif floor < math.inf:
            x, z = o[0] + floor * v[0], o[2] + floor * v[2]
            wide = (width + math.hypot(spread, lobe) * floor) / math.sqrt(max(-v[1], 1e-3))
            light = add(light, times(weight, floor_radiance(f, fn, fk, fe, w.ground, x, z, wide, not in_water)), 1.0)
        elif not in_water:
            light = add(light, times(weight, sky_radiance(d, dn, v[0], v[1], v[2], math.hypot(spread, lobe))), 1.0)
            if generation == 0 and w.sun.solid_angle > 0.0:
                seen = sun_seen(w.sun, w.half_angle, v[0], v[1], v[2], spread)
                light = add(light, (weight[0] * w.sun.red, weight[1] * w.sun.green, weight[2] * w.sun.blue), seen)
        elif not w.murky:  # level rays in clear water: the floor and its mirror image, far away
            light = add(light, times(weight, floor_radiance(f, fn, fk, fe, w.ground, 0.0, 0.0, FARTHEST_M, False)), 1.0)
    return light


@compiled
def _part(
    lost: Any, r: Any, w: World, stack: Any, waiting: int, o: Vector, v: Vector, weight: Vector, width: float,
    spread: float, lobe: float, key: int, generation: int, side: float, hit: Hit,
) -> tuple[float, int]:  # fmt: skip
    """Add the reflected and the refracted ray of a hit to the stack; return the sun's light that comes back along the
    ray, over that of its disc, and the rows that wait then.
    """
    normal, rippled = tilted(r, w.ripples, hit.normal, hit.a, hit.b, hit.sigma_m)
    xx, xz, zz = level_slopes(lost, w.ripples.blur, hit.level)
    covariance = xx + rippled, xz, zz + rippled
    facets = facets_of(v, normal, covariance, side)
    glint = sunlight(w.sun, v, normal, facets, side, w.refractive_index) if w.sun.solid_angle > 0.0 else 0.0
    generation += 1
    brightest = w.samples * max(weight[0], weight[1], weight[2])
    if generation >= GENERATIONS or brightest <= FAINTEST:
        return glint, waiting
    if covariance[0] > 0.0 or covariance[2] > 0.0:
        normal = drawn(facets, key)
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    cosine = min(max(-(v[0] * nx + v[1] * ny + v[2] * nz), 0.0), 1.0)
    mx = w.refractive_index if side > 0.0 else 1.0 / w.refractive_index
    back, behind = reflectance(cosine, mx)
    t, wide = hit.distance, width + spread * hit.distance
    x, y, z = o[0] + t * v[0], o[1] + t * v[1], o[2] + t * v[2]
    apart = math.sqrt(max(covariance[0] + covariance[2], 0.0) / w.samples)  # slopes of neighbouring samples
    if brightest * back > FAINTEST:
        to = mirrored(v[0], v[1], v[2], nx, ny, nz)
        at = x + OFF_M * to[0], y + OFF_M * to[1], z + OFF_M * to[2]
        share = weight[0] * back, weight[1] * back, weight[2] * back
        put(
            stack, waiting, at, to, share, (wide, spread, math.hypot(lobe, 2.0 * apart)), next_key(key, 1), generation,
            side,
        )  # fmt: skip
        waiting += 1
    on = (1.0 - back) / (mx * mx)
    if brightest * on > FAINTEST:
        to = bent(v[0], v[1], v[2], nx, ny, nz, 1.0 / mx)
        at = x + OFF_M * to[0], y + OFF_M * to[1], z + OFF_M * to[2]
        share = weight[0] * on, weight[1] * on, weight[2] * on
        flux = mx * mx * behind
        growth = min(math.sqrt(max(cosine, 1e-9) / flux), WIDEST) if flux > 0.0 else WIDEST
        put(
            stack, waiting, at, to, share, (wide, spread * growth, math.hypot(lobe, abs(1.0 - 1.0 / mx) * apart)),
            next_key(key, 2), generation, -side,
        )  # fmt: skip
        waiting += 1
    return glint, waiting
