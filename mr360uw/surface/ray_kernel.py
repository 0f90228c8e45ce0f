# SPDX-License-Identifier: Apache-2.0
"""Rays that part at the surface, compiled: each hit sends one on by reflection and one by refraction, in water and air.

A ray and all that becomes of it are followed one after the other, the rest waiting in `stack`, a row for each: origin
and direction, weight of its radiance in the pixel's, width of its footprint, its growth per metre, the angle between
samples of facets, the key of its random numbers, the hits behind it, and its side, 1 in the air and -1 in the water.
What they can meet is a `RayStage`; the arrays and numbers of it that they read are a `RayWorld`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.optics import refract_to_water
from mr360uw.base.texels import Vector, add, four, packed, periodic_four, times
from mr360uw.jit import exact, inlined
from mr360uw.surface.facet_draws import Disc, drawn, facets_of, next_key, sun_seen, sunlight
from mr360uw.surface.intersection import NOWHERE, Hit, Ray, SeaWaves, bent, first_hit, mirrored, reflectance, waves_of
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import Floor, FloorIrradiance, LitFloor, Relief, floor_radiance, relief_distance
from mr360uw.surface.sky import Dome, panorama, sky_radiance
from mr360uw.surface.water_light import WaterLight, WaterTable, transmittance, veil
from mr360uw.types import Sun

_GONE = 1e-6
"""Share of the ripples' slopes below which they are not looked up."""


class Ripples(NamedTuple):
    """The ripples of a sea, and the slopes that its splines lack. a, b: repeats of the two maps in a tile. ax, az, bx,
    bz: their scroll, in repeats. wave: [rad/m] of the dominant one. variance: of slope along each axis, 0 for none.
    blur: variance of slope along each axis of waves that are not drawn. size, slopes: side of the ripples'
    map, a power of two, and its slopes and 0, (size size, 3). lost: (L, 3) of `SampledSea.lost_slope`.
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
    size: int
    slopes: Any
    lost: Any


@exact
def level_slopes(ripples: Ripples, level: float) -> Vector:
    """Return `SampledSea.unresolved` of one level: the covariance xx, xz, zz of the slopes that it lacks."""
    lost, blur = ripples.lost, ripples.blur
    lower = min(int(level), max(len(lost) - 2, 0))
    share = min(level - lower, 1.0)
    upper = min(lower + 1, len(lost) - 1)
    xx = lost[lower, 0] + share * (lost[upper, 0] - lost[lower, 0])
    xz = lost[lower, 1] + share * (lost[upper, 1] - lost[lower, 1])
    zz = lost[lower, 2] + share * (lost[upper, 2] - lost[lower, 2])
    return xx + blur, xz, zz + blur


@exact
def tilted(ripples: Ripples, normal: Vector, x: float, z: float, sigma_m: float) -> tuple[Vector, float]:
    """Return a normal with the ripples' slopes at a rest position, and the slope variance along each axis of ripples
    that are smaller than a footprint.

    Twin of the sum of slopes: caustics/sea.py.
    """
    if ripples.variance <= 0.0:
        return normal, 0.0
    kept = math.exp(-0.5 * (ripples.wave * sigma_m) ** 2)
    gone = (1.0 - kept * kept) * ripples.variance
    if kept < _GONE:
        return normal, gone
    u, v = x / ripples.tile_m, z / ripples.tile_m
    first_x, first_z, _ = _slope(ripples, ripples.a * u + ripples.ax, ripples.a * v + ripples.az)
    second_z, second_x, _ = _slope(ripples, ripples.b * v + ripples.bz, ripples.b * u + ripples.bx)
    nx = normal[0] - normal[1] * kept * (first_x + second_x)
    nz = normal[2] - normal[1] * kept * (first_z + second_z)
    length = math.sqrt(nx * nx + normal[1] * normal[1] + nz * nz)
    return (nx / length, normal[1] / length, nz / length), gone


@exact
def _slope(ripples: Ripples, u: float, v: float) -> Vector:
    """Return `caustics.sea.periodic_slope` of one place, and 0."""
    a, b, c, d, fx, fy = _periodic_four(0, ripples.size, u * ripples.size, v * ripples.size)
    return four(ripples.slopes, a, b, c, d, fx, fy)


_periodic_four = inlined(periodic_four)
_GENERATIONS = 8
"""Hits of a ray that are followed. With 4, a picture under waves of 15 m/s is the same; with 3 it is 4e-5 darker."""
FAINTEST = 1e-3
"""Fraction of a sample's radiance below which a ray is not followed further."""
FARTHEST_M = 1e5
"""Length [m] of the longest ray."""
WIDEST = 4.0
"""Most that a footprint's angle grows at a refraction, which is unbounded at the edge of Snell's window."""
OFF_M = 1e-6
"""Distance [m] along its direction that a ray starts from the surface."""
STACK = _GENERATIONS + 2, 15
"""Rows and columns of the stack."""


