# SPDX-License-Identifier: Apache-2.0
"""Refraction and reflection at the water surface: Snell's law, Fresnel's equations, the index of sea water.

    symbol    here               meaning
    n         refractive_index   of water relative to air, > 1
    c_i       cos_air            cosine between a direction in air and the surface normal
    c_t       cos_water          the same in the water

Equations: Born & Wolf 1999 section 1.5 (Snell, Fresnel); Quan & Fry 1995 eq. 3 (index of sea water). Directions are
unit vectors that point towards the light; only `refract_clamped` takes the direction of travel. Twin: optics.glsl.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.shapes import number, numbers
from mr360uw.sphere import unit

Array = NDArray[np.float64]


def refract_to_air(direction_in_water: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> Array:
    """Return the directions (..., 3) in air, towards the sun, of light seen from below a flat surface.

    Outside Snell's window (more than asin(1/n) from the zenith, 48.3 degrees at n = 1.34) no light comes from the air:
    the result is then the horizon below that azimuth, y = 0, which a caller can test for. Raises `ParameterError` for
    directions below the horizon and indices outside (1, 4].
    """
    d = _towards_light(direction_in_water, refractive_index)
    horizontal = refractive_index * d[..., [0, 2]]
    sine = np.linalg.norm(horizontal, axis=-1, keepdims=True)
    horizontal = horizontal / np.maximum(sine, 1.0)
    up = np.sqrt(np.maximum(1.0 - np.sum(horizontal**2, axis=-1), 0.0)) * (sine[..., 0] < 1.0)
    return np.stack([horizontal[..., 0], up, horizontal[..., 1]], axis=-1)


def refract_to_water(direction_in_air: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> Array:
    """Return the directions (..., 3) in water, towards the sun, of light from above a flat surface.

    Raises `ParameterError` for directions below the horizon and indices outside (1, 4].
    """
    d = _towards_light(direction_in_air, refractive_index)
    horizontal = d[..., [0, 2]] / refractive_index
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


def critical_cosine(refractive_index: float) -> float:
    """Return the cosine in the water at the edge of Snell's window: directions above it see the sky; 0 for n <= 1."""
    return float(np.sqrt(1.0 - 1.0 / refractive_index**2)) if refractive_index > 1.0 else 0.0


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
    c_t = np.maximum(np.asarray(cos_water, np.float64), 1e-300)
    n = refractive_index
    if n == 1.0:
        return np.zeros(c_t.shape)
    c_i = np.sqrt(np.maximum(1.0 - n * n * (1.0 - c_t * c_t), 0.0))
    s, p = (n * c_t - c_i) / (n * c_t + c_i), (c_t - n * c_i) / (c_t + n * c_i)
    return 0.5 * (s * s + p * p)


def sea_water_index(wavelength_nm: ArrayLike, temperature_c: float = 20.0, salinity: float = 35.0) -> Array:
    """Return the refractive index (...,) of sea water relative to air (Quan & Fry 1995 eq. 3).

    wavelength_nm: 400 to 700. temperature_c: 0 to 30. salinity: 0 to 35 (practical scale).
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
