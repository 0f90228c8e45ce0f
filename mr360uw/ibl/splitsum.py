# SPDX-License-Identifier: Apache-2.0
"""Reflectance of a GGX surface under a uniform sky, F0 A + B: the second half of the split sum.

    A = int f/F cos (1 - (1 - v.h)^5),   B = int f/F cos (1 - v.h)^5   over the hemisphere of l

f = GGX with the height-correlated Smith masking (Heitz 2014 eq. 99) and the Fresnel factor of Schlick 1994.
`split_sum` is a quotient of polynomials fitted to the integral (Karis 2013): rms error .014 of
A + B and .003 of B, within .04 and .015 where n.v > .1; B vanishes at n.v = 1 as it must, or every dark dielectric
would look hazy. (The widely used fit of Karis 2014 is off by up to .47 for rough metals.)
Twin: splitsum.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.shapes import common_shape

Array = NDArray[np.float64]


def split_sum(roughness: ArrayLike, n_dot_v: ArrayLike) -> tuple[Array, Array]:
    """Return (A, B) for perceptual roughness (alpha = roughness^2) and n.v, each (...,) in [0, 1]."""
    common_shape(roughness=roughness, n_dot_v=n_dot_v)
    r = np.asarray(roughness, np.float64)
    v = np.asarray(n_dot_v, np.float64)
    white = (1.004 + v * (0.1061 - v * (0.1398 + 0.1248 * v))
             + r * (-2.549 + v * (0.1271 + 0.4051 * v) + r * (2.37 - 0.5209 * v - 0.5446 * r)))  # fmt: skip
    white = white / (1.0 + v * (0.05538 - 0.209 * v) + r * (-2.2 + 0.2572 * v + 1.505 * r))
    b = 0.9969 + v * (-1.096 + 1.0529 * v) + r * (-1.0901 + 0.0253 * v + 0.484 * r)
    b = b / (1.0 + v * (0.0215 + 7.8124 * v) + r * (-0.292 - 13.4496 * v + 8.9049 * r))
    x = 1.0 - v
    b = np.maximum(x * x * x * b, 0.0)
    return np.minimum(white, 1.0) - b, b
