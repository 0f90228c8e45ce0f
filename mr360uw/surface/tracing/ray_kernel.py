# SPDX-License-Identifier: Apache-2.0
"""Rays that part at the surface, compiled: each hit sends one on by reflection and one by refraction, in water and air.

A ray and all that becomes of it are followed one after the other, the rest waiting in `stack`, a row for each: origin
and direction, weight of its radiance in the pixel's, width of its footprint, its growth per metre, the angle between
samples of facets, the key of its random numbers, the hits behind it, and its side, 1 in the air and -1 in the water.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mr360uw.jit import exact
from mr360uw.surface.intersection import NOWHERE, Hit, SeaWaves, first_hit
from mr360uw.surface.tracing.facet_draws import drawn, facets_of, next_key
from mr360uw.surface.tracing.floor_light import LitFloor, Relief, floor_radiance, relief_distance
from mr360uw.surface.tracing.ray_optics import Vector, bent, mirrored, reflectance
from mr360uw.surface.tracing.sun_in_waves import Disc, sun_seen, sunlight
from mr360uw.surface.tracing.table_reads import WaterTable, add, panorama, sky_radiance, times, transmittance, veil

_GONE = 1e-6
"""Share of the ripples' slopes below which they are not looked up."""


class Ripples(NamedTuple):
    """The numbers of the ripples of a sea. a, b: repeats of the two maps in a tile. ax, az, bx, bz: their scroll, in
    repeats. wave: [rad/m] of the dominant one. variance: of slope along each axis, 0 for none. blur: variance of slope
    along each axis of waves that are not drawn.
    """

    tile_m: float
    a: float
    b: float
    ax: float
    az: float
    bx: float
    bz: float
    wave: float
    variance: float
    blur: float


@exact
def level_slopes(lost: Any, blur: float, level: float) -> Vector:
    """Return `SampledSea.unresolved` of one level: the covariance xx, xz, zz of the slopes that it lacks."""
    lower = min(int(level), max(len(lost) - 2, 0))
    share = min(level - lower, 1.0)
    upper = min(lower + 1, len(lost) - 1)
    xx = lost[lower, 0] + share * (lost[upper, 0] - lost[lower, 0])
    xz = lost[lower, 1] + share * (lost[upper, 1] - lost[lower, 1])
    zz = lost[lower, 2] + share * (lost[upper, 2] - lost[lower, 2])
    return xx + blur, xz, zz + blur


@exact
def tilted(r: Any, ripples: Ripples, normal: Vector, x: float, z: float, sigma_m: float) -> tuple[Vector, float]:
    """Return a normal with the ripples' slopes at a rest position, and the slope variance along each axis of ripples
    that are smaller than a footprint. r: (size, size, 2) slopes of their map.

    Twin of the sum of slopes: caustics/sea/detail.py.
    """
    if ripples.variance <= 0.0:
        return normal, 0.0
    kept = math.exp(-0.5 * (ripples.wave * sigma_m) ** 2)
    gone = (1.0 - kept * kept) * ripples.variance
    if kept < _GONE:
        return normal, gone
    u, v = x / ripples.tile_m, z / ripples.tile_m
    first_x, first_z = _slope(r, ripples.a * u + ripples.ax, ripples.a * v + ripples.az)
    second_z, second_x = _slope(r, ripples.b * v + ripples.bz, ripples.b * u + ripples.bx)
    nx = normal[0] - normal[1] * kept * (first_x + second_x)
    nz = normal[2] - normal[1] * kept * (first_z + second_z)
    length = math.sqrt(nx * nx + normal[1] * normal[1] + nz * nz)
    return (nx / length, normal[1] / length, nz / length), gone