class Murk(NamedTuple):
    """The water. dims: whether it does. tables: for rays from the surface and from the camera. around: first texels,
    from the surface and from the camera, width and height of the maps that their veil is times, in the dome's array; no
    width: none. veils, attenuations: (t, U, T, 3) and (t, D, T, 3) of the tables.
    """

    dims: bool
    tables: tuple[WaterTable, WaterTable]
    around: tuple[int, int, int, int]
    veils: Any
    attenuations: Any


class RayWorld(NamedTuple):
    """Arrays of all that rays can meet. samples: rays of one pixel, which take different facets. dome, dome_levels:
    texels and table of the sky, as of `sky_radiance`.
    """

    sea: SeaWaves
    ripples: Ripples
    ground: LitFloor
    sun: Disc
    half_angle: float
    refractive_index: float
    samples: int
    murk: Murk
    dome: Any
    dome_levels: Any


@exact
def met(w: RayWorld, ray: Ray, start: Hit, known: bool) -> tuple[Hit, float]:
    """Return where a ray meets the surface, and the distance at which it meets the floor instead, infinity for neither.

    start: the first, if it is known.
    """
    floor, origin, direction = w.ground.relief, ray.origin, ray.direction
    up, high = direction[1], origin[1] - floor.y
    reach = math.inf
    if up < 0.0 and (ray.side < 0.0 or floor.y + floor.high > w.sea.lowest_m):
        reach = max((floor.low - high) / up, 0.0)
    hit = start if known else first_hit(w.sea, ray, min(reach, FARTHEST_M))
    if floor.low < floor.high and (reach < math.inf or (up >= 0.0 and high < floor.high)):
        reach = relief_distance(floor, origin, direction, min(hit.distance, reach, FARTHEST_M))
        if reach < hit.distance:
            return NOWHERE, reach
    return hit, math.inf if hit.distance < math.inf else reach


@exact
def _through_water(w: RayWorld, distance: float, v: Vector, first: bool) -> tuple[Vector, Vector]:
    """Return transmittance and veil of a ray in the water from the camera (first) or from the surface."""
    m, up = w.murk, v[1]
    table = m.tables[1 if first else 0]
    light = veil(m.veils, table, distance, up)
    if m.around[2] > 0:
        light = times(light, panorama(w.dome, m.around[1] if first else m.around[0], m.around[2], m.around[3], v))
    if distance == math.inf:
        return (0.0, 0.0, 0.0), light
    return transmittance(m.attenuations, table, distance, up), light


@exact
def put(stack: Any, row: int, ray: Ray, weight: Vector, lobe: float, key: int, generation: int) -> None:
    """Write a ray into a row of the stack. lobe: angle between samples of facets. generation: hits behind it."""
    s = stack[row]
    s[0], s[1], s[2] = ray.origin
    s[3], s[4], s[5] = ray.direction
    s[6], s[7], s[8] = weight
    s[9], s[10], s[11] = ray.width, ray.spread, lobe
    s[12], s[13], s[14] = key, generation, ray.side


@exact
def followed(w: RayWorld, stack: Any, start: Hit, known: bool) -> Vector:
    """Return the radiance of the ray in the first row of the stack times its weight.

    start: what the ray meets first, if that is known.
    """
    waiting, light = 1, (0.0, 0.0, 0.0)
    while waiting > 0:
        waiting -= 1
        row = stack[waiting]
        o, v, weight = (row[0], row[1], row[2]), (row[3], row[4], row[5]), (row[6], row[7], row[8])
        width, spread, lobe, generation, side = row[9], row[10], row[11], int(row[13]), row[14]
        in_water = side < 0.0
        ray = Ray(o, v, side, width, spread)
        hit, floor = met(w, ray, start, known and generation == 0)
        distance = min(hit.distance, floor)
        if in_water and w.murk.dims:
            passed, scattered = _through_water(w, distance, v, generation == 0)
            light = add(light, times(weight, scattered), 1.0)
            weight = times(weight, passed)
        if hit.distance < math.inf:
            glint, waiting = _part(w, stack, waiting, ray, weight, hit)
            light = add(light, (weight[0] * w.sun.red, weight[1] * w.sun.green, weight[2] * w.sun.blue), glint)
        elif floor < math.inf:
            x, z = o[0] + floor * v[0], o[2] + floor * v[2]
            wide = (width + math.hypot(spread, lobe) * floor) / math.sqrt(max(-v[1], 1e-3))
            light = add(light, times(weight, floor_radiance(w.ground, x, z, wide, not in_water)), 1.0)
        elif not in_water:
            sky = sky_radiance(w.dome, w.dome_levels, v[0], v[1], v[2], math.hypot(spread, lobe))
            light = add(light, times(weight, sky), 1.0)
            if generation == 0 and w.sun.solid_angle > 0.0:
                seen = sun_seen(w.sun, w.half_angle, v[0], v[1], v[2], spread)
                light = add(light, (weight[0] * w.sun.red, weight[1] * w.sun.green, weight[2] * w.sun.blue), seen)
        elif not w.murk.dims:  # level rays in clear water: the floor and its mirror image, far away
            light = add(light, times(weight, floor_radiance(w.ground, 0.0, 0.0, FARTHEST_M, False)), 1.0)
    return light


