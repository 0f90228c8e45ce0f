# SPDX-License-Identifier: Apache-2.0
"""Water between surface, floor and camera: what it takes of a ray, what it adds, and the light that reaches the floor.

The veil and the diffuse light are those of the solved field under a flat surface and over a level floor, for the sky
and for the sun, times the irradiance that each brings just below the surface, and for the floor, times its radiance L:

    L = albedo/pi (E + L e)

E: irradiance of the floor by sky and sun over a black floor; e: what a floor of radiance 1 gets back from the water and
from the surface. In clear water, and in that of closed forms, e is pi times `optics.diffuse_reflectance_from_below`.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2

from mr360uw.base.cache import shared
from mr360uw.base.constants import JUST_BELOW_M, PI
from mr360uw.base.optics import diffuse_reflectance_from_below, refract_to_water
from mr360uw.base.texels import Vector, add, between_four, four, packed, periodic_four
from mr360uw.caustics import CausticSettings, caustic_map, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.caustics.sun_disc import gaussian_transform
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.jit import exact, inlined
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import beam_fraction, linear, transmittance_lookup, veil_lookup
from mr360uw.medium.medium import MediumAtDepths
from mr360uw.medium.models import mean_rates
from mr360uw.medium.open_water import row_up
from mr360uw.medium.scattered_light import around_sun, placed, spread_of
from mr360uw.surface.facet_draws import normal_quantile
from mr360uw.surface.intersection import bent, reflectance
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import FloorIrradiance, Tiled
from mr360uw.surface.sky import Dome, sky_radiance, sun_below
from mr360uw.types import Array, CausticStack, Floats, MediumTable, Sun

_LEAST = 1e-300


class SolvedWater:
    """Light of one origin. below: (3,) irradiance just below the surface. medium: solved for it, seen from there.
    depths: the same for cameras at any depth.
    """

    def __init__(self, below: Array, medium: Medium) -> None:
        self.below, self.medium, self.depths = below, medium, MediumAtDepths(medium)

    def seen_from(self, camera_depth_m: float | None) -> Medium:
        """Return the medium for a camera at a depth [m], or for rays from the surface."""
        return self.medium if camera_depth_m is None else self.depths.at(camera_depth_m)

    def down(self, depth_m: float) -> Array:
        """Return the irradiance (3,) on a level plane at a depth."""
        return self.below * self.medium.light.display(self.medium.model.irradiance(depth_m, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class WaterLight:
    """Water for rays. below: (3,) irradiance just below a level surface by sky and sun. sky, sun: light of each in the
    water; none for clear water, and no sun at night. sun_up: y of the sun's direction in the water. index: of
    refraction. floor_m: depth [m] of a level floor below the mean surface; floor: (3,) radiance it sends up in all
    directions, None where it is not below the surface.

    from_surface, from_camera: tables of the water for rays that start there, with the veil of all this light, and how
    it varies about the sun (`plate_ratio`); those of the surface stand for the camera's where the camera is above the
    water. towards_sun: (3,) in the water, None at night.
    """

    below: Array
    sky: SolvedWater | None
    sun: SolvedWater | None
    sun_up: float
    index: float
    floor_m: float = 0.0
    floor: Array | None = None
    from_surface: MediumTable | None = None
    from_camera: MediumTable | None = None
    towards_sun: Array | None = None

    @classmethod
    def of(
        cls, water: Water | Medium | None, dome: Dome, sun: Sun | None, index: float, floor_m: float, albedo: Array
    ) -> WaterLight:
        """Return the water of a scene for a camera above it. water: as of `SeaScene`; a medium's gain and camera are
        not read. floor_m: depth of the floor [m], albedo: (3,) its mean; from 0 up it stands out of the water.
        """
        risen = sun is not None and sun.direction[1] > 0.0
        towards_sun = refract_to_water(sun.direction, index) if sun is not None and risen else None
        sun_up = 1.0 if towards_sun is None else float(towards_sun[1])
        by_sky, by_sun = dome.irradiance_below(index), sun_below(sun, index)
        light = cls(by_sky + by_sun, None, None, sun_up, index, towards_sun=towards_sun)
        if water is not None:
            given = water if isinstance(water, Medium) else Medium(water, refractive_index=index)
            medium = Medium(
                given.water, given.sensor, given.mode, JUST_BELOW_M, illuminant=given.illuminant,
                refractive_index=index, formation=given.formation, floor_m=floor_m if floor_m > 0.0 else None,
                sky=dome.shape,
            )  # fmt: skip
            _ = medium.length_m  # that of all tables, so that their nodes are the same
            of_sky = SolvedWater(by_sky, medium)
            beam = medium.under(("sun", sun_up, 1.0)) if risen else None
            light = replace(light, sky=of_sky, sun=None if beam is None else SolvedWater(by_sun, beam))
        if floor_m > 0.0:
            lit, back = light.down(floor_m), light._returned(floor_m, floor_m)
            light = replace(light, floor_m=floor_m, floor=albedo * lit / (PI - albedo * back))
        return light if light.sky is None else replace(light, from_surface=light._table(None))

    def seen_from(self, camera_depth_m: float) -> WaterLight:
        """Return the water for a camera at a depth [m], > 0."""
        return self if self.sky is None else replace(self, from_camera=self._table(camera_depth_m))

    def table(self, from_camera: bool) -> MediumTable:
        """Return the table for rays of the camera, or of the surface."""
        table = self.from_surface if self.from_camera is None or not from_camera else self.from_camera
        assert table is not None
        return table

    def down(self, depth_m: float) -> Array:
        """Return the irradiance (3,) on a level plane at a depth, with what the floor sends up and gets back."""
        if self.sky is None:
            return self.below + self.returned(depth_m)
        of_sun = np.zeros(3) if self.sun is None else self.sun.down(depth_m)
        return self.sky.down(depth_m) + of_sun + self.returned(depth_m)

    def returned(self, depth_m: float) -> Array:
        """Return the irradiance (3,) on a level plane at a depth by light of the floor that comes back down."""
        return np.zeros(3) if self.floor is None else self.floor * self._returned(depth_m, self.floor_m)

    def along(self, distance_m: Array, up: Array, from_camera: bool) -> tuple[Array, Array]:
        """Return transmittance and veil (n, 3) of rays (n,) from the camera or from the surface; `up`: y of their
        directions. Distances may be infinite. The veil is a mean over the azimuth.
        """
        if self.sky is None:
            return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))
        table, finite = self.table(from_camera), np.isfinite(distance_m)
        passed = transmittance_lookup(table, np.where(finite, distance_m, 0.0), up)
        return np.where(finite[:, None], passed, 0.0), np.asarray(veil_lookup(table, distance_m, up), np.float64)

    @property
    def sun_maps(self) -> tuple[Floats, ...]:
        """Maps (H, W, 3) by which the veil varies about the sun: from the surface, and from a camera in the water."""
        tables = (self.from_surface, self.from_camera)
        return tuple(t.plate_ratio for t in tables if t is not None and t.plate_ratio is not None)

    def about_sun(self, direction: Floats) -> Array:
        """Return the factors (..., 3) on the veil of rays from the surface by their directions (..., 3)."""
        if not self.sun_maps:
            return np.ones(3)
        return np.asarray(environment_lookup(self.sun_maps[0], direction))

    def _returned(self, depth_m: float, floor_m: float) -> Array:
        """Return what a floor of radiance 1 gets back (3,) at a depth, from the water and from the surface."""
        if self.sky is not None and self.sky.medium.floor_m is not None:
            return self.sky.medium.floor_irradiance(min(depth_m, floor_m))
        tau = np.zeros(3)
        if self.sky is not None:
            # all of the way up and down again; a ray that pointed up would end at the surface
            tau = -np.log(np.maximum(self.sky.medium.transmittance(floor_m + depth_m, floor_m, 0.0), _LEAST))
        return np.asarray(PI * diffuse_reflectance_from_below(self.index, tau))

    def _table(self, camera_depth_m: float | None) -> MediumTable:
        """Return the table of a camera at a depth, or of the surface, with the veil of sky, sun and floor."""
        assert self.sky is not None
        sky = self.sky.seen_from(camera_depth_m)
        table = sky.unit_table
        veil = self.sky.below * table.veil
        if self.floor is not None and table.glow is not None:
            veil = veil + self.floor * (table.glow + sky.glow_level * table.veil)
        if self.sun is None or self.towards_sun is None:
            return replace(table, veil=veil, glow=None)
        sun = self.sun.seen_from(camera_depth_m)
        of_sun = self.sun.below * sun.unit_table.veil
        veil, around = veil + of_sun, around_sun(sun)
        if around is None:
            return replace(table, veil=veil, glow=None)
        rows = 0.5 + 0.5 * row_up(len(around))
        share = linear(of_sun[:, -1] / np.maximum(veil[:, -1], _LEAST), rows)[:, None]  # of long ways
        ratio = 1.0 + share * (placed(around, self.towards_sun) - 1.0)
        return replace(table, veil=veil, glow=None, plate_ratio=ratio.astype(np.float32))

    def on_floor(
        self, sea: Sea, sampled: SampledSea, dome: Dome, sun: Sun | None, depth_m: float, time_s: float,
        settings: CausticSettings,
    ) -> FloorIrradiance:  # fmt: skip
        """Return the light on the floor at a depth below the mean surface. sampled: the sea at the time."""
        # Above the water the sky and the sun arrive as they are
        dry_sun: Array = np.zeros(3) if sun is None else np.asarray(sun.irradiance * max(float(sun.direction[1]), 0.0))
        dry = dome.irradiance + dry_sun
        if depth_m <= 0.0:
            return FloorIrradiance(dry, (), dry, dry_sun)
        # Without water light is patterned by refraction alone
        medium = None if self.sun is None else self.sun.medium
        pattern = sun_pattern(sea, sun, depth_m, time_s, self.index, settings, medium)
        even = self.returned(depth_m)
        if self.sky is None:
            patterns = [(sky_pattern(sea, sampled, dome, depth_m, time_s, self.index), np.ones(3))]
            if pattern is not None:
                patterns.append((pattern[0], sun_below(sun, self.index)))
            return FloorIrradiance(even, tuple(patterns), dry, dry_sun, skies=1)
        # In water the beam's pattern stands on even light: sharp as far as it has not turned
        even, patterns = even + self.sky.down(depth_m), []
        if pattern is not None and self.sun is not None:
            beam, sharp = self._beam(depth_m)
            even = even + self.sun.down(depth_m) - beam
            patterns = [(pattern[0], sharp)]
            if pattern[1] is not None:
                patterns.append((pattern[1], beam - sharp))
            else:
                even = even + beam - sharp
        return FloorIrradiance(np.maximum(even, 0.0), tuple(patterns), dry, dry_sun)

    def _beam(self, depth_m: float) -> tuple[Array, Array]:
        """Return the irradiance (3,) of a level plane by the sun's beam, and its part that has not turned at all."""
        assert self.sun is not None
        beam = beam_fraction(self.table(from_camera=False), depth_m, self.sun_up)
        medium = self.sun.medium
        sharp = medium.light.display(np.exp(-mean_rates(medium.model, 0.0, depth_m)[1] * depth_m / self.sun_up))
        return self.sun.below * beam, self.sun.below * np.minimum(sharp, beam)


