# SPDX-License-Identifier: Apache-2.0
"""A flat water surface seen from below: the edge of Snell's window and Fresnel's equations.

Equations: Born & Wolf 1999 section 1.5. Cosines are those between a direction and the surface's normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def critical_cosine(index: float) -> float:
    """Return the cosine of the critical angle in the water (0 without a change of index): above it shines the sky."""
    return float(np.sqrt(1.0 - 1.0 / index**2)) if index > 1.0 else 0.0


def fresnel_from_below(cos_water: ArrayLike, index: float) -> Array:
    """Return the reflectance (0 to 1) of the surface for unpolarised light in the water; cosines below 0 count as 0.

    index: of the water relative to air, >= 1; 1 reflects nothing.
    """
    c_t = np.maximum(np.asarray(cos_water, np.float64), 1e-300)
    if index == 1.0:
        return np.zeros(c_t.shape)
    c_i = np.sqrt(np.maximum(1.0 - index * index * (1.0 - c_t * c_t), 0.0))
    s, p = (index * c_t - c_i) / (index * c_t + c_i), (c_t - index * c_i) / (c_t + index * c_i)
    return 0.5 * (s * s + p * p)
