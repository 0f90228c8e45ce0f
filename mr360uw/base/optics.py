# SPDX-License-Identifier: Apache-2.0
"""Refraction and reflection at the water surface: Snell's law, Fresnel's equations, the index of sea water.

    symbol    here               meaning
    n         refractive_index   of water relative to air, > 1
    m         relative_index     of the medium behind the surface over that before it: n into water, 1/n out of it
    c_i       cos_air            cosine between a direction in air and the surface normal
    c_t       cos_water          the same in the water

Equations: Born & Wolf 1999 section 1.5 (Snell, Fresnel); Quan & Fry 1995 eq. 3 (index of sea water). Radiance over the
square of the index is kept across a surface but for what is reflected (the n^2 law). Directions are unit vectors that
point towards the light; `refract_clamped` and `reflect` take the direction of travel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.parameters import checked, number, numbers
from mr360uw.base.sphere import gauss_legendre, unit
from mr360uw.errors import ParameterError
from mr360uw.types import Array


def refract_to_air(direction_in_water: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> Array:
    """Return the directions in air, towards the sun, of light seen from below a flat surface.

    Outside Snell's window (more than asin(1/n) from the zenith, 48.3 degrees at n = 1.34) no light comes from the air:
    the result is then the horizon below that azimuth, y = 0, which a caller can test for.

    Parameters
    ----------
    direction_in_water : array_like
        Directions (..., 3) towards the light, not below the horizon.
    refractive_index : float
        Index of the water relative to air, above 1 and up to 4.

    Returns
    -------
    ndarray
        Unit directions (..., 3).

    Raises
    ------
    ParameterError
        If a direction is below the horizon or the index out of range.

    See Also
    --------
    uw.caustics.refract_to_water : The way back.
    uw.caustics.fresnel_transmittance : How much light passes.

    Examples
    --------
    >>> uw.caustics.refract_to_air([0.6, 0.8, 0.0]).round(3)
    array([0.804, 0.595, 0.   ])
    """
    return into_air(_towards_light(direction_in_water, refractive_index), refractive_index)


def into_air(towards: NDArray[np.floating[Any]], refractive_index: float) -> Array:
    """Return `refract_to_air` of unit directions (..., 3) above the horizon, unchecked."""
    horizontal = refractive_index * towards[..., [0, 2]]
    sine = np.linalg.norm(horizontal, axis=-1, keepdims=True)
    horizontal = horizontal / np.maximum(sine, 1.0)
    up = np.sqrt(np.maximum(1.0 - np.sum(horizontal**2, axis=-1), 0.0)) * (sine[..., 0] < 1.0)
    return np.stack([horizontal[..., 0], up, horizontal[..., 1]], axis=-1)


def refract_to_water(direction_in_air: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> Array:
    """Return the directions in water, towards the sun, of light from above a flat surface.

    The whole sky is seen within Snell's window, 48.3 degrees about the zenith at n = 1.34, with the horizon at its
    edge.

    Parameters
    ----------
    direction_in_air : array_like
        Directions (..., 3) towards the light, not below the horizon.
    refractive_index : float
        Index of the water relative to air, above 1 and up to 4.

    Returns
    -------
    ndarray
        Unit directions (..., 3).

    Raises
    ------
    ParameterError
        If a direction is below the horizon or the index out of range.

    See Also
    --------
    uw.caustics.refract_to_air : The way back.
    uw.caustics.fresnel_transmittance : How much light passes.
    uw.caustics.sea_water_index : The index by wavelength.

    Examples
    --------
    >>> uw.caustics.refract_to_water([1.0, 0.0, 0.0]).round(3)
    array([0.746, 0.666, 0.   ])
    """
    return into_water(_towards_light(direction_in_air, refractive_index), refractive_index)


def into_water(towards: NDArray[np.floating[Any]], refractive_index: float) -> Array:
    """Return `refract_to_water` of unit directions (..., 3) above the horizon, unchecked."""
    horizontal = towards[..., [0, 2]] / refractive_index
    up = np.sqrt(1.0 - np.sum(horizontal**2, axis=-1))
    return np.stack([horizontal[..., 0], up, horizontal[..., 1]], axis=-1)


def _towards_light(direction: ArrayLike, refractive_index: float) -> Array:
    check_refractive_index(refractive_index)
    d = unit(direction)
    if np.any(d[..., 1] < 0.0):
        raise ParameterError(
            f"direction - must point up, towards the light (got y = {d[..., 1].min():.4g}) - reverse it"
        )
    return d


def check_refractive_index(refractive_index: float) -> None:
    """Raise `ParameterError` unless the index lies in (1, 4]."""
    if not 1.0 < number("refractive_index", refractive_index) <= 4.0:
        raise ParameterError(
            f"refractive_index - must lie above 1 and up to 4 (got {refractive_index}) - sea water has 1.34"
        )


def refract_clamped(travel: ArrayLike, normal: ArrayLike, eta: float) -> NDArray[np.floating[Any]]:
    """Return the unit directions of travel (..., 3) behind a surface.

    travel, normal: (..., 3) with travel.normal < 0. eta: index before the surface over index behind it. Under total
    internal reflection the result grazes the surface. Single precision stays single.
    """
    i, n = np.asarray(travel), np.asarray(normal)
    cosine = np.einsum("...i,...i->...", i, n)[..., None]
    k = np.maximum(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0)
    return eta * i - (eta * cosine + np.sqrt(k)) * n


def reflect(travel: ArrayLike, normal: ArrayLike) -> Array:
    """Return the unit directions of travel (..., 3) behind a mirror; the normal (..., 3) may have either sign."""
    i, n = np.asarray(travel, np.float64), np.asarray(normal, np.float64)
    return np.asarray(i - 2.0 * np.einsum("...i,...i->...", i, n)[..., None] * n)


def critical_cosine(refractive_index: float) -> float:
    """Return the cosine in the water at the edge of Snell's window: directions above it see the sky; 0 for n <= 1."""
    return float(np.sqrt(1.0 - 1.0 / refractive_index**2)) if refractive_index > 1.0 else 0.0


