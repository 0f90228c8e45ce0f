# SPDX-License-Identifier: Apache-2.0
"""Water of a visibility: the horizontal distance at which a diver loses sight of a black target.

    V = 4.8/c(532 nm)

c: beam attenuation [1/m]. The contrast of a black target against the water around it falls off as exp(-c V), whatever
the light (Koschmieder 1924, Duntley 1963); it is lost at 0.8 %, ln(1/0.008) = 4.8 (Zaneveld & Pegau 2003).
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.medium.jerlov import JerlovType, molecular_part
from mr360uw.medium.tables import Spectrum
from mr360uw.medium.water import Water

Array = NDArray[np.float64]

CONTRAST_LENGTHS = 4.8
"""Beam attenuation lengths at which a black target is lost."""
SIGHT_NM = 532.0
"""Wavelength [nm] of that attenuation: the eye's in water, and that of most instruments."""
LEAST_M, MOST_M = 0.5, 90.0
"""Range [m] of visibilities: mud, and that of type I."""
_CLEAR_TO_MURKY: tuple[JerlovType, ...] = ("I", "IA", "IB", "1C", "3C", "5C", "7C", "9C")
"""Types that waters of a visibility lie between: clear water is mostly that of the ocean, murky water coastal."""


def visibility_m(water: Water) -> float:
    """Return the visibility [m] of a water."""
    return CONTRAST_LENGTHS / float(water.attenuation(SIGHT_NM))


@functools.lru_cache(maxsize=64)
def water_of_visibility(sight_m: float) -> Water:
    """Return the water between two neighbouring Jerlov types whose visibility is `sight_m` [m], 0.5 to 90.

    The logarithms of a, b and Kd are mixed at every wavelength, so Kd is nowhere below a. Below the 1.3 m of type 9C
    the line from 7C to 9C goes on. Raises `ParameterError` outside the range.
    """
    if not LEAST_M <= sight_m <= MOST_M:
        raise ParameterError(
            f"visibility - is out of range (got {sight_m:g} m) - give {LEAST_M:g} to {MOST_M:g}, or a type"
        )
    types = [Water.jerlov(name) for name in _CLEAR_TO_MURKY]
    place = int(np.searchsorted([-visibility_m(water) for water in types], -sight_m))
    clear, murky = types[min(max(place, 1), len(types) - 1) - 1 :][:2]
    parts = [_nodes(clear.a, murky.a), _nodes(clear.b, murky.b)]
    low, high = 0.0, _FARTHEST
    for _ in range(50):
        middle = 0.5 * (low + high)
        attenuation = sum(float(np.interp(SIGHT_NM, nm, _mixed(a, b, middle))) for nm, a, b in parts)
        low, high = (middle, high) if CONTRAST_LENGTHS / attenuation > sight_m else (low, middle)
    return _between(clear, murky, low)


_FARTHEST = 8.0
"""How many times the step from 7C to 9C is taken at most: to 0.2 m, beyond the range."""


def _nodes(one: Spectrum, other: Spectrum) -> tuple[Array, Array, Array]:
    """Return the visible wavelengths (w,) [nm] of a spectrum, and its values and another's there."""
    nm = one.wavelength_nm[(one.wavelength_nm >= 400.0) & (one.wavelength_nm <= 700.0)]
    return nm, one(nm), other(nm)


def _mixed(one: Array, other: Array, share: float) -> Array:
    """Return values with mixed logarithms; share: of the other."""
    return np.asarray(one ** (1.0 - share) * other**share)


def _between(clear: Water, murky: Water, share: float) -> Water:
    kd = (clear.kd, murky.kd)
    assert kd[0] is not None
    assert kd[1] is not None
    name = f"water between {clear.name} and {murky.name}"

    def mixed(label: str, one: Spectrum, other: Spectrum) -> Spectrum:
        nm, first, second = _nodes(one, other)
        return Spectrum(f"{name}, {label}", nm, _mixed(first, second, share))

    a, b = mixed("absorption", clear.a, murky.a), mixed("scattering", clear.b, murky.b)
    source = f"between the types: {clear.source}"
    return Water(name, a, b, mixed("Kd", kd[0], kd[1]), clear.phase, molecular_part(b), source)
