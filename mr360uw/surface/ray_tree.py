# SPDX-License-Identifier: Apache-2.0
"""Rays that part at the surface: each hit sends one on by reflection and one by refraction, in water and in air."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import fresnel, reflect, refract_clamped, solid_angle_change
from mr360uw.surface.intersection import SurfaceHits, first_hits
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import Floor, FloorLight
from mr360uw.surface.sky import Dome
from mr360uw.surface.slopes import Facets, next_keys
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Sun

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

GENERATIONS = 8
"""Hits of a ray that are followed. With 4, a picture under waves of 15 m/s is the same; with 3 it is 4e-5 darker."""
FAINTEST = 1e-3
"""Fraction of a sample's radiance below which a ray is not followed further."""
FARTHEST_M = 1e5
"""Length [m] of the longest ray."""
_WIDEST = 4.0
"""Most that a footprint's angle grows at a refraction, which is unbounded at the edge of Snell's window."""
_OFF_M = 1e-6
"""Distance [m] along its direction that a ray starts from the surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """n rays. pixel: (n,) index of the sample. key: (n,) of its random numbers. origin: (n, 3) [m], y over the mean
    surface. direction: (n, 3). weight: (n, 3) of its radiance in the pixel's. width_m, spread: (n,) of the footprint,
    and its growth per metre. lobe_rad: (n,) angle between the samples of facets.
    """

    pixel: Indices
    key: NDArray[np.uint32]
    origin: Array
    direction: Array
    weight: Array
    width_m: Array
    spread: Array
    lobe_rad: Array

    def of(self, kept: NDArray[np.bool_] | Indices) -> Rays:
        """Return a part of the rays."""
        return Rays(*(getattr(self, name)[kept] for name in self.__slots__))

    def joined(self, other: Rays) -> Rays:
        """Return the rays of both."""
        return Rays(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.__slots__))

    def bright(self, samples: int) -> Rays:
        """Return the rays that are followed, of pixels of so many samples."""
        return self.of(samples * self.weight.max(axis=1, initial=0.0) > FAINTEST)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """What rays can meet. samples: rays of one pixel, which take different facets. floor_y_m: over the mean surface.
    camera_in_water: on which side of the waves the camera is.
    """

    sea: SampledSea
    dome: Dome
    floor: Floor
    floor_y_m: float
    floor_light: FloorLight
    water: WaterLight
    sun: Sun | None
    refractive_index: float
    samples: int
    camera_in_water: bool


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """What rays met first. distance: (n,) [m], infinity for the sky. normal: (n, 3) of the surface, zero elsewhere.
    surface, floor: (n,) masks.
    """

    distance: Array
    normal: Array
    surface: NDArray[np.bool_]
    floor: NDArray[np.bool_]


def meet(stage: Stage, rays: Rays, in_water: bool) -> tuple[Met, SurfaceHits]:
    """Return what rays meet first: the surface, the floor or neither."""
    up = rays.direction[:, 1]
    to_floor = np.full(len(up), np.inf)
    reachable = in_water or stage.floor_y_m > stage.sea.lowest_m
    np.divide(stage.floor_y_m - rays.origin[:, 1], up, out=to_floor, where=(up < 0.0) & reachable)
    to_floor = np.maximum(to_floor, 0.0)
    hits = first_hits(
        stage.sea, rays.origin, rays.direction, in_water, rays.width_m, rays.spread, np.minimum(to_floor, FARTHEST_M)
    )
    surface = np.isfinite(hits.distance)
    floor = ~surface & np.isfinite(to_floor)
    return Met(np.where(surface, hits.distance, to_floor), hits.normal, surface, floor), hits


def refracted_distance(stage: Stage, rays: Rays, hits: SurfaceHits) -> Array:
    """Return the length (n,) [m] in the water of rays from the air, up to the floor; 0 where they do not meet it."""
    wet = np.flatnonzero(np.isfinite(hits.distance))
    seen = rays.of(wet)
    point = seen.origin + hits.distance[wet, None] * seen.direction
    bent = refract_clamped(seen.direction, hits.normal[wet], 1.0 / stage.refractive_index)
    on = replace(seen, origin=point + _OFF_M * bent, direction=np.ascontiguousarray(bent, np.float64))
    length = np.zeros(len(rays.pixel))
    length[wet] = meet(stage, on, True)[0].distance
    return length


def trace(stage: Stage, rays: Rays, count: int) -> Array:
    """Return the radiance (count, 3) of `count` pixels: the sum over their rays, which all start on one side."""
    image = np.zeros((count, 3))
    nothing = rays.of(np.zeros(0, np.int64))
    water, air = (rays, nothing) if stage.camera_in_water else (nothing, rays)
    for generation in range(GENERATIONS):
        if not len(water.pixel) and not len(air.pixel):
            break
        below = _in_water(stage, water, image, generation == 0) if len(water.pixel) else (nothing, nothing)
        above = _in_air(stage, air, image, generation == 0) if len(air.pixel) else (nothing, nothing)
        water, air = (a.joined(b).bright(stage.samples) for a, b in zip(below, above, strict=True))
    return image


def _in_water(stage: Stage, rays: Rays, image: Array, first: bool) -> tuple[Rays, Rays]:
    """Add what rays in the water bring to `image`; return those that go on in water and in air."""
    met, hits = meet(stage, rays, True)
    passed, veil = stage.water.along(met.distance, rays.direction[:, 1], first)
    _add(image, rays.pixel, rays.weight * veil)
    rays = replace(rays, weight=rays.weight * passed)
    _floor(stage, rays, met, met.floor, image, dry=False)
    lost = ~met.surface & ~met.floor
    if np.any(lost) and stage.water.sky is None:  # level rays in clear water: the floor and its mirror image, far away
        far = np.zeros(3)
        light = stage.floor_light.radiance(stage.floor, far[:1], far[:1], np.array([FARTHEST_M]), False)
        _add(image, rays.pixel[lost], rays.weight[lost] * light)
    return _part(stage, rays, hits, met.surface, image, from_below=True)


def _in_air(stage: Stage, rays: Rays, image: Array, first: bool) -> tuple[Rays, Rays]:
    """Add what rays in the air bring to `image`; return those that go on in water and in air."""
    met, hits = meet(stage, rays, False)
    _floor(stage, rays, met, met.floor, image, dry=True)
    sky = rays.of(~met.surface & ~met.floor)
    _add(image, sky.pixel, sky.weight * stage.dome.look(sky.direction, np.hypot(sky.spread, sky.lobe_rad)))
    if first and stage.sun is not None:
        _add(image, sky.pixel, sky.weight * _sun_disc(stage.sun, sky))
    going_up, down = _part(stage, rays, hits, met.surface, image, from_below=False)
    return down, going_up


def _sun_disc(sun: Sun, sky: Rays) -> Array:
    """Return the radiance (n, 3) of the sun that rays see without the sea; wide footprints see it wider and dimmer."""
    seen = np.maximum(np.minimum(sky.spread / np.sqrt(np.pi), 1.0), sun.half_angle_rad)
    inside = sky.direction @ sun.direction > np.cos(seen)
    return np.where(inside, 1.0 / (2.0 * np.pi * (1.0 - np.cos(seen))), 0.0)[:, None] * sun.irradiance


def _floor(stage: Stage, rays: Rays, met: Met, kept: NDArray[np.bool_], image: Array, dry: bool) -> None:
    """Add the floor that rays meet."""
    seen, distance = rays.of(kept), met.distance[kept]
    at = seen.origin + distance[:, None] * seen.direction
    width = (seen.width_m + np.hypot(seen.spread, seen.lobe_rad) * distance) / np.sqrt(
        np.maximum(-seen.direction[:, 1], 1e-3)
    )
    light = stage.floor_light.radiance(stage.floor, at[:, 0], at[:, 2], width, dry)
    _add(image, seen.pixel, seen.weight * light)


def _part(
    stage: Stage, rays: Rays, hits: SurfaceHits, met: NDArray[np.bool_], image: Array, from_below: bool
) -> tuple[Rays, Rays]:
    """Return the reflected and the refracted rays of those that meet the surface; add the sun's glitter."""
    rays, distance, sigma = rays.of(met), hits.distance[met], hits.sigma_m[met]
    d, n = rays.direction, stage.refractive_index
    point = rays.origin + distance[:, None] * d
    normal, rippled = stage.sea.with_ripples(hits.normal[met], hits.rest[met], sigma)
    lost = stage.sea.unresolved(hits.level[met]) + rippled[:, None] * np.array([1.0, 0.0, 1.0])
    facets = Facets(d, normal, lost, from_below)
    if stage.sun is not None and stage.sun.direction[1] > 0.0:
        _add(image, rays.pixel, rays.weight * facets.sunlight(stage.sun, n))
    if np.any(lost > 0.0):
        normal = facets.drawn(rays.key)
    against = normal if not from_below else -normal  # towards where the ray comes from
    cosine = np.clip(-np.sum(d * against, axis=-1), 0.0, 1.0)
    m = 1.0 / n if from_below else n
    reflected = fresnel(cosine, m)
    width = rays.width_m + rays.spread * distance
    apart = np.sqrt(np.maximum(lost[:, 0] + lost[:, 2], 0.0) / stage.samples)  # slopes of neighbouring samples
    mirrored = reflect(d, against)
    back = replace(
        rays, key=next_keys(rays.key, 1), origin=point + _OFF_M * mirrored, direction=mirrored, width_m=width,
        weight=rays.weight * reflected[:, None], lobe_rad=np.hypot(rays.lobe_rad, 2.0 * apart),
    )  # fmt: skip
    bent = refract_clamped(d, against, 1.0 / m).astype(np.float64, copy=False)
    bent /= np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-12)
    growth = np.minimum(np.sqrt(solid_angle_change(np.maximum(cosine, 1e-9), m)), _WIDEST)
    through = replace(
        rays, key=next_keys(rays.key, 2), origin=point + _OFF_M * bent, direction=bent, width_m=width,
        spread=rays.spread * growth, lobe_rad=np.hypot(rays.lobe_rad, abs(1.0 - 1.0 / m) * apart),
        weight=rays.weight * ((1.0 - reflected) / m**2)[:, None],
    )  # fmt: skip
    return back, through


def _add(image: Array, pixel: Indices, light: Array) -> None:
    """Add light (n, 3) to pixels (n,) of an image (count, 3)."""
    for c in range(3):
        image[:, c] += np.bincount(pixel, weights=light[:, c], minlength=len(image))
