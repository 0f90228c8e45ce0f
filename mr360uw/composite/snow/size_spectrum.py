# SPDX-License-Identifier: Apache-2.0
"""Size spectrum of particles in the sea, its amount from the water's scattering, and the speed at which they sink.

    symbol  meaning                                     unit
    d       diameter                                    m
    q       exponent
    A       of the spectrum dN/dd = A d^-q              m^(q - 4)
    b_p     scattering by particles                     1/m

One power law holds from 1 um to 1 cm. Measured exponents run from 3 in a bloom off Monterey, where they were 2.96 to
3.00 (Jackson et al. 1997), to 4, where every octave of size has the same volume (Sheldon et al. 1972). The default is
that of the particles whose phase function is Petzold's average (Mobley et al. 2002). Particles are taken to scatter
twice their cross-section, which holds for those much larger than a wavelength (van de Hulst 1980). Then

    b_p = 2 (pi/4) A M        M = int d^(2 - q) dd = (d_1^(3 - q) - d_0^(3 - q))/(3 - q), or ln(d_1/d_0) for q = 3

gives A, and A the number of those that are large enough to be seen. The exponent decides: for b_p = 0.1 1/m there are
170, 1600 or 14000 aggregates of at least 0.5 mm in a cubic metre with q = 4, 3.58 or 3. Aggregates from that size on
are called marine snow; they sink at 50 (d/mm)^0.26 m/day (Alldredge & Gotschalk 1988).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mr360uw.composite.snow.settings import NEAREST_M, SnowSettings
from mr360uw.constants import PI
from mr360uw.medium.water import Water

SMALLEST_M, LARGEST_M = 1e-6, 1e-2
"""Diameters between which the power law is taken to hold (Jackson et al. 1997)."""
EFFICIENCY = 2.0
"""Scattering over geometric cross-section of particles much larger than a wavelength."""
SCATTERING_NM = 550.0
"""Wavelength at which the water's scattering is read."""
LEAST_COVER = 1.0 / 40.0
"""Fraction of a pixel that a particle must cover to be drawn at all, times the transmittance of the water before it; at
twice that it is drawn in full. Particles just above it are hard to tell from the noise of a video. Half as large: two
to three times as many, at as much more time. Those that are too small or too far are a part of the veil."""
_FEWEST, _MOST = 1.0, 5e5
"""Particles of a frame below and above which there is a note."""
_PARTICLE_S = 4e-6
"""Processor time of a particle [s]."""
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
    scale = scattering / (EFFICIENCY * 0.25 * PI * _integral(SMALLEST_M, LARGEST_M, 2.0 - exponent))
    return scale * _integral(low_m, high_m, -exponent)


def size_classes(settings: SnowSettings, scattering: float) -> tuple[SizeClass, ...]:
    """Return the classes of a scene's particles, from the smallest on. scattering: by the water's particles [1/m]."""
    smallest, largest = (1e-3 * size for size in settings.sizes_mm)
    count = max(math.ceil(math.log2(largest / smallest) - 1e-9), 1)
    classes = []
    for number in range(count):
        low, high = smallest * 2.0**number, min(smallest * 2.0 ** (number + 1), largest)
        per_m3 = settings.amount * number_between(low, high, settings.exponent, scattering)
        middle_mm = 1e3 * math.sqrt(low * high)
        classes.append(SizeClass(low, high, per_m3, _SINKING_M_S * middle_mm**_SINKING_POWER))
    return tuple(classes)


def seen_up_to(height: int) -> float:
    """Return the distance over the diameter of a particle that covers `LEAST_COVER` of a pixel of a frame's height."""
    return math.sqrt(0.25 * PI / LEAST_COVER) * height / PI


def number_drawn(settings: SnowSettings, scattering: float, height: int) -> float:
    """Return about how many particles a frame of a height [pixels] shows in clear water.

    Those of a class up to where one of its middle size covers `LEAST_COVER` of a pixel. scattering: see `size_classes`.
    """
    number = 0.0
    for size in size_classes(settings, scattering):
        reach = min(settings.range_m, seen_up_to(height) * math.sqrt(size.low_m * size.high_m))
        number += size.per_m3 * 4.0 / 3.0 * PI * max(reach**3 - NEAREST_M**3, 0.0)
    return number


def note_on(settings: SnowSettings, water: Water, height: int) -> str:
    """Return a line on snow that frames of `height` rows do not show or that takes them seconds, "" for other snow."""
    number = number_drawn(settings, particle_scattering(water), height)
    if 0.0 < number < _FEWEST:
        return f"snow - a frame shows none (got {number:.2g} particles large enough to see) - raise snow.amount"
    if number > _MOST:
        took = f"got {number:.2g} particles, up to {number * _PARTICLE_S:.0f} s a frame"
        return f"snow - is dense ({took}) - lower snow.amount or snow.range_m, or raise the first of snow.sizes_mm"
    return ""


def in_words(settings: SnowSettings, water: Water) -> tuple[bool, str]:
    """Return whether a water has any snow to draw, and its number, or why there is none, as the plan shows it."""
    per_m3 = sum(size.per_m3 for size in size_classes(settings, particle_scattering(water)))
    if per_m3 <= 0.0:
        return False, "the water has no particles that scatter"
    near, far, ball = NEAREST_M, settings.range_m, 4.0 / 3.0 * PI
    within = ball * (far**3 - near**3) * per_m3
    return True, (
        f"{per_m3:.3g} particles of {settings.sizes_mm[0]:g} to {settings.sizes_mm[1]:g} mm in a cubic metre, from the "
        f"water's scattering; {within:.2g} within {far:g} m, of which those that a pixel shows are drawn"
    )


def _integral(low: float, high: float, power: float) -> float:
    """Return the integral of x^power between two positive numbers."""
    if abs(power + 1.0) < 1e-9:
        return math.log(high / low)
    return (high ** (power + 1.0) - low ** (power + 1.0)) / (power + 1.0)
