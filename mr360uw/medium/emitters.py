# SPDX-License-Identifier: Apache-2.0
"""Light of lamps in linear RGB: its colour, its flux, and how fast water takes it away.

    S(T)   spectrum of a black body of temperature T (Planck 1901)        K = 683 lm/W  V S/S over 400 to 700 nm

A lamp's own spectrum, not the daylight of its depth, decides what water leaves of it. V is the luminosity function of
the CIE 1931 observer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.medium.medium import DEFAULT_BANDS, Medium
from mr360uw.medium.spectral.bands import Bands, bands
from mr360uw.medium.spectral.sensor import DEFAULT_ILLUMINANT, illuminant
from mr360uw.medium.tabulate import DEPTH_SIZE, lengths

Array = NDArray[np.float64]

_SECOND_RADIATION_NM_K = 1.438776877e7
"""hc/k (SI 2019)."""


def black_body(wavelength_nm: Array, temperature_k: float) -> Array:
    """Return the spectral radiance (...,) of a black body relative to that at 560 nm."""
    w = np.asarray(wavelength_nm, np.float64)

    def radiance(nm: Array) -> Array:
        return nm**-5.0 / np.expm1(_SECOND_RADIATION_NM_K / (nm * temperature_k))

    return radiance(w) / radiance(np.array(560.0))


def lamp_color(medium: Medium | None, temperature_k: float) -> Array:
    """Return the linear RGB (3,) of a lamp's light before the water, of luminance 1, as the medium's sensor sees it."""
    used, relative = _relative(medium, temperature_k)
    rgb = np.maximum(used.rgb(relative), 0.0)
    return rgb / luminance(rgb)


def lamp_attenuation(medium: Medium, temperature_k: float) -> Array:
    """Return the effective attenuation (T, 3) [1/m] of a lamp's light over paths, as `types.Lamp` says."""
    _, relative = _relative(medium, temperature_k)
    path = np.maximum(lengths(DEPTH_SIZE, medium.length_m), 1e-4 * medium.length_m)[:, None]
    log = np.log(relative)
    start = medium.bands.log_light(log)
    return np.asarray((start - medium.bands.log_light(log - medium.model.extinction * path)) / path)


def _relative(medium: Medium | None, temperature_k: float) -> tuple[Bands, Array]:
    """Return bands, and a lamp's spectrum at them relative to what their white is balanced for."""
    used = bands(DEFAULT_BANDS) if medium is None else medium.bands
    name = DEFAULT_ILLUMINANT if medium is None else medium.illuminant
    return used, black_body(used.wavelength_nm, temperature_k) / illuminant(name)(used.wavelength_nm)
