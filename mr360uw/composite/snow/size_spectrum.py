# SPDX-License-Identifier: Apache-2.0
"""Size spectrum of particles in the sea, its amount from the water's scattering, and the speed at which they sink.

    symbol  meaning                                     unit
    d       diameter                                    m
    q       exponent
    A       of the spectrum dN/dd = A d^-q              m^(q - 4)
    b_p     scattering by particles                     1/m

One power law holds from 1 um to 1 cm. The exponent is 4 where every octave of size has the same volume (Sheldon et al.
1972), and 2.96 to 3.00 in a bloom of diatoms off Monterey (Jackson et al. 1997). Particles are taken to scatter twice
their cross-section, which holds for those much larger than a wavelength (van de Hulst 1980). Then

    b_p = 2 (pi/4) A M        M = int d^(2 - q) dd = (d_1^(3 - q) - d_0^(3 - q))/(3 - q), or ln(d_1/d_0) for q = 3

gives A, and A gives the number of those that are large enough to be seen: with q = 4 and b_p = 0.1 1/m, 170 aggregates
of at least 0.5 mm in a cubic metre. The exponent decides: with q = 3 there are 80 times as many. Aggregates from 0.5 mm
on are called marine snow (Alldredge & Silver 1988); they sink at 50 (d/mm)^0.26 m/day (Alldredge & Gotschalk 1988).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mr360uw.composite.snow.settings import SnowSettings
from mr360uw.constants import PI
from mr360uw.medium.water import Water

SMALLEST_M, LARGEST_M = 1e-6, 1e-2
"""Diameters between which the power law is taken to hold (Jackson et al. 1997)."""
EFFICIENCY = 2.0
"""Scattering over geometric cross-section of particles much larger than a wavelength."""
SCATTERING_NM = 550.0
"""Wavelength at which the water's scattering is read."""
_SINKING_M_S, _SINKING_POWER = 50.0 / 86400.0, 0.26
"""Speed of an aggregate of 1 mm, and its exponent over the diameter."""


@dataclass(frozen=True, slots=True)
class SizeClass:
    """Particles of about one octave of size. low_m, high_m: diameters. per_m3: number. sinking_m_s: downwards."""

    low_m: float
    high_m: float
    per_m3: float
    sinking_m_s: float


def particle_scattering(water: Water) -> float:
    """Return the scattering [1/m] by the particles of a water at `SCATTERING_NM`, without that by molecules."""
    nm = np.array([SCATTERING_NM])
    molecules = 0.0 if water.molecular is None else float(np.asarray(water.molecular(nm))[0])
    return max(float(np.asarray(water.scattering(nm))[0]) - molecules, 0.0)


def number_between(low_m: float, high_m: float, exponent: float, scattering: float) -> float:
    """Return the number of particles [1/m^3] with diameters between two. scattering: by all particles [1/m]."""
    return _scale(exponent, scattering) * _integral(low_m, high_m, -exponent)


def cross_section_between(low_m: float, high_m: float, exponent: float, scattering: float) -> float:
    """Return the geometric cross-section [1/m] of the particles with diameters between two, in a cubic metre."""
    return 0.25 * PI * _scale(exponent, scattering) * _integral(low_m, high_m, 2.0 - exponent)


def size_classes(settings: SnowSettings, scattering: float) -> tuple[SizeClass, ...]:
    """Return the classes of a scene's particles, from the smallest on. scattering: by the water's particles [1/m]."""
    smallest, largest = 1e-3 * settings.smallest_mm, 1e-3 * settings.largest_mm
    count = max(math.ceil(math.log2(largest / smallest) - 1e-9), 1)
    classes = []
    for number in range(count):
        low, high = smallest * 2.0**number, min(smallest * 2.0 ** (number + 1), largest)
        per_m3 = settings.amount * number_between(low, high, settings.exponent, scattering)
        middle_mm = 1e3 * math.sqrt(low * high)
        classes.append(SizeClass(low, high, per_m3, settings.settling * _SINKING_M_S * middle_mm**_SINKING_POWER))
    return tuple(classes)


def in_words(settings: SnowSettings, water: Water) -> tuple[bool, str]:
    """Return whether a water has any snow to draw, and its number, or why there is none, as the plan shows it."""
    per_m3 = sum(size.per_m3 for size in size_classes(settings, particle_scattering(water)))
    if per_m3 <= 0.0:
        return False, "snow.amount is 0" if settings.amount == 0.0 else "the water has no particles that scatter"
    near, far, ball = settings.nearest_m, settings.range_m, 4.0 / 3.0 * PI
    within = ball * (far**3 - near**3) * per_m3
    return True, (
        f"{per_m3:.3g} particles of {settings.smallest_mm:g} to {settings.largest_mm:g} mm in a cubic metre, from the "
        f"water's scattering; {within:.2g} within {far:g} m, of which those that a pixel shows are drawn"
    )


def _scale(exponent: float, scattering: float) -> float:
    """Return A of the spectrum."""
    return scattering / (EFFICIENCY * 0.25 * PI * _integral(SMALLEST_M, LARGEST_M, 2.0 - exponent))


def _integral(low: float, high: float, power: float) -> float:
    """Return the integral of x^power between two positive numbers."""
    if abs(power + 1.0) < 1e-9:
        return math.log(high / low)
    return (high ** (power + 1.0) - low ** (power + 1.0)) / (power + 1.0)