def sun_pattern(
    sea: Sea, sun: Sun | None, depth_m: float, time_s: float, index: float, settings: CausticSettings,
    medium: Medium | None = None,
) -> tuple[Tiled, Tiled | None] | None:  # fmt: skip
    """Return the caustics of the sun on the floor, mean 1, and those of the light that the water has turned by small
    angles; None without a sun above the horizon.
    """
    if sun is None or sun.direction[1] <= 0.0:
        return None
    settings = settings.model_copy(update={"sun_half_angle_rad": sun.half_angle_rad})
    spread = None if medium is None else spread_of(medium)
    stack = caustic_stack(sea, sun.direction, [depth_m], time_s, settings, index, spread)
    soft = None if stack.soft is None else _on_floor(stack, np.repeat(stack.soft[0], 3, axis=-1))
    return _on_floor(stack, stack.ratio[0]), soft


def _on_floor(stack: CausticStack, plane: Array) -> Tiled:
    """Return a plane of a stack along the beam in the place where it lies on the floor."""
    x, y, z = stack.sun_direction
    depth = float(stack.depth_m[0])
    return Tiled(np.ascontiguousarray(plane), stack.tile_m, (-float(x / y) * depth, -float(z / y) * depth))


# Light of the sky on the floor below waves, through clear water.
#
# A soft sky is gathered: E = n^2 sum of L T over rays up from the floor, evenly spread over the plane of direction
# cosines. Radiance in the water is L T n^2 (the n^2 law), and waves that are not drawn give each ray a facet of its
# own. A sum of the sky's caustics instead has the pattern of every patch, sharper than the sky's: with 55 patches twice
# the contrast at 5 m. Only what is brighter than most of the sky, which few rays would find, is left to caustics.
#
# A ray from the floor finds the surface by the fixed point t = (depth + height(x + t v))/v_y on a map of heights, of
# which three steps leave 1 % of the height of waves of slope 0.2 at the edge of Snell's window. It meets a facet of the
# mean slope there plus a slope of its own, weighted by what the ray sees of it: (v.n)/n_y over that of the mean slope.

