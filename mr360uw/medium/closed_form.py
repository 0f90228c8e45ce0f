# SPDX-License-Identifier: Apache-2.0
"""Closed forms of light in water: radiance scattered into a ray, and how far one sees.

    L = b E/(4 pi) exp(-K y) (1 - exp(-(c - K mu) S)) / (c - K mu)

b, c, K: scattering, beam and diffuse attenuation [1/m]; E: irradiance just below the surface; y: depth of the camera;
mu: y of the view direction, +1 straight up; S: length of the ray, cut where it leaves the water. Monzon et al. 2022
eq. 4, with the signs that make it hold (looking up is brighter); the same as Monzon et al. 2024 eq. 9. The quotient is
written so that nothing overflows, whatever the sign of c - K mu, and so that c = K mu is no special case.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.cache import shared
from mr360uw.base.constants import BRIGHTEST_LOG, INV_4PI, LONGEST_RAY_M
from mr360uw.base.parameters import checked, common_shape, exactly, numbers
from mr360uw.errors import ParameterError
from mr360uw.medium.phase import Phase, wide_angle_moments
from mr360uw.medium.spectra import Spectrum
from mr360uw.medium.water import JerlovType, Water, molecular_part
from mr360uw.types import Array


def together(*values: ArrayLike) -> tuple[Array, ...]:
    """Return numbers as arrays of one shape, to which they are repeated; read only."""
    return tuple(np.broadcast_arrays(*(np.asarray(x, np.float64) for x in values)))


def ray_in_water(distance: ArrayLike, depth: ArrayLike, up: ArrayLike) -> Array:
    """Return the length (...,) [m] of a ray from `depth` that lies below the mean surface, at most `LONGEST_RAY_M`."""
    common_shape("distance_m", distance_m=distance, depth_m=depth, up=up)
    s, y, mu = together(distance, depth, up)
    out = np.divide(np.maximum(y, 0.0), mu, out=np.full(s.shape, LONGEST_RAY_M), where=mu > 0.0)
    return np.minimum(np.maximum(s, 0.0), np.minimum(out, LONGEST_RAY_M))


def _mean_transmittance(x: ArrayLike) -> Array:
    """Return (1 - exp(-x))/x, the mean of exp(-x t) over t in [0, 1], for x >= 0."""
    x = np.asarray(x, np.float64)
    return np.divide(-np.expm1(-x), x, out=np.ones(x.shape), where=x > 0.0)


def path_integral(c: ArrayLike, k: ArrayLike, s: ArrayLike, y: ArrayLike, mu: ArrayLike) -> Array:
    """Return the integral of exp(-c t - k (y - t mu)) over t in [0, s] [m]; s must end below the surface."""
    c, k, s, y, mu = (np.asarray(x, np.float64) for x in (c, k, s, y, mu))
    q = (c - k * mu) * s
    return s * np.exp(-k * y - np.minimum(q, 0.0)) * _mean_transmittance(np.abs(q))


def exponential_integral(rate: ArrayLike, start: ArrayLike, end: ArrayLike) -> Array:
    """Return the integral of exp(-rate t) over t from start to end [m], for a rate [1/m] of either sign.

    The integrand is bounded by exp(`BRIGHTEST_LOG`).
    """
    length = np.subtract(end, start, dtype=np.float64)
    brightest = np.minimum(-np.minimum(np.multiply(rate, start), np.multiply(rate, end)), BRIGHTEST_LOG)
    return length * np.exp(brightest) * _mean_transmittance(np.abs(rate * length))


def closed_form(b: ArrayLike, c: ArrayLike, k: ArrayLike, s: ArrayLike, y: ArrayLike, mu: ArrayLike) -> Array:
    """Return the radiance (...,) [1/sr] scattered into a ray of length s from depth y, per unit surface irradiance."""
    s = ray_in_water(s, y, mu)
    return np.asarray(b, np.float64) * INV_4PI * path_integral(c, k, s, np.maximum(y, 0.0), mu)


@checked
def multiple_scattering(
    water: Water,
    wavelength_nm: ArrayLike,
    distance_m: ArrayLike,
    depth_m: ArrayLike,
    up: ArrayLike,
    surface_irradiance: ArrayLike = 1.0,
) -> Array:
    """Return the radiance scattered into camera rays by the published closed form.

    Nothing is solved, but scattering is taken as isotropic, and light as one exponential over depth. Against the solved
    field the veil is off by about half, so take it for comparisons.

    Parameters
    ----------
    water : Water
        Its b, c and Kd are used.
    wavelength_nm : array_like
        Wavelengths (n,) [nm].
    distance_m : array_like
        Lengths (...,) [m] of the rays, which may be infinite; rays end at the surface.
    depth_m : array_like
        Depths (...,) [m] of the camera, at least 0.
    up : array_like
        The y components (...,) of the view directions, -1 to 1.
    surface_irradiance : array_like
        Downwelling irradiance just below the surface, one number or (n,).

    Returns
    -------
    ndarray
        Radiance (..., n), in units of the irradiance per sr.

    Raises
    ------
    ParameterError
        If a distance or depth is negative, or `up` outside [-1, 1].

    See Also
    --------
    uw.medium.LightField.inscatter : The solved field.
    uw.medium.Medium : Both as a camera sees them.

    Notes
    -----
    Monzon et al. 2022, equation 4: L = b E/(4 pi) exp(-K y) (1 - exp(-(c - K mu) S))/(c - K mu), in a form that is
    stable for every c - K mu.

    Examples
    --------
    >>> water = uw.medium.Water.jerlov("IB")
    >>> uw.medium.multiple_scattering(water, [450.0, 550.0], [1.0, 10.0], 5.0, 0.0).round(4)
    array([[0.0044, 0.0028],
           [0.0299, 0.0176]])
    """
    check_ray(distance_m, depth_m, up)
    w = np.atleast_1d(numbers("wavelength_nm", wavelength_nm).astype(np.float64))
    s, y, mu = (np.asarray(x, np.float64)[..., None] for x in (distance_m, depth_m, up))
    radiance = closed_form(water.scattering(w), water.attenuation(w), water.diffuse_attenuation(w), s, y, mu)
    return exactly("surface_irradiance", surface_irradiance, (), w.shape) * radiance


def check_ray(distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> None:
    """Raise `ParameterError` unless distance >= 0, 0 <= depth < infinity, -1 <= up <= 1, of shapes that fit."""
    common_shape("distance_m", distance_m=distance_m, depth_m=depth_m, up=up)
    if not np.all(np.asarray(distance_m) >= 0.0):
        raise ParameterError(
            f"distance_m - must not be negative (got {np.min(distance_m)!r}) - give metres along the ray"
        )
    if not np.all(np.isfinite(depth_m) & (np.asarray(depth_m) >= 0.0)):
        raise ParameterError(
            f"depth_m - must be a depth below the surface (got {np.min(depth_m)!r}) - give metres >= 0"
        )
    if not np.all(np.abs(np.asarray(up)) <= 1.0 + 1e-9):
        raise ParameterError(f"up - must be the y of a unit vector (got {np.max(np.abs(up))!r}) - scale it to length 1")


# Water of a visibility: the horizontal distance at which a diver loses sight of a black target.
#
#     V = 4.8/e(532 nm)        e = a + b_m + w b_p
#
# e: attenuation [1/m] of contrast, by absorption, by molecules and by the fraction w of the particles' scattering that
# is by wide angles; the rest blurs a picture and leaves its contrast (`phase.wide_angle_moments`). The contrast of a
# black target against the water around it falls off as exp(-e V), whatever the light (Koschmieder 1924, Duntley 1963);
# it is lost at 0.8 %, ln(1/0.008) = 4.8 (Zaneveld & Pegau 2003, who count all scattering that a transmissometer loses).

CONTRAST_LENGTHS = 4.8
"""Attenuation lengths of contrast at which a black target is lost."""
_SIGHT_NM = 532.0
"""Wavelength [nm] of that attenuation: the eye's in water, and that of most instruments."""
LEAST_M, MOST_M = 0.5, 90.0
"""Range [m] of visibilities: mud, and that of type I."""
_CLEAR_TO_MURKY: tuple[JerlovType, ...] = ("I", "IA", "IB", "1C", "3C", "5C", "7C", "9C")
"""Types that waters of a visibility lie between: clear water is mostly that of the ocean, murky water coastal."""


