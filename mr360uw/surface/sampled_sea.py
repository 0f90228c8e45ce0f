# SPDX-License-Identifier: Apache-2.0
"""One moment of a sea for rays: displacement of its particles as periodic splines, smoothed to any footprint.

Height and horizontal shift over the rest positions of particles are sums of waves without cusps, however sharp the
crests of the displaced surface are. They are sampled with `_SAMPLES` points to the shortest wave and interpolated by
cubic B-splines (Unser 1999), whose slopes are continuous. Level 0 is the sea itself. Level l > 0 is the sea under a
Gaussian of standard deviation 2^(l - 1) steps; what it takes of the slopes' covariance is kept beside it, so that
waves smaller than a pixel still spread light.
"""

from __future__ import annotations

import functools
import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.parameters import checked
from mr360uw.base.texels import between_four, periodic_four
from mr360uw.caustics.sea import Detail, SeaParameters, detail_slope
from mr360uw.jit import exact, inlined
from mr360uw.types import Array, Floats

_SAMPLES = 12
"""Points to the shortest wave: cubic splines are then off by 2e-4 of its height. Twice as many: 1e-5, four times the
memory."""
_FEWEST, _MOST = 256, 2048
"""Least and greatest number of points across the tile; 2048 squared take 0.3 GB."""
_PROBE = 1024
"""Points across the tile at which the shortest wave is looked for."""
_HARDLY = 1e-9
"""Amplitude of a wave over that of the largest that is rounding."""