_STEPS = 3


@exact
def _gather_row(
    surface: Any, sky: Any, rays: Any, row: int, depth: float, index: float, footprint: float, out: Any
) -> None:
    """Write the sums (size, 3) of radiance over n^2 that the rays of a row of the floor's pixels see.

    surface: height [m] and slopes over (x, z), (n n, 3), n, a power of two, and the tile's side [m]. sky: texels and
    levels of the dome, as of `sky_radiance`. rays: (k, 7) direction up, place in the pixel over (x, z) in [0, 1), and
    slope of the facet. footprint: of each ray in the sky [rad].
    """
    step, (texels, levels) = surface[2] / len(out), sky
    for column in range(len(out)):
        light = (0.0, 0.0, 0.0)
        for k in range(len(rays)):
            v = rays[k, 0], rays[k, 1], rays[k, 2]
            x, z = (column + rays[k, 3]) * step, (row + rays[k, 4]) * step
            p = (0.0, 0.0, 0.0)
            # Find where the ray leaves the water, by fixed-point iteration on the wave's height
            for _ in range(_STEPS):
                t = (depth + p[0]) / v[1]
                p = _surface(surface, x + t * v[0], z + t * v[2])
            # Tilt the surface by a facet of unresolved waves, and look through it
            seen = v[1] - p[1] * v[0] - p[2] * v[2]
            sx, sz = p[1] + rays[k, 5], p[2] + rays[k, 6]
            facet = v[1] - sx * v[0] - sz * v[2]
            if seen > 0.0 and facet > 0.0:
                up = 1.0 / math.sqrt(1.0 + sx * sx + sz * sz)
                lost, _ = reflectance(facet * up, 1.0 / index)
                if lost < 1.0:
                    a = bent(v[0], v[1], v[2], sx * up, -up, sz * up, index)
                    light = add(
                        light, sky_radiance(texels, levels, a[0], a[1], a[2], footprint), (1.0 - lost) * facet / seen
                    )
        out[column, 0], out[column, 1], out[column, 2] = light


