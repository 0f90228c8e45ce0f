# SPDX-License-Identifier: Apache-2.0
"""Light of the sky on the floor below waves, through clear water.

A soft sky is gathered: E = n^2 sum of L T over rays up from the floor, evenly spread over the plane of direction
cosines. Radiance in the water is L T n^2 (the n^2 law), and waves that are not drawn give each ray a facet of its own.
A sum of the sky's caustics instead has the pattern of every patch, sharper than the sky's: with 55 patches twice the
contrast at 5 m. Only what is brighter than most of the sky, which few rays would find, is left to caustics.

A ray from the floor finds the surface by the fixed point t = (depth + height(x + t v))/v_y on a map of heights, of
which three steps leave 1 % of the height of waves of slope 0.2 at the edge of Snell's window. It meets a facet of the
mean slope there plus a slope of its own, weighted by what the ray sees of it: (v.n)/n_y over that of the mean slope.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2

from mr360uw.cache import shared
from mr360uw.caustics import caustic_map
from mr360uw.caustics.flux.sun_disc import gaussian_transform
from mr360uw.caustics.settings import Sea
from mr360uw.constants import PI
from mr360uw.jit import borrowing, inlined
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import Tiled
from mr360uw.surface.sky import Dome
from mr360uw.surface.tracing.facet_draws import normal_quantile
from mr360uw.surface.tracing.ray_optics import Vector, bent, reflectance
from mr360uw.surface.tracing.table_reads import add, packed, sky_radiance

_STEPS = 3


@borrowing
def gather_row(
    w: Any, d: Any, dn: Any, rays: Any, tile_m: float, row: int, depth: float, index: float, footprint: float, out: Any
) -> None:
    """Write the sums (size, 3) of radiance over n^2 that the rays of a row of the floor's pixels see.

    w: (n, n, 3) height [m] and slopes over (x, z) of the surface, n a power of two. d, dn: the dome, as of
    `sky_radiance`. rays: (k, 7) direction up, place in the pixel over (x, z) in [0, 1), and slope of the facet.
    footprint: of each ray in the sky [rad].
    """
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


Array = NDArray[np.float64]

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
    texels, table = packed([level[None] for level in dome.levels])
    surface, out = _slopes(sampled), np.zeros((size, size, 3))

    def draw(row: int) -> None:
        gather_row(
            surface, texels, table, rays, sampled.tile_m, row, depth_m, index, index * np.sqrt(share), out[row]
        )  # fmt: skip

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
    """Return the rays (count, 7) of `gather_row`, the same for every pixel.

    Directions lie on a sunflower's spiral (Vogel 1979), the rest on the lattice R_4 of Roberts 2018.
    """
    k = np.arange(count)
    sine, turn = _SINE * np.sqrt((k + 0.5) / count), k * (PI * (3.0 - np.sqrt(5.0)))
    ratio = max(np.roots([1.0, 0.0, 0.0, 0.0, -1.0, -1.0]).real)  # x^5 = x + 1
    even = (0.5 + np.outer(k, ratio ** -np.arange(1.0, 5.0))) % 1.0
    normal = np.array([normal_quantile(p) for p in np.clip(even[:, 2:], 1e-9, 1.0 - 1e-9).ravel()]).reshape(-1, 2)
    direction = np.stack([sine * np.cos(turn), np.sqrt(1.0 - sine**2), sine * np.sin(turn)], axis=-1)
    return np.concatenate([direction, even[:, :2], np.sqrt(slope_variance) * normal], axis=1)