@dataclass(frozen=True, eq=False)
class SampledSea:
    """Splines of a sea at one time.

    coefficients: (sum of n^2, 3) of height and shift over (x, z), level after level, rows = z, in single precision,
    half as much to read: heights change by 1e-8 m. table: (L, 2) first coefficient and points across the tile n of each
    level. step_m: distance of the points of level 0. lost_slope: (L,
    3) covariances xx, xz, zz of the slopes that a level lacks. lowest_m, highest_m: of the surface. steepest: greatest
    slope. detail: ripples. blur_variance: variance of slope along each axis of waves that are not drawn.
    """

    coefficients: NDArray[np.float32]
    table: NDArray[np.int64]
    tile_m: float
    step_m: float
    lost_slope: Array
    lowest_m: float
    highest_m: float
    steepest: float
    detail: Detail | None
    blur_variance: float

    @classmethod
    @checked
    def of(cls, sea: SeaParameters, time_s: float, points: int | None = None) -> SampledSea:
        """Return the splines of a sea at a time [s]. points: across the tile, of `points_across` unless given."""
        n, tile = points_across(sea) if points is None else points, sea.tile_m
        # what rays ask of the whole surface; the fields of slopes and strain, most of the memory, are let go of then
        fields = sea.grid_fields(n, time_s)
        strain = np.hypot(fields.slope_x, fields.slope_z)
        strain /= np.maximum((1.0 + fields.strain_xx) * (1.0 + fields.strain_zz) - fields.strain_xz**2, _LEAST_ACROSS)
        steepest, lowest, highest = float(strain.max()), float(fields.height.min()), float(fields.height.max())
        spectra = [_transformed(getattr(fields, name)) / n**2 for name in ("height", "shift_x", "shift_z")]
        del fields, strain
        # level after level: coefficients of what its Gaussian leaves, covariance of the slopes that it takes
        sigmas = [0.0, *(tile / n * 2.0**level for level in range(1 + math.ceil(math.log2(n))))]
        sizes = [min(n, max(2 * n >> max(level - 1, 0), 4)) for level in range(len(sigmas))]
        start = np.cumsum([0, *(size * size for size in sizes)])
        coefficients = np.empty((start[-1], 3), np.float32)
        k, kx = (2.0 * np.pi / tile * f(n, 1.0 / n) for f in (np.fft.fftfreq, np.fft.rfftfreq))
        slope = np.abs(spectra[0]) ** 2
        slope[:, 1:-1] *= 2.0  # waves and their conjugates, of which the spectrum has one
        lost = []
        for sigma, size, first in zip(sigmas, sizes, start[:-1], strict=True):
            both = np.exp(-0.5 * (sigma * k[:, None]) ** 2) * np.exp(-0.5 * (sigma * kx) ** 2)
            gone = slope * (1.0 - both**2)
            by_x, by_z = gone.sum(axis=0), gone.sum(axis=1)
            lost.append([by_x @ kx**2, k @ gone @ kx, by_z @ k**2])
            for part, spectrum in enumerate(spectra):
                coefficients[first : first + size * size, part] = _coefficients(spectrum * both, size).ravel()
        margin = 0.02 * (highest - lowest) + 1e-9
        return cls(
            coefficients, np.stack([start[:-1], sizes], axis=-1), tile, tile / n, np.array(lost), lowest - margin,
            highest + margin, min(1.1 * steepest + 1e-6, _STEEPEST), sea.detail(time_s), 0.5 * sea.blur_slope**2,
        )  # fmt: skip

    def heights(self, x_m: ArrayLike, z_m: ArrayLike) -> Array:
        """Return the height (n,) [m] of the surface over the mean above places (n,)."""
        x, z = (np.ascontiguousarray(a, np.float64) for a in (x_m, z_m))
        out = np.zeros(len(x))
        _heights_at(self.coefficients, self.table, self.tile_m, x, z, out)
        return out

    @functools.cached_property
    def maps(self) -> HeightMaps:
        """Maps of the height over places."""
        return _height_maps(self.coefficients, self.table, self.tile_m, self.steepest)

    def level_of(self, sigma_m: Floats) -> Array:
        """Return the fractional level (...,) for a Gaussian of a standard deviation [m]."""
        s = np.asarray(sigma_m, np.float64) / self.step_m
        return np.minimum(np.where(s < 1.0, s, 1.0 + np.log2(np.maximum(s, 1.0))), len(self.table) - 1.0)

    def unresolved(self, level: Array) -> Array:
        """Return the covariance (..., 3), xx, xz, zz, of the slopes that a level lacks, with those never drawn."""
        at = np.arange(len(self.lost_slope))
        lost = np.stack([np.interp(level, at, self.lost_slope[:, c]) for c in range(3)], axis=-1)
        return lost + self.blur_variance * np.array([1.0, 0.0, 1.0])

    def with_ripples(self, normal: Array, rest: Array, sigma_m: Array) -> tuple[Array, Array]:
        """Return normals (n, 3) with the ripples' slopes, and the slope variance (n,) of ripples that are smaller than
        the footprint. rest: (n, 2) rest positions; sigma_m: (n,) of their footprints.
        """
        if self.detail is None:
            return normal, np.zeros(len(normal))
        kept = np.exp(-0.5 * (self.ripple_wave * sigma_m) ** 2)
        added = kept[:, None] * detail_slope(self.detail, rest[:, 0], rest[:, 1])
        tilted = normal - normal[:, 1:2] * np.stack([added[:, 0], np.zeros(len(added)), added[:, 1]], axis=-1)
        return tilted / np.linalg.norm(tilted, axis=-1, keepdims=True), (1.0 - kept**2) * self.ripple_variance

    @property
    def ripple_wave(self) -> float:
        """The dominant wave [rad/m] of the ripples, 0 for none."""
        if self.detail is None:
            return 0.0
        return float(2.0 * np.pi * _DOMINANT_WAVES * self.detail.repeats.max() / self.tile_m)

    @property
    def ripple_variance(self) -> float:
        """Variance of the ripples' slope along each axis: of each map, both axes, which is that of both maps, one."""
        return 0.0 if self.detail is None else float(np.mean(np.sum(self.detail.slopes**2, axis=-1)))


_LEAST_ACROSS, _STEEPEST = 0.05, 8.0
"""Bounds of the greatest slope, which is infinite at a cusp: rays go in steps that a slope of 83 degrees allows."""
_DOMINANT_WAVES = 6.0
"""Waves of the dominant length in one repeat of the ripples' map."""


