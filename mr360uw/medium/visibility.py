# SPDX-License-Identifier: Apache-2.0
"""Water of a visibility: the horizontal distance at which a diver loses sight of a black target.

    V = 4.8/e(532 nm)        e = a + b_m + w b_p

e: attenuation [1/m] of contrast, by absorption, by molecules and by the fraction w of the particles' scattering that
is by wide angles; the rest blurs a picture and leaves its contrast (`phase.wide_angle_moments`). The contrast of a
black target against the water around it falls off as exp(-e V), whatever the light (Koschmieder 1924, Duntley 1963); it
is lost at 0.8 %, ln(1/0.008) = 4.8 (Zaneveld & Pegau 2003, who count all scattering that a transmissometer loses).
"""

from __future__ import annotations

import functools

import numpy as np

from mr360uw.cache import shared
from mr360uw.errors import ParameterError
from mr360uw.medium.phase import Phase, wide_angle_moments
from mr360uw.medium.tables import Spectrum
from mr360uw.medium.water import JerlovType, Water, molecular_part

CONTRAST_LENGTHS = 4.8
"""Attenuation lengths of contrast at which a black target is lost."""
SIGHT_NM = 532.0
"""Wavelength [nm] of that attenuation: the eye's in water, and that of most instruments."""
LEAST_M, MOST_M = 0.5, 90.0
"""Range [m] of visibilities: mud, and that of type I."""
_CLEAR_TO_MURKY: tuple[JerlovType, ...] = ("I", "IA", "IB", "1C", "3C", "5C", "7C", "9C")
"""Types that waters of a visibility lie between: clear water is mostly that of the ocean, murky water coastal."""


def visibility_m(water: Water) -> float:
    """Return the visibility [m] of a water."""
    molecular = float(water.molecular(SIGHT_NM)) if water.molecular else 0.0
    by_particles = float(wide_angle_moments(water.phase, 1)[0]) * (float(water.scattering(SIGHT_NM)) - molecular)
    return CONTRAST_LENGTHS / (float(water.absorption(SIGHT_NM)) + molecular + by_particles)


@shared(keep=64)
def water_of_visibility(sight_m: float) -> Water:
    """Return the water between two neighbouring Jerlov types whose visibility is `sight_m` [m], 0.5 to 90.

    The logarithms of a, b and Kd are mixed at every wavelength, so Kd is nowhere below a. Below the 3.7 m of type 9C
    the line from 7C to 9C goes on. Raises `ParameterError` outside the range.
    """
    _check(sight_m)
    types = [Water.jerlov(name) for name in _CLEAR_TO_MURKY]
    place = int(np.searchsorted([-visibility_m(water) for water in types], -sight_m))
    clear, murky = types[min(max(place, 1), len(types) - 1) - 1 :][:2]
    low, high = 0.0, _FARTHEST
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if visibility_m(_between(clear, murky, middle)) > sight_m else (low, middle)
    return _between(clear, murky, low)


@shared(keep=64)
def water_seen_as_far(water: Water, sight_m: float) -> Water:
    """Return a water with another visibility [m], 0.5 to 90: with less of all that is in it, or with more particles.

    Clearer: what it has beyond pure sea water becomes less, in the same proportions. Murkier: its particles scatter
    more and its absorption stays, which gives the water its colour; where it has next to none, they scatter as
    1/wavelength (Loisel & Morel 1998). Kd is that of Lee et al. 2005. Raises `ParameterError` outside the range.
    """
    _check(sight_m)
    pure = Water.pure()
    wanted = CONTRAST_LENGTHS / sight_m
    nm = functools.reduce(np.union1d, [s.wavelength_nm for s in (pure.a, pure.b, water.a, water.b)])
    nm = nm[(nm >= water.range_nm[0]) & (nm <= water.range_nm[1])]
    absorption, molecular = pure.absorption(nm), np.minimum(pure.scattering(nm), water.scattering(nm))
    more_a, more_b = (np.maximum(v, 0.0) for v in (water.absorption(nm) - absorption, water.scattering(nm) - molecular))
    phase: Phase = "petzold" if water.phase == "water" else water.phase
    wide = float(wide_angle_moments(phase, 1)[0])
    clear, own_a, own_b = (float(np.interp(SIGHT_NM, nm, v)) for v in (absorption + molecular, more_a, more_b))
    if wanted < clear + own_a + wide * own_b:
        share = max(wanted - clear, 0.0) / (own_a + wide * own_b)
        more_a, more_b = share * more_a, share * more_b
    else:
        shape = more_b / own_b if own_b > _NO_PARTICLES else SIGHT_NM / nm
        more_b = (wanted - clear - own_a) / wide * shape
    name = f"{water.name}, {sight_m:g} m visibility"
    b = Spectrum(f"{name}, scattering", nm, molecular + more_b)
    return Water(
        name,
        Spectrum(f"{name}, absorption", nm, absorption + more_a),
        b,
        phase=phase,
        molecular=Spectrum(f"{name}, molecular scattering", nm, molecular),
        source=water.source,
    )


_NO_PARTICLES = 1e-3
"""Scattering [1/m] by particles below which their spectrum is not told: type I has none, type IA 0.002."""
_FARTHEST = 8.0
"""How many times the step from 7C to 9C is taken at most: to 0.2 m, beyond the range."""


def _check(sight_m: float) -> None:
    if not LEAST_M <= sight_m <= MOST_M:
        raise ParameterError(
            f"visibility - is out of range (got {sight_m:g} m) - give {LEAST_M:g} to {MOST_M:g}, or a type"
        )


def _between(clear: Water, murky: Water, share: float) -> Water:
    kd = (clear.kd, murky.kd)
    assert kd[0] is not None
    assert kd[1] is not None
    name = f"water between {clear.name} and {murky.name}"

    def mixed(label: str, one: Spectrum, other: Spectrum) -> Spectrum:
        nm = one.wavelength_nm[(one.wavelength_nm >= 400.0) & (one.wavelength_nm <= 700.0)]
        return Spectrum(f"{name}, {label}", nm, one(nm) ** (1.0 - share) * other(nm) ** share)

    a, b = mixed("absorption", clear.a, murky.a), mixed("scattering", clear.b, murky.b)
    source = f"between the types: {clear.source}"
    return Water(name, a, b, mixed("Kd", kd[0], kd[1]), clear.phase, molecular_part(b), source)