def snell_elevation(refractive_index: float = REFRACTIVE_INDEX_SEA) -> float:
    """Return the elevation [rad] of the edge of Snell's window, 41.7 degrees in sea water: the sky lies above it."""
    return math.asin(critical_cosine(refractive_index))


def fresnel_transmittance(cos_air: ArrayLike, refractive_index: float) -> Array:
    """Return the fraction (...,) of unpolarised irradiance that passes from air into water; no cancellation.

    cos_air: cosine of incidence; nothing passes at 0 and below, where a facet is turned away from the light.
    """
    c_i = np.maximum(numbers("cos_air", cos_air).astype(np.float64, copy=False), 0.0)
    n = number("refractive_index", refractive_index)
    c_t = np.sqrt(1.0 - (1.0 - c_i * c_i) / (n * n))
    return 2.0 * n * c_i * c_t * (1.0 / (c_i + n * c_t) ** 2 + 1.0 / (n * c_i + c_t) ** 2)


def fresnel_reflectance(cos_air: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> Array:
    """Return the fraction (...,) of unpolarised irradiance from air that water reflects, 1 - transmittance."""
    return 1.0 - fresnel_transmittance(cos_air, refractive_index)


def fresnel_from_below(cos_water: ArrayLike, refractive_index: float) -> Array:
    """Return the fraction (...,) of unpolarised light in the water that the surface reflects back down, 0 to 1.

    cos_water: cosine of incidence, below 0 taken as 0. It is 1 outside Snell's window, and 0 everywhere for n = 1.
    """
    if refractive_index == 1.0:
        return np.zeros(np.shape(cos_water))
    return fresnel(cos_water, 1.0 / refractive_index)


def fresnel_polarized(cosine: ArrayLike, relative_index: float) -> tuple[Array, Array]:
    """Return the reflectances (...,) of irradiance polarised across and along the plane of incidence, R_s and R_p.

    cosine: of incidence, from either side, below 0 taken as 0. Both are 1 under total internal reflection.
    """
    m = _checked_relative(relative_index)
    before = np.maximum(numbers("cosine", cosine).astype(np.float64, copy=False), 1e-300)
    behind = cosine_behind(before, m)
    across, along = (before - m * behind) / (before + m * behind), (m * before - behind) / (m * before + behind)
    return np.asarray(across * across), np.asarray(along * along)


def _checked_relative(relative_index: float) -> float:
    m = number("relative_index", relative_index)
    if not m > 0.0:
        raise ParameterError(f"relative_index - must be positive (got {m}) - from air into sea water it is 1.34")
    return m


def fresnel(cosine: ArrayLike, relative_index: float) -> Array:
    """Return the fraction (...,) of unpolarised irradiance that a surface reflects, from either side."""
    across, along = fresnel_polarized(cosine, relative_index)
    return 0.5 * (across + along)


def cosine_behind(cosine: ArrayLike, relative_index: float) -> Array:
    """Return the cosine (...,) of refraction for that of incidence; 0 under total internal reflection."""
    c = np.asarray(cosine, np.float64)
    return np.sqrt(np.maximum(1.0 - (1.0 - c * c) / (relative_index * relative_index), 0.0))


def radiance_factor(cosine: ArrayLike, relative_index: float) -> Array:
    """Return radiance behind a surface over that before it (...,), (1 - R) m^2, 0 under total internal reflection.

    By reciprocity the factor of the way back, at the refracted cosine and 1/m, is this one over m^4.
    """
    return (1.0 - fresnel(cosine, relative_index)) * _checked_relative(relative_index) ** 2


def diffuse_reflectance_from_below(refractive_index: float, optical_depth: ArrayLike = 0.0) -> Array:
    """Return the fraction (...,) of uniform light from below that a flat surface sends back down, 0.48 for sea water.

    optical_depth: (...,) of the water that the light crosses to the surface and again from it, at normal incidence.
    """
    edge = critical_cosine(refractive_index)
    x, w = gauss_legendre(_COSINES)
    total = np.zeros(np.shape(optical_depth))
    for low, high in ((0.0, edge), (edge, 1.0)):  # smooth on either side of the edge of Snell's window
        c, share = 0.5 * (low + high) + 0.5 * (high - low) * x, (high - low) * w
        lost = np.exp(-np.asarray(optical_depth, np.float64)[..., None] / c)
        total = total + np.sum(share * c * fresnel_from_below(c, refractive_index) * lost, axis=-1)
    return np.asarray(total)


_COSINES = 64
"""Directions over each part of a hemisphere: means are right to 1e-5 at the root-like edge of Snell's window."""


@checked
def sea_water_index(wavelength_nm: ArrayLike, temperature_c: float = 20.0, salinity: float = 35.0) -> Array:
    """Return the refractive index of sea water relative to air.

    From 450 to 650 nm it falls by 0.008, which gives caustics their faint fringes of colour. Calls that take one index
    for all light have 1.34 by default.

    Parameters
    ----------
    wavelength_nm : array_like
        Wavelengths (...,) [nm], 400 to 700.
    temperature_c : float
        Temperature [degC], 0 to 30.
    salinity : float
        Salinity on the practical scale, 0 to 35.

    Returns
    -------
    ndarray
        Index (...,).

    Raises
    ------
    ParameterError
        If an argument is out of range.

    See Also
    --------
    uw.caustics.refract_to_water : Takes an index.
    uw.caustics.fresnel_reflectance : What the surface mirrors for an index.

    Notes
    -----
    Quan & Fry 1995, equation 3.

    Examples
    --------
    >>> uw.caustics.sea_water_index([450.0, 550.0, 650.0]).round(4).tolist()
    [1.3459, 1.3408, 1.3377]
    """
    w = numbers("wavelength_nm", wavelength_nm).astype(np.float64, copy=False)
    t, s = temperature_c, salinity
    return (
        1.31405
        + (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t * t) * s
        - 2.02e-6 * t * t
        + (15.868 + 0.01155 * s - 0.00423 * t) / w
        - 4382.0 / w**2
        + 1.1455e6 / w**3
    )
