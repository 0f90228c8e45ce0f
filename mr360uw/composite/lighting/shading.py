# SPDX-License-Identifier: Apache-2.0
"""Light on a surface: metallic-roughness with a split-sum environment and directed lights.

    symbol          here            unit     meaning
    alpha           alpha           1        width of the GGX lobe, roughness^2
    F0              f0              1        reflectance at normal incidence, (..., 3)
    A, B            split           1        integrals of the split sum: reflectance = F0 A + B

GGX distribution (Walter et al. 2007 eq. 33), Smith visibility with correlated heights (Heitz 2014), Schlick's Fresnel
term, split sum (Karis 2013), its energy for several bounces (Fdez-Aguera 2019). What the coat reflects is not left for
the diffuse part, so a white body in white light is white. Below water the Fresnel term is that of the surface against
water, an eighth of that in air. Twin: shading.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import INV_PI
from mr360uw.types import Floats

MINIMUM_ALPHA = 0.002
"""Narrower lobes are not told apart from a mirror in single precision."""


def dielectric_f0(refractive_index: ArrayLike, medium_index: float) -> Floats:
    """Return the reflectance (...,) at normal incidence of dielectrics of index (...,) in a medium (Fresnel)."""
    index = np.asarray(refractive_index, np.float64)
    return np.square((index - medium_index) / (index + medium_index))


def ggx_distribution(n_dot_h: Floats, alpha: Floats) -> Floats:
    """Return the density of facets D [1/sr]."""
    squared = alpha * alpha
    d = n_dot_h * n_dot_h * (squared - 1.0) + 1.0
    return squared * INV_PI / (d * d)


def smith_visibility(n_dot_v: Floats, n_dot_l: Floats, alpha: Floats) -> Floats:
    """Return G/(4 n.v n.l) of facets whose heights are correlated."""
    squared = alpha * alpha
    v = n_dot_l * np.sqrt(n_dot_v * n_dot_v * (1.0 - squared) + squared)
    s = n_dot_v * np.sqrt(n_dot_l * n_dot_l * (1.0 - squared) + squared)
    return 0.5 / np.maximum(v + s, 1e-6)


def grazing_reflectance(f0: Floats) -> Floats:
    """Return Schlick's reflectance F90 (..., 3) towards grazing: 1, less for surfaces that barely differ from water.

    (F0/.04)^(1/5), capped: least squares to Fresnel's equations, weighted by the cosine, give .35, .60, .76 for index
    ratios of 1.05, 1.12 and 1.2; this gives .43, .60, .73. Without it, a body of the water's index would shine at
    its rim.
    """
    return np.minimum(np.power(np.maximum(f0, 0.0) / 0.04, 0.2), 1.0)


def lobe_axis(normal: Floats, view: Floats, n_dot_v: Floats, roughness: Floats) -> Floats:
    """Return the unit direction (..., 3) that the light which a coat reflects to the viewer comes from, on average.

    normal, view: (..., 3); n_dot_v: their cosine, positive. A smooth surface reflects the mirrored direction; the
    rougher it is, the more its masking turns the lobe to the normal, and at roughness 1 wholly. The turn is fitted to
    the mean direction of the lobe relative to its width: off by 2.2 degrees rms over roughness and n.v, where the
    mirrored direction is off by 33 (same purpose: Lagarde & de Rousiers 2014, "dominant direction", off by 5).
    """
    mirror = 2.0 * np.sum(normal * view, axis=-1, keepdims=True) * normal - view
    lean = (1.0 - roughness) * (1.0 + roughness * (1.01 - 1.86 * roughness + n_dot_v * (1.15 + 1.27 * roughness)))
    axis = normal + (mirror - normal) * np.minimum(lean, 1.0)[..., None]
    return axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)


def reflectance(f0: Floats, split: Floats) -> Floats:
    """Return the part (..., 3) of uniform light that the coat reflects; split: (..., 2) of the split sum.

    One bounce reflects F0 A + F90 B; what the facets pass on to each other comes back with the mean colour.
    """
    single = f0 * split[..., :1] + grazing_reflectance(f0) * split[..., 1:]
    return single * (1.0 + f0 * (1.0 / np.maximum(split[..., :1] + split[..., 1:], 1e-3) - 1.0))


def highlight(
    f0: Floats, alpha: Floats, n_dot_v: Floats, n_dot_l: Floats, n_dot_h: Floats, v_dot_h: Floats, half_angle: ArrayLike
) -> Floats:
    """Return the radiance (..., 3) of a light's reflection for an irradiance of 1 across its beam.

    The disc of the light widens the lobe by half its angular radius (Karis 2013, sphere lights).
    """
    wide = np.minimum(np.maximum(alpha, MINIMUM_ALPHA) + 0.5 * np.asarray(half_angle), 1.0)
    lobe = ggx_distribution(n_dot_h, wide) * smith_visibility(n_dot_v, n_dot_l, wide) * n_dot_l
    grazing = np.power(np.clip(1.0 - v_dot_h, 0.0, 1.0), 5.0)[..., None]
    return lobe[..., None] * (f0 + (grazing_reflectance(f0) - f0) * grazing)