@exact
def _surface(surface: Any, x: float, z: float) -> Vector:
    """Return height and slopes over (x, z) at a place, between the points of the map."""
    texels, size, tile_m = surface
    a, b, c, d, fx, fy = _periodic_four(0, size, x * size / tile_m, z * size / tile_m)
    return four(texels, a, b, c, d, fx, fy)


_RAYS = 1 << 22
"""Rays of a pattern: 4096 to a pixel of 32 x 32 leave 0.4 % of the light as error at 5 m under a wind of 5 m/s."""
_BLUR = 1.0 / 32.0
"""Standard deviation over the depth of a blur that takes a third of that error, and 4 % of two waves' contrast."""
_SMALLEST, _LARGEST = 16, 64
"""Least and greatest number of a pattern's pixels across the tile."""
_PER_DEPTH = 16.0
"""Pixels to a length of the depth: the sky is wide, so its light has no detail much smaller than the depth."""
_SINE = 0.85
"""Sine of the widest rays: facets up to 10 degrees off see the sky outside of Snell's window."""
_POINTS = 256
"""Most points across the tile of the surface's heights and slopes."""
_EVEN_TILES = 2.0
"""Depth in tiles of the sea beyond which the light is even: the sky blurs the longest wave below the rays' error."""
_GRID = 128
"""Cells across the tile of the sea whose caustics the sky's bright patches make."""


def sky_pattern(sea: Sea, sampled: SampledSea, dome: Dome, depth_m: float, time_s: float, index: float) -> Tiled:
    """Return the irradiance of the floor by the sky through clear water. sampled: the sea at that time."""
    tile = sea.tile_m
    if depth_m > _EVEN_TILES * tile or sampled.steepest < 1e-5:  # a level sea
        return Tiled(np.broadcast_to(dome.irradiance_below(index), (1, 1, 3)), tile)
    size = 1 << int(np.clip(np.ceil(np.log2(_PER_DEPTH * tile / depth_m)), np.log2(_SMALLEST), np.log2(_LARGEST)))
    soft, bright = dome.divided(index)
    total = _gathered(sampled, soft, max(depth_m, -sampled.lowest_m), size, index)
    for direction, irradiance, half_angle_rad in bright:
        ratio = caustic_map(sea, direction, depth_m, time_s, size, _GRID, index, min(half_angle_rad, 0.5))
        total += ratio[..., None] * irradiance
    return Tiled(total, tile)


