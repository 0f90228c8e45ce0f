# SPDX-License-Identifier: Apache-2.0
"""In-scattered radiance along a ray in water whose irradiance decays as one exponential: closed form, always stable.

    L = b E/(4 pi) exp(-K y) (1 - exp(-(c - K mu) S)) / (c - K mu)

b, c, K: scattering, beam and diffuse attenuation [1/m]; E: irradiance just below the surface; y: depth of the camera;
mu: y of the view direction, +1 straight up; S: length of the ray, cut where it leaves the water. Monzon et al. 2022
eq. 4, with the signs that make it hold (looking up is brighter); the same as Monzon et al. 2024 eq. 9. The quotient is
written so that nothing overflows, whatever the sign of c - K mu, and so that c = K mu is no special case.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import BRIGHTEST_LOG, INV_4PI, LONGEST_RAY_M
from mr360uw.errors import ParameterError
from mr360uw.medium.water import Water
from mr360uw.shapes import checked, common_shape, exactly, numbers
from mr360uw.types import Array


def ray_in_water(distance: ArrayLike, depth: ArrayLike, up: ArrayLike) -> Array:
    """Return the length (...,) [m] of a ray from `depth` that lies below the mean surface, at most `LONGEST_RAY_M`."""
    common_shape("distance_m", distance_m=distance, depth_m=depth, up=up)
    s, y, mu = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (distance, depth, up)))
    out = np.divide(np.maximum(y, 0.0), mu, out=np.full(s.shape, LONGEST_RAY_M), where=mu > 0.0)
    return np.minimum(np.maximum(s, 0.0), np.minimum(out, LONGEST_RAY_M))


def mean_transmittance(x: ArrayLike) -> Array:
    """Return (1 - exp(-x))/x, the mean of exp(-x t) over t in [0, 1], for x >= 0."""
    x = np.asarray(x, np.float64)
    return np.divide(-np.expm1(-x), x, out=np.ones(x.shape), where=x > 0.0)


def path_integral(c: ArrayLike, k: ArrayLike, s: ArrayLike, y: ArrayLike, mu: ArrayLike) -> Array:
    """Return the integral of exp(-c t - k (y - t mu)) over t in [0, s] [m]; s must end below the surface."""
    c, k, s, y, mu = (np.asarray(x, np.float64) for x in (c, k, s, y, mu))
    q = (c - k * mu) * s
    return s * np.exp(-k * y - np.minimum(q, 0.0)) * mean_transmittance(np.abs(q))


def exponential_integral(rate: ArrayLike, start: ArrayLike, end: ArrayLike) -> Array:
    """Return the integral of exp(-rate t) over t from start to end [m], for a rate [1/m] of either sign.

    The integrand is bounded by exp(`BRIGHTEST_LOG`).
    """
    length = np.subtract(end, start, dtype=np.float64)
    brightest = np.minimum(-np.minimum(np.multiply(rate, start), np.multiply(rate, end)), BRIGHTEST_LOG)
    return length * np.exp(brightest) * mean_transmittance(np.abs(rate * length))


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