@exact
def _part(w: RayWorld, stack: Any, waiting: int, ray: Ray, weight: Vector, hit: Hit) -> tuple[float, int]:
    """Put the reflected and the refracted ray of a hit in the place of their ray, the first row that does not wait;
    return the sun's light that comes back along the ray, over that of its disc, and the rows that wait then.
    """
    row, (o, v, side, width, spread) = stack[waiting], ray
    lobe, key, generation = row[11], int(row[12]), int(row[13]) + 1
    sun, index = w.sun, w.refractive_index
    normal, rippled = tilted(w.ripples, hit.normal, hit.a, hit.b, hit.sigma_m)
    xx, xz, zz = level_slopes(w.ripples, hit.level)
    covariance = xx + rippled, xz, zz + rippled
    facets = facets_of(v, normal, covariance, side)
    glint = sunlight(sun, v, normal, facets, side, index) if sun.solid_angle > 0.0 else 0.0
    brightest = w.samples * max(weight[0], weight[1], weight[2])
    if generation >= _GENERATIONS or brightest <= FAINTEST:
        return glint, waiting
    if covariance[0] > 0.0 or covariance[2] > 0.0:
        normal = drawn(facets, key)
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    cosine = min(max(-(v[0] * nx + v[1] * ny + v[2] * nz), 0.0), 1.0)
    mx = index if side > 0.0 else 1.0 / index
    back, behind = reflectance(cosine, mx)
    t, wide = hit.distance, width + spread * hit.distance
    x, y, z = o[0] + t * v[0], o[1] + t * v[1], o[2] + t * v[2]
    apart = math.sqrt(max(covariance[0] + covariance[2], 0.0) / w.samples)  # slopes of neighbouring samples
    if brightest * back > FAINTEST:
        to = mirrored(v[0], v[1], v[2], nx, ny, nz)
        at = x + OFF_M * to[0], y + OFF_M * to[1], z + OFF_M * to[2]
        share = weight[0] * back, weight[1] * back, weight[2] * back
        sent = Ray(at, to, side, wide, spread)
        put(stack, waiting, sent, share, math.hypot(lobe, 2.0 * apart), next_key(key, 1), generation)
        waiting += 1
    on = (1.0 - back) / (mx * mx)
    if brightest * on > FAINTEST:
        to = bent(v[0], v[1], v[2], nx, ny, nz, 1.0 / mx)
        at = x + OFF_M * to[0], y + OFF_M * to[1], z + OFF_M * to[2]
        share = weight[0] * on, weight[1] * on, weight[2] * on
        flux = mx * mx * behind
        growth = min(math.sqrt(max(cosine, 1e-9) / flux), WIDEST) if flux > 0.0 else WIDEST
        sent, turned = Ray(at, to, -side, wide, spread * growth), math.hypot(lobe, abs(1.0 - 1.0 / mx) * apart)
        put(stack, waiting, sent, share, turned, next_key(key, 2), generation)
        waiting += 1
    return glint, waiting


@dataclass(frozen=True, slots=True, eq=False)
class RayStage:
    """Objects that rays can meet. samples: rays of one pixel, which take different facets.

    floor_y_m: over the mean surface. planes: depths of planes at the floor and the light there, one for a level floor.
    camera_in_water: on which side of the waves the camera is.
    """

    sea: SampledSea
    dome: Dome
    floor: Floor
    floor_y_m: float
    planes: tuple[tuple[float, FloorIrradiance], ...]
    water: WaterLight
    sun: Sun | None
    refractive_index: float
    samples: int
    camera_in_water: bool

    @property
    def floor_light(self) -> FloorIrradiance:
        """The light at the floor's mean height, or at its highest plane."""
        return self.planes[0][1]


