# SPDX-License-Identifier: Apache-2.0
"""Light of a spectral model in the linear RGB of a sensor: colours within the gamut, and logarithms of ratios.

Ratios of light (transmittance, daylight over depth, the sun's beam) are computed as logarithms of sums over wavelength
with the non-negative weights `Bands.lobes`, so that they stay finite and positive however dark the water is.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.models import SpectralModel
from mr360uw.medium.spectral.bands import Bands
from mr360uw.medium.spectral.gamut import compress_gamut

Array = NDArray[np.float64]

_LEAST = 1e-300
"""Least irradiance that a logarithm is taken of: the smallest normal double is 2e-308."""
_LEAST_LIGHT = 1e-250
"""Irradiance at `deepest_m`, far enough above `_LEAST` that products of it with a transmittance do not reach that."""


@dataclass(frozen=True, eq=False)
class BandLight:
    """A model at the wavelengths of a sensor's bands."""

    model: SpectralModel
    bands: Bands

    def display(self, spectrum: Array) -> Array:
        """Return RGB (..., 3) within the gamut of spectra (..., n) relative to the illuminant."""
        rgb = self.bands.rgb(spectrum)
        return compress_gamut(rgb) if self.bands.signed else rgb

    def fading_length_m(self, depth_m: float) -> float:
        """Return the distance [m] over which the downwelling light about a depth falls to 1/e."""
        step = 1e-3 * depth_m
        here, below = np.abs(self.bands.weight).sum(axis=1) @ self.model.irradiance(
            np.array([depth_m, depth_m + step]), 1.0
        ).T  # fmt: skip
        return float(step / np.log(here / below))

    def transmittance_log(self, distance_m: Array, depth_m: Array) -> Array:
        """Return the logarithm (..., 3) of the transmittance of a grey object at a depth over a distance."""
        light = self._log_irradiance(depth_m)
        s = np.asarray(distance_m, np.float64)[..., None]
        return self.bands.log_light(light - self.model.extinction * s) - self.bands.log_light(light)

    def ambient_log(self, depth_m: Array) -> Array:
        """Return the logarithm (..., 3) of the downwelling irradiance at depths."""
        return self.bands.log_light(self._log_irradiance(depth_m))

    def beam_log(self, path_m: Array, extinction: Array) -> Array:
        """Return the logarithm (..., 3) of the fraction of a beam that is left after a path from the surface.

        extinction: (n,) [1/m] of the beam: the model's `extinction`, or `attenuation` for its unscattered part.
        """
        return self.bands.log_light(-extinction * np.asarray(path_m, np.float64)[..., None])

    def _log_irradiance(self, depth_m: Array) -> Array:
        return np.log(np.maximum(self.model.irradiance(depth_m, 1.0), _LEAST))

    @functools.cached_property
    def deepest_m(self) -> float:
        """Depth [m] at which the light is too weak for double precision; used for all greater depths."""
        depth = np.geomspace(0.1, 1e6, 300)
        light = self.model.irradiance(depth, 1.0)[:, np.argmin(self.model.extinction)]
        return float(depth[light > _LEAST_LIGHT][-1])
