# SPDX-License-Identifier: Apache-2.0
"""Water waves: their dispersion, statistics of a wind sea, and the parts of its spectra.

Dispersion of capillary-gravity waves over a flat bottom: Lamb 1932 section 267. Waves on the lattice 2 pi (m, n)/tile
repeat at the tile's edges; frequencies that are multiples of 2 pi/loop repeat after the loop. No blending is needed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import GRAVITY_M_S2, SURFACE_TENSION_OVER_DENSITY
from mr360uw.types import Array

_PEAK_FREQUENCY = 0.855
"""Peak angular frequency of a fully developed sea times wind speed over gravity (Pierson & Moskowitz 1964)."""
_SLOPE_CALM, _SLOPE_PER_WIND = 0.003, 0.00512
"""Mean square slope of a clean sea, and its growth per m/s of wind (Cox & Munk 1954)."""
_SHORTEST_RIPPLE = 370.0
"""Wavenumber [rad/m] of the slowest waves (17 mm long), about where the slope spectrum falls off.

Twice as large, a band of longer waves gets about a tenth less of the slope variance.
"""


def peak_wavelength(wind_speed: float) -> float:
    """Return the dominant wavelength [m] of a fully developed deep sea at a wind speed [m/s]."""
    frequency = _PEAK_FREQUENCY * GRAVITY_M_S2 / max(wind_speed, 0.1)
    return 2.0 * math.pi * GRAVITY_M_S2 / frequency**2


def mean_square_slope(wind_speed: float) -> float:
    """Return the mean square slope of the sea, both axes (Cox & Munk 1954 from 1 m/s up, falling to flat at 0)."""
    return (_SLOPE_CALM + _SLOPE_PER_WIND * wind_speed) * min(wind_speed, 1.0)


def band_slope_variance(wind_speed: float, from_wavenumber: float, to_wavenumber: float) -> float:
    """Return the slope variance in a band of wavenumbers [rad/m].

    `mean_square_slope` is spread evenly over log k from the peak of the spectrum up.
    """
    peak = 2.0 * math.pi / peak_wavelength(wind_speed)
    whole = math.log(max(_SHORTEST_RIPPLE / min(peak, from_wavenumber), math.e))
    return mean_square_slope(wind_speed) * min(math.log(max(to_wavenumber / from_wavenumber, math.e)) / whole, 1.0)


def angular_frequency(wavenumber: ArrayLike, water_depth_m: float) -> Array:
    """Return the angular frequency [rad/s] of waves of a wavenumber [rad/m] on water of a depth (infinity: deep)."""
    k = np.asarray(wavenumber, np.float64)
    shallow = np.tanh(np.minimum(k * water_depth_m, 50.0)) if np.isfinite(water_depth_m) else 1.0
    return np.sqrt((GRAVITY_M_S2 * k + SURFACE_TENSION_OVER_DENSITY * k**3) * shallow)


def group_speed(wavenumber: ArrayLike, water_depth_m: float) -> Array:
    """Return d omega/d k [m/s], the derivative of `angular_frequency`."""
    k = np.asarray(wavenumber, np.float64)
    restoring = GRAVITY_M_S2 * k + SURFACE_TENSION_OVER_DENSITY * k**3
    slope = GRAVITY_M_S2 + 3.0 * SURFACE_TENSION_OVER_DENSITY * k**2
    if not np.isfinite(water_depth_m):
        return slope / (2.0 * np.sqrt(restoring))
    kh = np.minimum(k * water_depth_m, 50.0)
    tanh = np.tanh(kh)
    return (slope * tanh + restoring * water_depth_m / np.cosh(kh) ** 2) / (2.0 * np.sqrt(restoring * tanh))


def looping_frequency(frequency: ArrayLike, loop_s: float | None) -> Array:
    """Return angular frequencies moved to the nearest multiple of 2 pi/loop_s, at least one; None leaves them."""
    w = np.asarray(frequency, np.float64)
    if loop_s is None:
        return w
    base = 2.0 * np.pi / loop_s
    return base * np.maximum(np.round(w / base), 1.0)


def lattice_vector(wave_vector: ArrayLike, tile_m: float) -> Array:
    """Return wave vectors (n, 2) [rad/m] moved to the nearest non-zero point of the lattice 2 pi (m, n)/tile_m."""
    unit = 2.0 * np.pi / tile_m
    k = np.asarray(wave_vector, np.float64) / unit
    nearest = np.round(k)
    along_x = np.abs(k[..., 0]) >= np.abs(k[..., 1])
    smallest = np.where(along_x[..., None], [1.0, 0.0], [0.0, 1.0]) * np.where(k < 0.0, -1.0, 1.0)
    return unit * np.where(np.any(nearest != 0.0, axis=-1, keepdims=True), nearest, smallest)


_PEAK_ENHANCEMENT = 3.3
"""Mean sharpness gamma of the peaks of the JONSWAP measurements; 1: a fully developed sea, as Pierson & Moskowitz's."""
_GROWING_PEAK, _GROWING_ALPHA = 22.0, 0.076
"""Peak frequency and constant alpha of a growing sea (Hasselmann et al. 1973): u w_p/g = 22 x^(-1/3), alpha = 0.076
x^(-0.22) at a fetch x = g F/u^2."""
PHILLIPS_ALPHA = 8.1e-3
"""Phillips' constant alpha of the equilibrium range of a fully developed sea."""
_SHARPNESS_ENERGY = 0.287
"""A peak of sharpness gamma has 1/(1 - 0.287 ln gamma) of the energy of one of gamma 1 (DNV-RP-C205, 3.5.5)."""
_FULL_FETCH = (_GROWING_PEAK / _PEAK_FREQUENCY) ** 3
"""Fetch g F/u^2 at which the peak has come to that of a fully developed sea: 28 km at 4 m/s."""
_FULL_ENERGY_FETCH = (
    PHILLIPS_ALPHA * (1.0 - _SHARPNESS_ENERGY * math.log(_PEAK_ENHANCEMENT)) / _GROWING_ALPHA
    * (_GROWING_PEAK / _PEAK_FREQUENCY) ** 4
) ** (1.0 / (4.0 / 3.0 - 0.22))  # fmt: skip
"""Fetch at which a growing sea has the energy of a fully developed one: 18 km at 4 m/s."""


