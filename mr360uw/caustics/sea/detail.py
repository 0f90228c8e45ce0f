# SPDX-License-Identifier: Apache-2.0
"""Fine ripples: two scrolling slope maps that are added to the slopes of the sea.

One procedural, tileable slope map is read twice, the second time with its axes swapped, and scrolled in two directions
beside the wind. Slopes are added rather than normals, so that the sum is the slope of a surface. The number of repeats
in a tile and the scroll in a loop are whole numbers, so tile and loop close exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import shared
from mr360uw.texels import between_four, texels_around

Array = NDArray[np.float64]

DETAIL_SIZE = 64
"""Texels across the map: ten for each dominant wavelength."""
_WAVES_ACROSS = 6
"""Dominant wavelengths in one repeat of the map."""
_SECOND_REPEAT = 1.3
"""Repeats of the second map over those of the first: not a simple ratio, so that no common period shows in the tile."""
_SCROLL_TURN_RAD = 0.6
"""Angle [rad] between the wind and each map's scroll, one to either side."""


@dataclass(frozen=True, slots=True)
class Detail:
    """The two maps at one time.

    slopes: (DETAIL_SIZE, DETAIL_SIZE, 2) periodic slopes over (x, z). repeats: (2,) in a tile. offset: (2, 2) scroll of
    each map over (x, z), in repeats.
    """

    slopes: Array
    repeats: Array
    offset: Array
    tile_m: float


@shared(keep=8)
def _slope_map(rms: float, seed: int) -> Array:
    """Return slopes of random waves about `_WAVES_ACROSS` in a repeat, each map carrying half of the variance."""
    n = DETAIL_SIZE
    m = np.fft.fftfreq(n, 1.0 / n)
    mx, mz = np.meshgrid(m, m)
    k = np.hypot(mx, mz)
    spectrum = np.where(k > 0.0, np.exp(-0.5 * ((k - _WAVES_ACROSS) / (0.35 * _WAVES_ACROSS)) ** 2), 0.0)
    phase = np.random.default_rng([seed, 0xDE7A]).uniform(0.0, 2.0 * np.pi, (n, n))
    height = spectrum * np.exp(1j * phase) / np.maximum(k, 1.0)
    slopes = np.stack([np.fft.ifft2(1j * mx * height).real, np.fft.ifft2(1j * mz * height).real], axis=-1)
    return slopes * (rms / np.sqrt(2.0 * np.mean(np.sum(slopes**2, axis=-1))))


def make_detail(
    tile_m: float,
    rms_slope: float,
    wavelength_m: float,
    velocity: Array,
    loop_s: float | None,
    seed: int,
    time_s: float,
) -> Detail:
    """Return the detail maps at one time. velocity: (2,) m/s over (x, z) of their mean scroll."""
    first = max(round(tile_m / (_WAVES_ACROSS * wavelength_m)), 1)
    repeats = np.array([first, max(round(first * _SECOND_REPEAT), first + 1)], np.float64)
    offset = np.zeros((2, 2))
    for i, turn in enumerate((_SCROLL_TURN_RAD, -_SCROLL_TURN_RAD)):
        c, s = np.cos(turn), np.sin(turn)
        rate = np.array([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]]) * repeats[i] / tile_m
        if loop_s is not None:
            rate = np.round(rate * loop_s) / loop_s
        offset[i] = -rate * time_s
    return Detail(_slope_map(rms_slope, seed), repeats, offset - np.floor(offset), tile_m)


def periodic_slope(slopes: Array, u: Array, v: Array) -> Array:
    """Return the periodic bilinear sample (..., 2) at (u, v) in repeats, texel i centred at i/DETAIL_SIZE."""
    n = slopes.shape[0]
    i, j, fx, fy = texels_around(u * n, v * n)
    i0, j0, i1, j1 = i % n, j % n, (i + 1) % n, (j + 1) % n
    value: Array = between_four(slopes[j0, i0], slopes[j0, i1], slopes[j1, i0], slopes[j1, i1], fx, fy)
    return value


def detail_slope(detail: Detail, x_m: Array, z_m: Array) -> Array:
    """Return the sum of both maps' slopes (..., 2) at world (x, z) [m]."""
    u, v = x_m / detail.tile_m, z_m / detail.tile_m
    (a, b), o = detail.repeats, detail.offset
    first = periodic_slope(detail.slopes, a * u + o[0, 0], a * v + o[0, 1])
    second = periodic_slope(detail.slopes, b * v + o[1, 1], b * u + o[1, 0])
    return first + second[..., ::-1]