def points_across(sea: SeaParameters) -> int:
    """Return the points across the tile, a power of two, that the sea's shortest wave needs at any time."""
    height = np.abs(np.fft.fft2(sea.grid_fields(_PROBE, 0.0).height))
    height[0, 0] = 0.0
    waves = np.abs(np.fft.fftfreq(_PROBE, 1.0 / _PROBE))
    present = height > _HARDLY * max(float(height.max()), 1e-300)
    most = float(np.max(np.where(present, np.maximum(waves[:, None], waves), 0.0)))
    return int(np.clip(2 ** math.ceil(math.log2(max(_SAMPLES * most, 1.0))), _FEWEST, _MOST))


def _coefficients(spectrum: Any, size: int) -> Array:
    """Return the coefficients (size, size) of the periodic cubic spline through a spectrum's field, cut to `size`."""
    n = len(spectrum)
    half = size // 2
    keep = np.arange(n) if size == n else np.concatenate([np.arange(half), np.arange(n - half, n)])
    cut = spectrum[keep, : half + 1] * size**2
    if size < n:
        cut[:, half] = 0.0  # a wave of two points, which the Gaussian has taken
    along_z, along_x = ((2.0 + np.cos(2.0 * np.pi * f(size))) / 3.0 for f in (np.fft.fftfreq, np.fft.rfftfreq))
    smooth = cut / (along_z[:, None] * along_x)
    return np.asarray(scipy.fft.irfft2(smooth, (size, size), overwrite_x=True, workers=os.cpu_count()))


def _transformed(field: Array) -> NDArray[np.complex128]:
    """Return the real discrete Fourier transform (n, n/2 + 1) of a field."""
    return np.asarray(scipy.fft.rfft2(field, workers=os.cpu_count()), np.complex128)


# What compiled rays read of a sea: its splines, and maps of its height over places instead of particles.
#
# Rays march in the maps, which are read bilinearly and cost a fiftieth of the splines, and then find the exact point on
# the splines. Between nodes a map is off by 3 % of the height of the shortest wave.
#
# Splines give the displacement and its derivatives at a rest position, one point at a time. A particle at rest at (a,
# b) stands at (a + shift_x, height, b + shift_z). c: (n, 3) coefficients; n: (L, 2) of every level its first
# coefficient and its points across the tile, powers of two: see `SampledSea`.

Displacement = tuple[float, float, float, float, float, float, float, float, float]
"""Height, shift_x and shift_z, their derivatives by a and those by b."""


@exact
def displacement(c: Any, n: Any, tile_m: float, level: float, a: float, b: float) -> Displacement:
    """Return the displacement of a particle, between the splines of two levels."""
    lower = min(int(level), len(n) - 1)
    share = level - lower
    p = _at_level(c, n[lower, 0], n[lower, 1], tile_m, a, b)
    if share <= 0.0 or lower + 1 >= len(n):
        return p
    q, rest = _at_level(c, n[lower + 1, 0], n[lower + 1, 1], tile_m, a, b), 1.0 - share
    return (
        rest * p[0] + share * q[0], rest * p[1] + share * q[1], rest * p[2] + share * q[2],
        rest * p[3] + share * q[3], rest * p[4] + share * q[4], rest * p[5] + share * q[5],
        rest * p[6] + share * q[6], rest * p[7] + share * q[7], rest * p[8] + share * q[8],
    )  # fmt: skip