def peak_frequency(wind_speed: float, fetch_m: float) -> float:
    """Return the angular frequency [rad/s] of the peak of a wind sea (Hasselmann et al. 1973).

    It falls with the fetch, down to that of a fully developed sea (Pierson & Moskowitz 1964).
    """
    fetch = min(GRAVITY_M_S2 * fetch_m / wind_speed**2, _FULL_FETCH)
    return _GROWING_PEAK * GRAVITY_M_S2 / wind_speed * fetch ** (-1.0 / 3.0)


def jonswap(frequency: Array, wind_speed: float, fetch_m: float) -> Array:
    """Return S(omega) [m^2 s] of a wind sea that grows with the fetch until it is fully developed.

    Up to the fetch where a growing sea (Hasselmann et al. 1973) has the energy of a fully developed one, it is that
    sea. From there on the energy stays; the peak moves on to Pierson & Moskowitz's and loses its sharpness, and then
    the spectrum is theirs. It changes continuously with wind and fetch.
    """
    fetch = min(GRAVITY_M_S2 * fetch_m / wind_speed**2, _FULL_FETCH)
    growing = math.log(_FULL_FETCH / max(fetch, _FULL_ENERGY_FETCH)) / math.log(_FULL_FETCH / _FULL_ENERGY_FETCH)
    sharpness = _PEAK_ENHANCEMENT**growing
    peak, developed = peak_frequency(wind_speed, fetch_m), _PEAK_FREQUENCY * GRAVITY_M_S2 / wind_speed
    of_full_energy = PHILLIPS_ALPHA * (peak / developed) ** 4 * (1.0 - _SHARPNESS_ENERGY * math.log(sharpness))
    alpha = min(_GROWING_ALPHA * fetch**-0.22, of_full_energy)
    width = np.where(frequency <= peak, 0.07, 0.09)
    r = np.exp(-((frequency - peak) ** 2) / (2.0 * width**2 * peak**2))
    tail = np.exp(-1.25 * np.minimum((peak / frequency) ** 4, 500.0))
    return alpha * GRAVITY_M_S2**2 * frequency**-5.0 * tail * sharpness**r


def tma_factor(frequency: Array, water_depth_m: float) -> Array:
    """Return the factor of shallow water, 1 where it is deep (Thompson & Vincent 1983)."""
    w = frequency * np.sqrt(water_depth_m / GRAVITY_M_S2)
    return np.where(w <= 1.0, 0.5 * w * w, np.where(w < 2.0, 1.0 - 0.5 * (2.0 - np.minimum(w, 2.0)) ** 2, 1.0))


def cosine_power_share(exponent: float) -> float:
    """Return the factor on cos^p of the angle to the wind whose integral over the half turn about it is 1."""
    return math.exp(math.lgamma(0.5 * exponent + 1.0) - math.lgamma(0.5 * exponent + 0.5)) / math.sqrt(math.pi)


def cosine_spread(angle: Array, frequency: Array, wind_speed: float, fetch_m: float) -> Array:
    """Return the directional distribution [1/rad], integral 1: cos^2s(angle/2) (Hasselmann et al. 1980)."""
    from scipy.special import gammaln

    ratio = frequency / peak_frequency(wind_speed, fetch_m)
    # the branches meet at 1.046 peak frequencies: parted at the peak itself, a wave would jump as the wind grows
    s = np.minimum(9.77 * ratio**-2.5, 6.97 * ratio**5.0)
    log_normal = gammaln(s + 1.0) - gammaln(s + 0.5) - np.log(2.0 * np.sqrt(np.pi))
    half = np.maximum(np.abs(np.cos(0.5 * angle)), 1e-30)
    return np.exp(log_normal + 2.0 * s * np.log(half))
