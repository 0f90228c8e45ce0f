# SPDX-License-Identifier: Apache-2.0
"""Reflectance spectra from RGB albedos (Mallett & Yuksel 2019).

Three smooth basis spectra that sum to 1 are weighted by red, green and blue. The spectrum is then linear in the colour,
reproduces it exactly under D65 and stays in [0, 1]. The basis comes from colour-science.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.medium.tables import Spectrum
from mr360uw.shapes import numbers, vectors

Array = NDArray[np.float64]


def reflectance(albedo_rgb: ArrayLike, wavelength_nm: ArrayLike) -> Array:
    """Return reflectances (..., n) in [0, 1] of linear Rec.709 albedos (..., 3) in [0, 1] at wavelengths (n,) [nm]."""
    w = np.atleast_1d(numbers("wavelength_nm", wavelength_nm))
    return vectors("albedo_rgb", albedo_rgb).astype(np.float64, copy=False) @ _basis()(w).T


@functools.cache
def _basis() -> Spectrum:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns about optional packages
        from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019 as BASIS
    return Spectrum("reflectance basis", np.asarray(BASIS.wavelengths), np.asarray(BASIS.values))