@exact
def _slope(r: Any, u: float, v: float) -> tuple[float, float]:
    """Return `caustics.sea.detail.periodic_slope` of one place."""
    size = r.shape[0]
    x, y = u * size, v * size
    column, row = math.floor(x), math.floor(y)
    i, j = int(column), int(row)
    i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
    fx, fy = x - column, y - row
    a, b, c, d = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        a * r[j0, i0, 0] + b * r[j0, i1, 0] + c * r[j1, i0, 0] + d * r[j1, i1, 0],
        a * r[j0, i0, 1] + b * r[j0, i1, 1] + c * r[j1, i0, 1] + d * r[j1, i1, 1],
    )


GENERATIONS = 8
"""Hits of a ray that are followed. With 4, a picture under waves of 15 m/s is the same; with 3 it is 4e-5 darker."""
FAINTEST = 1e-3
"""Fraction of a sample's radiance below which a ray is not followed further."""
FARTHEST_M = 1e5
"""Length [m] of the longest ray."""
WIDEST = 4.0
"""Most that a footprint's angle grows at a refraction, which is unbounded at the edge of Snell's window."""
OFF_M = 1e-6
"""Distance [m] along its direction that a ray starts from the surface."""
STACK = GENERATIONS + 2, 15
"""Rows and columns of the stack."""


class Murk(NamedTuple):
    """The numbers of the water. dims: whether it does. tables: for rays from the surface and from the camera. around:
    first texels, from the surface and from the camera, width and height of the maps that their veil is times, in the
    dome's array; no width: none.
    """

    dims: bool
    tables: tuple[WaterTable, WaterTable]
    around: tuple[int, int, int, int]


class RayWorld(NamedTuple):
    """The numbers of what rays can meet. samples: rays of one pixel, which take different facets."""

    sea: SeaWaves
    ripples: Ripples
    ground: LitFloor
    sun: Disc
    half_angle: float
    refractive_index: float
    samples: int
    murk: Murk


@exact
def met(
    c: Any, n: Any, h: Any, s: Any, m: Any, steepest: Any, e: Any, sea: SeaWaves, floor: Relief, origin: Vector,
    direction: Vector, side: float, width: float, spread: float, start: Hit, known: bool,
) -> tuple[Hit, float]:  # fmt: skip
    """Return where a ray meets the surface, and the distance at which it meets the floor instead, infinity for neither.

    c to steepest: of `first_hit`; e: of `floor_light`. start: the first, if it is known.
    """
    up, high = direction[1], origin[1] - floor.y
    reach = math.inf
    if up < 0.0 and (side < 0.0 or floor.y + floor.high > sea.lowest_m):
        reach = max((floor.low - high) / up, 0.0)
    if known:
        hit = start
    else:
        hit = first_hit(
            c, n, h, s, m, steepest, sea, origin, direction, side, width, spread, min(reach, FARTHEST_M)
        )  # fmt: skip
    if floor.low < floor.high and (reach < math.inf or (up >= 0.0 and high < floor.high)):
        reach = relief_distance(e, floor, origin, direction, min(hit.distance, reach, FARTHEST_M))
        if reach < hit.distance:
            return NOWHERE, reach
    return hit, math.inf if hit.distance < math.inf else reach


@exact
def through_water(
    d: Any, wv: Any, wa: Any, w: Murk, distance: float, v: Vector, first: bool
) -> tuple[Vector, Vector]:  # fmt: skip
    """Return transmittance and veil of a ray in the water from the camera (first) or from the surface."""
    table, up = w.tables[1 if first else 0], v[1]
    light = veil(wv, table, distance, up)
    if w.around[2] > 0:
        light = times(light, panorama(d, w.around[1] if first else w.around[0], w.around[2], w.around[3], v))
    if distance == math.inf:
        return (0.0, 0.0, 0.0), light
    return transmittance(wa, table, distance, up), light


@exact
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