@exact
def _at_level(c: Any, first: int, size: int, tile_m: float, a: float, b: float) -> Displacement:
    """Return the displacement of a particle by the splines of one level."""
    # Weigh the four nodes each way by cubic B-splines, and by their slopes
    per_m, last = size / tile_m, size - 1
    u, v = a * per_m, b * per_m
    column, row = math.floor(u), math.floor(v)
    i, j = int(column), int(row)
    x0, x1, x2, x3 = _basis(u - column)
    y0, y1, y2, y3 = _slopes(u - column)
    i0, i1, i2, i3 = (i - 1) & last, i & last, (i + 1) & last, (i + 2) & last
    weights, slopes = _basis(v - row), _slopes(v - row)
    h, sx, sz, h_a, sx_a, sz_a, h_b, sx_b, sz_b = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # Sum rows of nodes: height and both shifts, with their slopes along both axes
    for k in range(4):
        line = first + ((j + k - 1) & last) * size
        p, q, r, t = line + i0, line + i1, line + i2, line + i3
        w, g = weights[k], slopes[k] * per_m
        e = w * per_m
        f = x0 * c[p, 0] + x1 * c[q, 0] + x2 * c[r, 0] + x3 * c[t, 0]
        h, h_b = h + w * f, h_b + g * f
        h_a += e * (y0 * c[p, 0] + y1 * c[q, 0] + y2 * c[r, 0] + y3 * c[t, 0])
        f = x0 * c[p, 1] + x1 * c[q, 1] + x2 * c[r, 1] + x3 * c[t, 1]
        sx, sx_b = sx + w * f, sx_b + g * f
        sx_a += e * (y0 * c[p, 1] + y1 * c[q, 1] + y2 * c[r, 1] + y3 * c[t, 1])
        f = x0 * c[p, 2] + x1 * c[q, 2] + x2 * c[r, 2] + x3 * c[t, 2]
        sz, sz_b = sz + w * f, sz_b + g * f
        sz_a += e * (y0 * c[p, 2] + y1 * c[q, 2] + y2 * c[r, 2] + y3 * c[t, 2])
    return h, sx, sz, h_a, sx_a, sz_a, h_b, sx_b, sz_b


@exact
def _basis(t: float) -> tuple[float, float, float, float]:
    """Return the four cubic B-splines about a place t in [0, 1) between points."""
    r = 1.0 - t
    return (
        r * r * r / 6.0, (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * r * r + 3.0 * r * r * r) / 6.0, t * t * t / 6.0,
    )  # fmt: skip


@exact
def _slopes(t: float) -> tuple[float, float, float, float]:
    """Return the derivatives of the four cubic B-splines."""
    r = 1.0 - t
    return -0.5 * r * r, 0.5 * t * (3.0 * t - 4.0), -0.5 * r * (3.0 * r - 4.0), 0.5 * t * t


@exact
def rest_position(
    c: Any, n: Any, tile_m: float, level: float, place: tuple[float, float], start: tuple[float, float], slack: float
) -> tuple[float, float, Displacement]:
    """Return the rest position of the particle above a place (x, z) and its displacement, by Newton's method.

    start: a rest position near it. slack: [m] that it may be beside (x, z). Where the surface folds over, one of
    several is found.
    """
    (x, z), (a, b) = place, start
    p = displacement(c, n, tile_m, level, a, b)
    for _ in range(8):
        off_x, off_z = a + p[1] - x, b + p[2] - z
        if abs(off_x) + abs(off_z) < slack:
            break
        xx, xz, zx, zz = 1.0 + p[4], p[7], p[5], 1.0 + p[8]
        across = xx * zz - xz * zx
        if across < 0.1:  # near a cusp: the slower iteration, which does not divide by the derivative
            a, b = a - 0.5 * off_x, b - 0.5 * off_z
        else:
            a, b = a - (zz * off_x - xz * off_z) / across, b - (xx * off_z - zx * off_x) / across
        p = displacement(c, n, tile_m, level, a, b)
    return a, b, p


@exact
def _heights_at(c: Any, n: Any, tile_m: float, x: Any, z: Any, result: Any) -> None:
    """Write the height of the surface over the mean at places (n,) into `result` (n,)."""
    for k in range(len(x)):
        result[k] = rest_position(c, n, tile_m, 0.0, (x[k], z[k]), (x[k], z[k]), 1e-11 * tile_m)[2][0]


_between_four = inlined(between_four)
_periodic_four = inlined(periodic_four)


_FINEST = 512
"""Most nodes across the tile of the map of the sea itself. Maps of smoothed seas have one for every two points of the
splines: their rays are as wide as two."""
_SLACK = 1e-3
"""Largest distance of a particle of the maps from its node, over the distance of the nodes."""
_MARGIN = 1.1
"""Factor on the greatest slope between nodes."""
_ROWS = 32
"""Rows that are made on one thread at a time."""


