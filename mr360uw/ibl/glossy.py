# SPDX-License-Identifier: Apache-2.0
"""Radiance maps filtered by GGX lobes, the first half of the split sum.

With view, normal and reflection taken as one (n = v = r: Karis 2013, section "Image-Based Lighting"), the pre-filtered
radiance is the mean of L(l) weighted by

    k(n.l) = D(n.h) max(0, n.l),   n.h = sqrt((1 + n.l)/2),   D = GGX of alpha = roughness^2 (Walter 2007 eq. 33)

normalised to 1. The kernel is zonal, so a level is one constant `ZonalFilter`, integrated over source pixels.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError
from mr360uw.ibl.cosine import ZonalFilter, filter_scale
from mr360uw.ibl.settings import MINIMUM_ROUGHNESS
from mr360uw.shapes import exactly, number
from mr360uw.sphere import directions
from mr360uw.types import Floats


def ggx_distribution(cos_half: ArrayLike, roughness: float) -> NDArray[np.float64]:
    """Return the GGX normal distribution D [1/sr] at the cosine between normal and half vector."""
    alpha_squared = roughness**4
    c2 = np.square(np.asarray(cos_half, np.float64))
    return alpha_squared / (np.pi * np.square(c2 * (alpha_squared - 1.0) + 1.0))


def ggx_kernel(cosine: ArrayLike, roughness: float) -> NDArray[np.float64]:
    """Return the prefilter's weight, not normalised, of light at `cosine` = n.l."""
    cosine = np.asarray(cosine, np.float64)
    lit = np.maximum(cosine, 0.0)
    return ggx_distribution(np.sqrt(0.5 + 0.5 * np.maximum(cosine, -1.0)), roughness) * lit


@functools.lru_cache(maxsize=16)
def glossy_filter(roughness: float, scale: int = 1) -> ZonalFilter:
    """Return the constant prefilter of one roughness for maps of (32 scale, 64 scale, 3)."""
    return ZonalFilter(lambda cosine: ggx_kernel(cosine, roughness), scale, normalised=True)


def _check_roughness(roughness: float) -> None:
    if not MINIMUM_ROUGHNESS <= number("roughness", roughness) <= 1.0:
        raise ParameterError(
            f"roughness - outside [{MINIMUM_ROUGHNESS}, 1] (got {roughness!r}) - use the radiance itself for mirrors"
        )


def prefilter(radiance: ArrayLike, roughness: float) -> Floats:
    """Return a radiance map (32 k, 64 k, 3) filtered by the GGX lobe of `roughness` in [0.05, 1], (32, 64, 3)."""
    _check_roughness(roughness)
    return glossy_filter(float(roughness), filter_scale(radiance))(radiance)


def glossy_beam(direction: ArrayLike, irradiance: ArrayLike, roughness: float) -> Floats:
    """Return the prefiltered radiance (32, 64, 3) of a beam: irradiance (3,) on a plane facing `direction` (3,)."""
    _check_roughness(roughness)
    cosine = np.linspace(0.0, 1.0, 1 << 16)  # the kernel's integral, with 1 - cosine spaced as a square
    tail = np.square(1.0 - cosine)
    total = 2.0 * np.pi * np.trapezoid(ggx_kernel(1.0 - tail, roughness), tail)
    towards = exactly("direction", direction, (3,)).astype(np.float64)
    lobe = ggx_kernel(directions(64, 32) @ towards, roughness) / abs(float(total))
    return (lobe[..., None] * exactly("irradiance", irradiance, (3,)).astype(np.float64)).astype(np.float32)


def glossy_levels(radiance: ArrayLike, roughness: ArrayLike) -> Floats:
    """Return the levels (L, 32, 64, 3) of a radiance map at ascending roughnesses (L,)."""
    levels = np.asarray(roughness, np.float64)
    if levels.ndim != 1 or np.any(np.diff(levels) <= 0.0):
        raise ParameterError(f"glossy_roughness - must ascend (got {levels.tolist()}) - sort it, without repeats")
    if not len(levels):
        return np.zeros((0, 32, 64, 3), np.float32)
    return np.stack([prefilter(radiance, float(level)) for level in levels])
