# SPDX-License-Identifier: Apache-2.0
"""Random waves of a wind: lengths even in log k, directions about the wind, and the variance that each carries.

Every octave has the same slope variance, as in the equilibrium range of a wind sea (Phillips 1958). The sum is the part
of the mean square slope of Cox & Munk 1954 that lies in the band.

Where the wind changes over a clip, waves must not: a wave whose length or direction followed the wind would jump, the
further from the origin the more. Lengths and directions are then drawn once for all winds of the clip. At each time
every wave has the variance of the present wind at its place in the spectrum: it grows and fades where it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.sea.spectrum import band_slope_variance, lattice_vector, peak_wavelength

Array = NDArray[np.float64]

_LEAST_WAVES = 6
"""Waves that stay in the weakest wind: the surface would show the shape of two or three alone."""
_FADING_OCTAVES = 1.0
"""Octaves of wavelength over which waves fade that are longer than the wind makes. The peak's wavelength goes with the
square of the wind: a wave grows while the wind does by 40 %. With half as much it grows twice as fast."""
_LAPS = 3
"""Turns to either side that a wave's direction is counted at: enough for the widest spread, 180 degrees."""


@dataclass(frozen=True, slots=True)
class Wind:
    """The wind at present, and all winds that the waves are made for.

    speed, azimuth_rad: at present. greatest_speed: of all. arc_rad: azimuths that it turns through, or None.
    """

    speed: float
    azimuth_rad: float
    greatest_speed: float
    arc_rad: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class WaveBand:
    """Range of the waves. longest_m: None for a fully developed sea. spread_rad: of directions about the wind."""

    tile_m: float
    longest_m: float | None
    shortest_m: float
    spread_rad: float

    def longest_at(self, wind_speed: float) -> float:
        """Return the length [m] of the longest wave at a wind."""
        return max(min(self.longest_m or peak_wavelength(wind_speed), self.tile_m), self.shortest_m)


def wind_waves(wind: Wind, band: WaveBand, count: int, seed: int) -> tuple[Array, Array, Array]:
    """Return wave vectors (n, 2) [rad/m] that repeat after the tile, amplitudes (n,) [m] and phases (n,) [rad]."""
    longest, shortest = band.longest_at(wind.greatest_speed), band.shortest_m
    present = min(band.longest_at(wind.speed), longest)
    random = np.random.default_rng([seed, 0x5EA])
    place = (np.arange(count) + random.uniform(0.0, 1.0, count)) / count
    length = 2.0 * np.pi / longest * (longest / shortest) ** place
    angle = band.spread_rad * random.standard_normal(count)
    phase = random.uniform(0.0, 2.0 * np.pi, count)
    weight, azimuth = share_of_lengths(2.0 * np.pi / length, present), wind.azimuth_rad
    if wind.arc_rad is not None:
        azimuth, turn = wind.arc_rad[0], wind.arc_rad[1] - wind.arc_rad[0]
        angle += turn * (random.permutation(count) + random.uniform(0.0, 1.0, count)) / count
        weight *= share_of_directions(angle, wind.azimuth_rad - azimuth, turn, band.spread_rad)
    wx, wz = math.sin(azimuth), -math.cos(azimuth)
    c, s = np.cos(angle), np.sin(angle)
    k = length[:, None] * np.stack([c * wx - s * wz, s * wx + c * wz], axis=1)
    k = lattice_vector(k, band.tile_m)
    variance = band_slope_variance(wind.speed, 2.0 * np.pi / present, 2.0 * np.pi / shortest)
    amplitude = np.sqrt(2.0 * variance * weight / np.sum(weight)) / np.linalg.norm(k, axis=1)
    return k, amplitude, phase


def share_of_lengths(wavelength: Array, present: float) -> Array:
    """Return the weights (n,) of waves [m] at a wind whose longest waves have the length `present`, at least those of
    the shortest `_LEAST_WAVES`; longer ones fade over an octave.

    The amplitudes, the root of the weights, grow smoothly with the wind.
    """
    kept = max(present, float(np.sort(wavelength)[:_LEAST_WAVES][-1]))
    fading = np.clip(1.0 - np.log2(wavelength / kept) / _FADING_OCTAVES, 0.0, 1.0)
    return np.asarray((fading**2 * (3.0 - 2.0 * fading)) ** 2)


def share_of_directions(angle: Array, present: float, turn: float, spread: float) -> Array:
    """Return weights (n,) of waves for the present wind: the ratio of two densities of directions.

    angle: of the waves [rad], drawn from normal distributions of standard deviation `spread` about directions even over
    [0, turn]. With the weights they have that distribution about the direction `present` alone (importance sampling).
    All one if spread or turn are 0.
    """
    if spread == 0.0 or turn == 0.0:
        return np.ones(len(angle))
    from scipy.special import ndtr

    laps = angle[:, None] + 2.0 * np.pi * np.arange(-_LAPS, _LAPS + 1)
    now = np.exp(-0.5 * ((laps - present) / spread) ** 2).sum(axis=1)
    drawn = (ndtr(laps / spread) - ndtr((laps - turn) / spread)).sum(axis=1)
    return np.asarray(now / drawn)