def ray_world(stage: RayStage) -> RayWorld:
    """Return what compiled rays read of a stage."""
    disc, half_angle = disc_of(stage.sun)
    murk = _water(stage.water)
    texels, levels = packed([level[None] for level in stage.dome.levels])
    maps = stage.water.sun_maps
    if maps:
        first, size = len(texels), maps[0].shape[0] * maps[0].shape[1]
        murk = murk._replace(around=(first, first + size * (len(maps) - 1), maps[0].shape[1], maps[0].shape[0]))
        texels = np.concatenate([texels, *(around.reshape(-1, 3) for around in maps)])
    return RayWorld(
        waves_of(stage.sea), ripples_of(stage.sea), _ground(stage), disc, half_angle, stage.refractive_index,
        stage.samples, murk, texels, levels,
    )  # fmt: skip


def ripples_of(sea: SampledSea) -> Ripples:
    """Return the ripples of a sea, and the slopes that its splines lack."""
    detail, lost = sea.detail, sea.lost_slope
    if detail is None:
        none = np.zeros((1, 3))
        return Ripples(sea.tile_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, sea.blur_variance, 1, none, lost)
    (a, b), ((ax, az), (bx, bz)) = detail.repeats.tolist(), detail.offset.tolist()
    wave, variance, size = sea.ripple_wave, sea.ripple_variance, len(detail.slopes)
    slopes = np.pad(detail.slopes.reshape(-1, 2), ((0, 0), (0, 1)))
    return Ripples(detail.tile_m, a, b, ax, az, bx, bz, wave, variance, sea.blur_variance, size, slopes, lost)


def _ground(stage: RayStage) -> LitFloor:
    floor, sea = stage.floor, stage.sea
    planes = [(depth, light.even, _merged(light)) for depth, light in stage.planes]
    pictures = [floor.image.levels, *(levels for _, _, patterns in planes for _, levels in patterns)]
    texels, table = packed([level for levels in pictures for level in levels])
    counts = np.array([len(levels) for levels in pictures])
    rows = np.stack([np.cumsum(counts) - counts, counts], axis=-1)
    even = np.array([[depth, *even, *(v for place, _ in patterns for v in place)] for depth, even, patterns in planes])
    dry, dry_sun = stage.floor_light.dry, stage.floor_light.dry_sun
    wet, air = (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)
    if stage.sun is not None and stage.sun.direction[1] > 0.0:
        wet = tuple(refract_to_water(stage.sun.direction, stage.refractive_index).tolist())
        air = tuple(stage.sun.direction.tolist())
    below = _BELOW * (floor.highest_m - floor.lowest_m)
    relief = Relief(
        floor.tile_m, stage.floor_y_m, floor.lowest_m - below, floor.highest_m, floor.steepest, floor.relief,
        floor.cells,
    )  # fmt: skip
    sky, sun = tuple((dry - dry_sun).tolist()), tuple(dry_sun.tolist())
    return LitFloor(relief, floor.image.tile_m, sea.tile_m, sky, sun, wet, air, texels, table, rows, even)


def _merged(light: FloorIrradiance) -> list[tuple[tuple[float, float, float], list[NDArray[Any]]]]:
    """Return origin, whether it is the sun's, and levels of the patterns times their factors; those of one place, kind
    and size are one."""
    sums: dict[tuple[float, float, float, int], list[NDArray[Any]]] = {}
    for k, (tiled, factor) in enumerate(light.patterns):
        lit = [level * factor for level in tiled.levels]
        key = (*tiled.origin, float(k >= light.skies), len(lit))
        sums[key] = [a + b for a, b in zip(sums[key], lit, strict=True)] if key in sums else lit
    return [(key[:3], levels) for key, levels in sums.items()]


def disc_of(sun: Sun | None) -> tuple[Disc, float]:
    """Return the sun and its angular radius."""
    if sun is None or sun.direction[1] <= 0.0:
        return Disc(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0), 0.0
    solid_angle = 2.0 * math.pi * (1.0 - math.cos(sun.half_angle_rad))
    (x, y, z), (red, green, blue) = sun.direction.tolist(), (sun.irradiance / solid_angle).tolist()
    half = float(sun.half_angle_rad)
    return Disc(x, y, z, math.cos(half), solid_angle, red, green, blue), half


_BELOW = 1e-6
"""Distance below an uneven floor of a plane above which all rays down have met it, over the floor's height."""
_DRY = WaterTable(0, 1.0, 1.0)


def _water(water: WaterLight) -> Murk:
    if water.sky is None:
        nothing = np.zeros((1, 2, 2, 3), np.float32)
        return Murk(False, (_DRY, _DRY), (0, 0, 0, 0), nothing, nothing)
    tables = [water.table(from_camera) for from_camera in (False, True)]
    veils, attenuations = (
        np.stack([getattr(table, name) for table in tables]).astype(np.float32) for name in ("veil", "attenuation")
    )
    surface, camera = (WaterTable(k, float(t.length_m), float(t.camera_depth_m)) for k, t in enumerate(tables))
    return Murk(True, (surface, camera), (0, 0, 0, 0), veils, attenuations)