class HeightMaps(NamedTuple):
    """height: (n,) and shift: (n, 2) over (x, z) [m] of the particles above the nodes x = column tile/size, z = row
    tile/size, level after level. table: (L, 2) first node and nodes across the tile of each. steepest: (L,) greatest
    slope of each.
    """

    height: NDArray[np.float32]
    shift: NDArray[np.float32]
    table: NDArray[np.int64]
    steepest: Array


def _height_maps(
    coefficients: NDArray[np.float32], table: NDArray[np.int64], tile_m: float, steepest: float
) -> HeightMaps:
    """Return the maps of all levels. coefficients, table: of the splines. steepest: bound of the greatest slope."""
    sizes = [min(int(table[0, 1]), _FINEST)] + [max(int(n) // 2, 4) for n in table[1:, 1]]
    start = np.cumsum([0, *(n * n for n in sizes)])
    height, shift = np.zeros(start[-1], np.float32), np.zeros((start[-1], 2), np.float32)
    bands = [(level, row, min(row + _ROWS, n)) for level, n in enumerate(sizes) for row in range(0, n, _ROWS)]

    def make(band: tuple[int, int, int]) -> None:
        level, first, last = band
        part = slice(start[level] + first * sizes[level], start[level] + last * sizes[level])
        _fill(coefficients, table, tile_m, level, sizes[level], (first, last), height[part], shift[part])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(make, bands))  # to see their errors
    slopes = [
        _steepest(height[a:b].reshape(n, n), tile_m / n) for a, b, n in zip(start, start[1:], sizes, strict=False)
    ]
    bound = np.minimum(_MARGIN * np.array(slopes) + 1e-6, steepest)
    bound[0] = steepest
    return HeightMaps(height, shift, np.stack([start[:-1], sizes], axis=-1), bound)


def _steepest(height: NDArray[np.float32], step_m: float) -> float:
    return max(float(np.abs(height - np.roll(height, 1, axis)).max()) for axis in (0, 1)) * math.sqrt(2.0) / step_m


@exact
def _fill(c: Any, n: Any, tile_m: float, level: int, size: int, rows: Any, height: Any, shift: Any) -> None:
    step = tile_m / size
    slack = _SLACK * step
    for row in range(*rows):
        z = row * step
        a, b = 0.0, z
        for column in range(size):
            x = column * step
            a, b, p = rest_position(c, n, tile_m, float(level), (x, z), (a + step, b), slack)
            at = (row - rows[0]) * size + column
            height[at], shift[at, 0], shift[at, 1] = p[0], x - a, z - b


@exact
def read_height(h: Any, n: Any, tile_m: float, level: float, x: float, z: float) -> float:
    """Return the height [m] above (x, z) at a fractional level. h, n: `height` and `table` of the maps."""
    lower = min(int(level), len(n) - 1)
    share = level - lower
    value = _height(h, n[lower, 0], n[lower, 1], tile_m, x, z)
    if share > 0.0 and lower + 1 < len(n):
        value += share * (_height(h, n[lower + 1, 0], n[lower + 1, 1], tile_m, x, z) - value)
    return value


@exact
def _height(h: Any, first: int, size: int, tile_m: float, x: float, z: float) -> float:
    per_m = size / tile_m
    a, b, c, d, fx, fy = _periodic_four(first, size, x * per_m, z * per_m)
    value: float = _between_four(h[a], h[b], h[c], h[d], fx, fy)
    return value


@exact
def read_shift(s: Any, n: Any, tile_m: float, level: float, x: float, z: float) -> tuple[float, float]:
    """Return the shift over (x, z) [m] of the particle above (x, z) at the next lower level. s: `shift` of the maps."""
    lower = min(int(level), len(n) - 1)
    per_m = n[lower, 1] / tile_m
    a, b, c, d, fx, fy = _periodic_four(n[lower, 0], n[lower, 1], x * per_m, z * per_m)
    return (
        _between_four(s[a, 0], s[b, 0], s[c, 0], s[d, 0], fx, fy),
        _between_four(s[a, 1], s[b, 1], s[c, 1], s[d, 1], fx, fy),
    )
