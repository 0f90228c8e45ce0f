# SPDX-License-Identifier: Apache-2.0
"""Water as shafts see it: coefficients by wavelength, and their sums in RGB along rays.

Geometry is marched once. Wavelengths enter through sums that depend on the height v_y of the view direction and on the
distance alone, so that a point in the water costs the same for 3 wavelengths or 61. With the conventions of
`deviation`, for a segment of a ray, channel k, and the two kinds j of scattering (molecules, particles):

    whole_jk = sum_i w_ki b_ij int exp(-c'_i s) exp(c'_i s v_y/l_y) ds
    sharp_jk = sum_i w_ki b_ij exp(-(c_i - c'_i) p) int exp(-c'_i s) exp(c_i s v_y/l_y) ds

p is the beam's path to the camera, and w_ki = weight_ki exp(-c'_i p)/sum_i(...) the spectrum of the beam at the camera,
whose sum is 1: the sun's irradiance is known there in RGB, not by wavelength. The weights are `Bands.lobes`.

`beam_share` is the fraction of the veil that shafts can change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Parts
from mr360uw.color import luminance
from mr360uw.constants import MINIMUM_SUN_UP
from mr360uw.medium.closed_form import exponential_integral, ray_in_water
from mr360uw.medium.lookup import beam_fraction
from mr360uw.medium.medium import Medium
from mr360uw.medium.models import CLOSED_FORMS
from mr360uw.medium.phase import Phase, phase_function, wide_angle_function
from mr360uw.types import Floats

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ShaftWater(Parts):
    """Coefficients of n wavelengths.

    extinction: c' (n,), attenuation: c (n,) [1/m], see `deviation`. molecules, particles: (n,) scattering [1/m] of
    each. phase: of the particles. wide: whether small angles are cut off it. weight: (n, 3), columns of sum 1.
    """

    extinction: Array
    attenuation: Array
    molecules: Array
    particles: Array
    phase: Phase
    wide: bool
    weight: Array

    @classmethod
    def of(cls, medium: Medium) -> ShaftWater:
        """Return the water of a medium, as its veil scatters."""
        nm, water = medium.bands.wavelength_nm, medium.water
        b = np.asarray(water.scattering(nm), np.float64)
        molecules = np.zeros(len(nm)) if water.molecular is None else np.asarray(water.molecular(nm), np.float64)
        model, weight = medium.model, medium.bands.lobes
        if medium.mode in CLOSED_FORMS:
            return cls(model.extinction, model.attenuation, np.zeros(len(nm)), b, "isotropic", False, weight)
        return cls(model.extinction, model.attenuation, molecules, b - molecules, water.phase, True, weight)

    @property
    def scatters(self) -> bool:
        """Whether it scatters at all."""
        return bool(np.any(self.molecules > 0.0) or np.any(self.particles > 0.0))

    def turned(self, cosine: Array) -> Array:
        """Return the phase functions (..., 2) [1/sr] of molecules and particles; the second has its peak cut off."""
        theta = np.arccos(np.clip(cosine, -1.0, 1.0))
        particles = wide_angle_function(self.phase, theta) if self.wide else phase_function(self.phase, theta)
        return np.stack([phase_function("water", theta), particles], axis=-1)

    def beam_segments(self, up: Array, edge_m: Array, camera_depth_m: float, sun_up: float) -> tuple[Array, Array]:
        """Return (`whole`, `sharp`), (m, k, 2, 3), of the segments between edges (m, k + 1) of rays.

        up: (m,) height of their directions. Per unit irradiance (3,) at the camera.
        """
        sun_up = max(sun_up, MINIMUM_SUN_UP)
        path = camera_depth_m / sun_up
        mixed = self._mixed(self._spectrum(path))
        start, end, steeper = edge_m[:, :-1, None], edge_m[:, 1:, None], (up / sun_up)[:, None, None]
        whole = exponential_integral(self.extinction * (1.0 - steeper), start, end) @ mixed
        unturned = np.exp(-(self.attenuation - self.extinction) * path)
        sharp = exponential_integral(self.extinction - self.attenuation * steeper, start, end) * unturned @ mixed
        shape = (*edge_m[:, 1:].shape, 2, 3)
        return whole.reshape(shape), np.minimum(sharp.reshape(shape), whole.reshape(shape))

    def over_path(self, path_m: Array) -> Array:
        """Return sums (..., 2, 3) of w b exp(-c' path) for white light over paths (...,) [m]."""
        return (np.exp(-self.extinction * path_m[..., None]) @ self._mixed(self.weight)).reshape(*path_m.shape, 2, 3)

    def _spectrum(self, path_m: float) -> Array:
        """Return the weights (n, 3) of the beam after a path, columns of sum 1."""
        log = np.log(np.maximum(self.weight, 1e-300)) - self.extinction[:, None] * path_m
        light = np.exp(log - log.max(axis=0))
        return np.asarray(light / light.sum(axis=0))

    def _mixed(self, weight: Array) -> Array:
        return np.concatenate([self.molecules[:, None] * weight, self.particles[:, None] * weight], axis=1)


_DIRECT = 0.75
"""Fraction of the irradiance below the surface that is the beam, for a high sun in a clear sky. Under other skies the
beam's share of the veil is less."""
_DARKEST = 1e-30
"""Least veil that is divided by."""
_SUN_UP = 0.85
"""Sine of that sun's elevation in the water."""


def beam_share(medium: Medium, depth_m: float) -> float:
    """Return the fraction of a level veil's luminance that the beam's first scattering adds, under a high sun.

    It is the contrast of a shaft in full shadow that fills the view of a camera at depth_m [m], and falls with depth.
    Zero in water that does not scatter.
    """
    water = ShaftWater.of(medium)
    if not water.scatters:
        return 0.0
    level = np.zeros(1)
    beam = _DIRECT / _SUN_UP * beam_fraction(medium.unit_table, depth_m, _SUN_UP)
    lit = float(luminance(beam * unoccluded(water, level, level, np.array([np.inf]), depth_m, _SUN_UP)[0]))
    veil = float(luminance(medium.light.display(medium.model.radiance(depth_m, level))[0]))
    return lit / max(veil, lit, _DARKEST)


def unoccluded(
    water: ShaftWater, cosine: Array, up: Array, end_m: Array, camera_depth_m: float, sun_up: float
) -> Floats:
    """Return the beam's light scattered once (n, 3) over rays up to end_m (n,), per unit irradiance at the camera.

    The smooth part of `single_scattering`, over an open, flat sea, with the water's wide angles. cosine: (n,) of the
    angle by which light turns. up: (n,) height of the rays' directions.
    """
    edge = np.stack([np.zeros(len(up)), ray_in_water(end_m, camera_depth_m, up)], axis=-1)
    whole, _ = water.beam_segments(up, edge, camera_depth_m, sun_up)
    return np.asarray(np.einsum("nj,njk->nk", water.turned(cosine), whole[:, 0]))