@exact
def followed(
    c: Any, n: Any, h: Any, s: Any, m: Any, steepest: Any, lost: Any, r: Any, f: Any, fn: Any, fk: Any, fe: Any, e: Any,
    d: Any, dn: Any, wv: Any, wa: Any, w: RayWorld, stack: Any, start: Hit, known: bool,
) -> Vector:  # fmt: skip
    """Return the radiance of the ray in the first row of the stack times its weight.

    c to steepest: of `first_hit`. lost: (L, 3) of `SampledSea.lost_slope`; r: slopes of ripples; f to e: of
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
        hit, floor = met(
            c, n, h, s, m, steepest, e, w.sea, w.ground.relief, o, v, side, width, spread, start,
            known and generation == 0,
        )  # fmt: skip
        distance = min(hit.distance, floor)
        if in_water and w.murk.dims:
            passed, scattered = through_water(d, wv, wa, w.murk, distance, v, generation == 0)
            light = add(light, times(weight, scattered), 1.0)
            weight = times(weight, passed)
        if hit.distance < math.inf:
            glint, waiting = _part(
                lost, r, w.ripples, w.sun, w.refractive_index, w.samples, stack, waiting, o, v, weight, width, spread,
                lobe, key, generation, side, hit,
            )  # fmt: skip
            light = add(light, (weight[0] * w.sun.red, weight[1] * w.sun.green, weight[2] * w.sun.blue), glint)
        elif floor < math.inf:
            x, z = o[0] + floor * v[0], o[2] + floor * v[2]
            wide = (width + math.hypot(spread, lobe) * floor) / math.sqrt(max(-v[1], 1e-3))
            light = add(light, times(weight, floor_radiance(f, fn, fk, fe, e, w.ground, x, z, wide, not in_water)), 1.0)
        elif not in_water:
            light = add(light, times(weight, sky_radiance(d, dn, v[0], v[1], v[2], math.hypot(spread, lobe))), 1.0)
            if generation == 0 and w.sun.solid_angle > 0.0:
                seen = sun_seen(w.sun, w.half_angle, v[0], v[1], v[2], spread)
                light = add(light, (weight[0] * w.sun.red, weight[1] * w.sun.green, weight[2] * w.sun.blue), seen)
        elif not w.murk.dims:  # level rays in clear water: the floor and its mirror image, far away
            light = add(
                light, times(weight, floor_radiance(f, fn, fk, fe, e, w.ground, 0.0, 0.0, FARTHEST_M, False)), 1.0
            )
    return light


@exact
def _part(
    lost: Any, r: Any, ripples: Ripples, sun: Disc, index: float, samples: int, stack: Any, waiting: int, o: Vector,
    v: Vector, weight: Vector, width: float, spread: float, lobe: float, key: int, generation: int, side: float,
    hit: Hit,
) -> tuple[float, int]:  # fmt: skip
    """Add the reflected and the refracted ray of a hit to the stack; return the sun's light that comes back along the
    ray, over that of its disc, and the rows that wait then.
    """
    normal, rippled = tilted(r, ripples, hit.normal, hit.a, hit.b, hit.sigma_m)
    xx, xz, zz = level_slopes(lost, ripples.blur, hit.level)
    covariance = xx + rippled, xz, zz + rippled
    facets = facets_of(v, normal, covariance, side)
    glint = sunlight(sun, v, normal, facets, side, index) if sun.solid_angle > 0.0 else 0.0
    generation += 1
    brightest = samples * max(weight[0], weight[1], weight[2])
    if generation >= GENERATIONS or brightest <= FAINTEST:
        return glint, waiting
    if covariance[0] > 0.0 or covariance[2] > 0.0:
        normal = drawn(facets, key)
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    cosine = min(max(-(v[0] * nx + v[1] * ny + v[2] * nz), 0.0), 1.0)
    mx = index if side > 0.0 else 1.0 / index
    back, behind = reflectance(cosine, mx)
    t, wide = hit.distance, width + spread * hit.distance
    x, y, z = o[0] + t * v[0], o[1] + t * v[1], o[2] + t * v[2]
    apart = math.sqrt(max(covariance[0] + covariance[2], 0.0) / samples)  # slopes of neighbouring samples
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
