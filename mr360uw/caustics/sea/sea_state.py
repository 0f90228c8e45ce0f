# SPDX-License-Identifier: Apache-2.0
"""Statistics of a wind sea: wavelength of its peak and mean square slope of its waves."""

from __future__ import annotations

import math

from mr360uw.constants import GRAVITY_M_S2

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