def _gathered(sampled: SampledSea, dome: Dome, depth_m: float, size: int, index: float) -> Array:
    """Return the irradiance (size, size, 3) by rays up from the pixels of the tile."""
    rays = _rays(_RAYS // size**2, sampled.blur_variance + sampled.ripple_variance)
    share = PI * _SINE**2 / len(rays)  # of the plane of direction cosines, which the cosine on the floor turns it into
    slopes, out = _slopes(sampled), np.zeros((size, size, 3))
    surface = slopes.reshape(-1, 3), len(slopes), sampled.tile_m
    sky = packed([level[None] for level in dome.levels])

    def draw(row: int) -> None:
        _gather_row(surface, sky, rays, row, depth_m, index, index * np.sqrt(share), out[row])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(draw, range(size)))  # to see their errors
    blur = gaussian_transform(_BLUR * depth_m * np.eye(2), size, sampled.tile_m)
    return index**2 * share * (out if blur is None else irfft2(rfft2(out, axes=(0, 1)) * blur[..., None], axes=(0, 1)))


def _slopes(sampled: SampledSea) -> NDArray[np.float32]:
    """Return height and slopes (n, n, 3) of the surface over places."""
    size = int(sampled.maps.table[0, 1])
    height = sampled.maps.height[: size * size].reshape(size, size).astype(np.float64)
    by_z, by_x = (
        (np.roll(height, -1, axis) - np.roll(height, 1, axis)) * (0.5 * size / sampled.tile_m) for axis in (0, 1)
    )
    every = max(size // _POINTS, 1)
    return np.stack([height, by_x, by_z], axis=-1)[::every, ::every].astype(np.float32)


@shared(keep=8)
def _rays(count: int, slope_variance: float) -> Array:
    """Return the rays (count, 7) of `_gather_row`, the same for every pixel.

    Directions lie on a sunflower's spiral (Vogel 1979), the rest on the lattice R_4 of Roberts 2018.
    """
    k = np.arange(count)
    sine, turn = _SINE * np.sqrt((k + 0.5) / count), k * (PI * (3.0 - np.sqrt(5.0)))
    ratio = max(np.roots([1.0, 0.0, 0.0, 0.0, -1.0, -1.0]).real)  # x^5 = x + 1
    even = (0.5 + np.outer(k, ratio ** -np.arange(1.0, 5.0))) % 1.0
    normal = np.array([normal_quantile(p) for p in np.clip(even[:, 2:], 1e-9, 1.0 - 1e-9).ravel()]).reshape(-1, 2)
    direction = np.stack([sine * np.cos(turn), np.sqrt(1.0 - sine**2), sine * np.sin(turn)], axis=-1)
    return np.concatenate([direction, even[:, :2], np.sqrt(slope_variance) * normal], axis=1)


_between_four = inlined(between_four)
_periodic_four = inlined(periodic_four)


class WaterTable(NamedTuple):
    """Where the tables of a light lie in the water's arrays, and the scales of a `MediumTable`: the light's length and
    the depth at which its rays start.
    """

    at: int
    length_m: float
    depth_m: float


@exact
def _bilinear(table: Any, at: int, u: float, v: float) -> Vector:
    """Return the value of table `at` of (n, U, V, 3) at coordinates in [0, 1] (`medium.lookup.bilinear`)."""
    x, y = min(max(u, 0.0), 1.0) * (table.shape[1] - 1), min(max(v, 0.0), 1.0) * (table.shape[2] - 1)
    i, j = min(int(x), table.shape[1] - 2), min(int(y), table.shape[2] - 2)
    return _channel(table, at, i, j, x, y, 0), _channel(table, at, i, j, x, y, 1), _channel(table, at, i, j, x, y, 2)


@inlined
def _channel(t: Any, at: int, i: int, j: int, x: float, y: float, k: int) -> Any:
    return _between_four(t[at, i, j, k], t[at, i, j + 1, k], t[at, i + 1, j, k], t[at, i + 1, j + 1, k], y - j, x - i)


@exact
def veil(veils: Any, table: WaterTable, distance: float, up: float) -> Vector:
    """Return `medium.lookup.veil_lookup` of a ray that may be infinite."""
    s = min(distance, table.depth_m / max(up, 1e-9))
    smooth = _bilinear(veils, table.at, 0.5 + 0.5 * up, 1.0 - table.length_m / (s + table.length_m))
    filled = -math.expm1(-s / table.length_m)
    return filled * smooth[0], filled * smooth[1], filled * smooth[2]


@exact
def transmittance(attenuations: Any, table: WaterTable, distance: float, up: float) -> Vector:
    """Return `medium.lookup.transmittance_lookup` of a finite ray."""
    s = min(distance, table.depth_m / max(up, 1e-9))
    depth = max(table.depth_m - s * up, 0.0)
    length = table.length_m
    a = _bilinear(attenuations, table.at, 1.0 - length / (depth + length), 1.0 - length / (s + length))
    return math.exp(-a[0] * s), math.exp(-a[1] * s), math.exp(-a[2] * s)