def visibility_m(water: Water) -> float:
    """Return the visibility [m] of a water."""
    molecular = float(water.molecular(_SIGHT_NM)) if water.molecular else 0.0
    by_particles = float(wide_angle_moments(water.phase, 1)[0]) * (float(water.scattering(_SIGHT_NM)) - molecular)
    return CONTRAST_LENGTHS / (float(water.absorption(_SIGHT_NM)) + molecular + by_particles)


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
    # Split absorption and scattering into those of pure water and of what is in it
    pure = Water.pure()
    wanted = CONTRAST_LENGTHS / sight_m
    nm = functools.reduce(np.union1d, [s.wavelength_nm for s in (pure.a, pure.b, water.a, water.b)])
    nm = nm[(nm >= water.range_nm[0]) & (nm <= water.range_nm[1])]
    absorption, molecular = pure.absorption(nm), np.minimum(pure.scattering(nm), water.scattering(nm))
    more_a, more_b = (np.maximum(v, 0.0) for v in (water.absorption(nm) - absorption, water.scattering(nm) - molecular))
    phase: Phase = "petzold" if water.phase == "water" else water.phase
    # Attenuation of contrast at the wavelength of the eye: clear water, and what is added
    wide = float(wide_angle_moments(phase, 1)[0])
    clear, own_a, own_b = (float(np.interp(_SIGHT_NM, nm, v)) for v in (absorption + molecular, more_a, more_b))
    # Thin out all that is added, or add particles of the same colour
    if wanted < clear + own_a + wide * own_b:
        share = max(wanted - clear, 0.0) / (own_a + wide * own_b)
        more_a, more_b = share * more_a, share * more_b
    else:
        shape = more_b / own_b if own_b > _NO_PARTICLES else _SIGHT_NM / nm
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
"""Most steps from 7C to 9C that are taken: to 0.2 m, beyond the range."""


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
