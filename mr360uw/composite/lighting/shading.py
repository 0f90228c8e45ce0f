# SPDX-License-Identifier: Apache-2.0
"""Reflection of a surface: metallic-roughness with a split-sum environment and directed lights.

    symbol          here            unit     meaning
    alpha           alpha           1        width of the GGX lobe, roughness^2
    F0              f0              1        reflectance at normal incidence, (..., 3)
    A, B            split           1        integrals of the split sum: reflectance = F0 A + B

GGX distribution (Walter et al. 2007 eq. 33), Smith visibility with correlated heights (Heitz 2014), Schlick's Fresnel
term, split sum (Karis 2013), its energy for several bounces (Fdez-Aguera 2019). The diffuse part gets the light that
the coat does not reflect, so a white body in white light is white. Below water the Fresnel term is that of the surface
against water, an eighth of that in air. Twin: shading.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import INV_PI
from mr360uw.types import Floats

MINIMUM_ALPHA = 0.002
"""Least width of a lobe: narrower ones are not resolved in single precision."""
LEAST_COSINE = 0.001
"""Least cosine between view and half vector that a light's disc is spread by, where it grazes."""
PIXEL_POINT = 0.28867513
"""1/sqrt(12)."""
PIXEL_POINTS = PIXEL_POINT * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
"""Places (4, 2) in a pixel, from its middle, of the Gauss-Legendre quadrature that is exact for cubic functions."""


def dielectric_f0(refractive_index: ArrayLike, medium_index: float) -> Floats:
    """Return the reflectance (...,) at normal incidence of dielectrics of index (...,) in a medium (Fresnel)."""
    index = np.asarray(refractive_index, np.float64)
    return np.square((index - medium_index) / (index + medium_index))


def ggx_distribution(n_dot_h: Floats, alpha: Floats) -> Floats:
    """Return the GGX density of microfacets D [1/sr]."""
    squared = alpha * alpha
    d = n_dot_h * n_dot_h * (squared - 1.0) + 1.0
    return squared * INV_PI / (d * d)


def smith_visibility(n_dot_v: Floats, n_dot_l: Floats, alpha: Floats) -> Floats:
    """Return G/(4 n.v n.l), Smith masking and shadowing with correlated heights."""
    squared = alpha * alpha
    v = n_dot_l * np.sqrt(n_dot_v * n_dot_v * (1.0 - squared) + squared)
    s = n_dot_v * np.sqrt(n_dot_l * n_dot_l * (1.0 - squared) + squared)
    return 0.5 / np.maximum(v + s, 1e-6)


def grazing_reflectance(f0: Floats) -> Floats:
    """Return Schlick's grazing reflectance F90 (..., 3): 1, less for surfaces whose index is close to the medium's.

    (F0/.04)^(1/5), capped: least squares to Fresnel's equations, weighted by the cosine, give .35, .60, .76 for index
    ratios of 1.05, 1.12 and 1.2; this gives .43, .60, .73. With F90 = 1 a body of the water's index would have a
    bright rim.
    """
    return np.minimum(np.power(np.maximum(f0, 0.0) / 0.04, 0.2), 1.0)


def lobe_axis(normal: Floats, view: Floats, n_dot_v: Floats, roughness: Floats) -> Floats:
    """Return the mean unit direction (..., 3) of the light that a coat reflects to the viewer (dominant direction).

    normal, view: (..., 3); n_dot_v: their cosine, positive. A smooth surface reflects the mirrored direction; with
    roughness, masking tilts the lobe to the normal, completely at roughness 1. The tilt is fitted to the lobe's mean
    direction: the error is 2.2 degrees rms over roughness and n.v, against 33 for the mirrored direction and 5 for
    the fit of Lagarde & de Rousiers 2014.
    """
    mirror = 2.0 * np.sum(normal * view, axis=-1, keepdims=True) * normal - view
    lean = (1.0 - roughness) * (1.0 + roughness * (1.01 - 1.86 * roughness + n_dot_v * (1.15 + 1.27 * roughness)))
    axis = normal + (mirror - normal) * np.minimum(lean, 1.0)[..., None]
    return axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)


def reflectance(f0: Floats, split: Floats) -> Floats:
    """Return the fraction (..., 3) of uniform light that the coat reflects; split: (..., 2) of the split sum.

    One bounce reflects F0 A + F90 B; light of further bounces between facets is added with the mean colour.
    """
    single = f0 * split[..., :1] + grazing_reflectance(f0) * split[..., 1:]
    return single * (1.0 + f0 * (1.0 / np.maximum(split[..., :1] + split[..., 1:], 1e-3) - 1.0))


def resolved_alpha(roughness: Floats, change: Floats) -> Floats:
    """Return the width (n,) of a lobe whose normals change by `change` (n, 2, 3) over a pixel: at least half of what
    the normals at `PIXEL_POINTS` are apart, or a highlight could fall between them.
    """
    return np.sqrt(np.minimum(np.maximum(roughness**4, np.sum(change**2, axis=(-1, -2)) / 24.0), 1.0))


def highlight(
    f0: Floats, alpha: Floats, n_dot_v: Floats, n_dot_l: Floats, n_dot_h: Floats, v_dot_h: Floats, half_angle: ArrayLike
) -> Floats:
    """Return the radiance (..., 3) of a light's specular reflection for an irradiance of 1 perpendicular to its beam.

    half_angle: angular radius [rad] of the light. Over its disc, half vectors fill an ellipse of half axes
    r = half_angle/2 and r/c, c = v.h. Near its peak GGX is alpha^2/(pi (alpha^2 + t^2)^2) at an angle t of the half
    vector, and its mean over a disc of the ellipse's area, s^2 = r^2/c,

        1/(pi s^2) int_0^s alpha^2/(pi (alpha^2 + t^2)^2) 2 pi t dt = 1/(pi (alpha^2 + s^2)),

    is the peak of a lobe of width sqrt(alpha^2 + s^2), which stands for the mean at all angles.
    """
    spread = 0.5 * np.asarray(half_angle) / np.sqrt(np.maximum(v_dot_h, LEAST_COSINE))
    wide = np.minimum(np.hypot(np.maximum(alpha, MINIMUM_ALPHA), spread), 1.0)
    lobe = ggx_distribution(n_dot_h, wide) * smith_visibility(n_dot_v, n_dot_l, wide) * n_dot_l
    grazing = np.power(np.clip(1.0 - v_dot_h, 0.0, 1.0), 5.0)[..., None]
    return lobe[..., None] * (f0 + (grazing_reflectance(f0) - f0) * grazing)
