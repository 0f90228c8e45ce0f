# SPDX-License-Identifier: Apache-2.0
"""Standard skies of the CIE (CIE S 011/E:2003, ISO 15469:2004; Darula & Kittler 2002).

    L(v) = (1 + a exp(b/v_y)) (1 + c (exp(d x) - exp(d pi/2)) + e cos^2 x)

x: angle to the sun. v_y: sine of elevation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import PI
from mr360uw.sphere import directions
from mr360uw.types import Floats

Shape = tuple[float, float, float, float, float]
"""The numbers a to e of a sky."""
CLEAR: Shape = (-1.0, -0.32, 10.0, -3.0, 0.45)
"""Type 12: clear, low turbidity."""
OVERCAST: Shape = (4.0, -0.7, 0.0, -1.0, 0.0)
"""Type 1: overcast, steep."""
SKY_ROWS = 64
"""Rows of a dome, 2.8 degrees each: the skies are smooth. Twice as many change the light in the water by 1e-3."""
LOWEST_SINE = 0.02
"""Least sine of an elevation: the exponent has a pole at the horizon."""


def standard_sky(shape: Shape, sun: Floats) -> NDArray[np.float64]:
    """Return the relative radiance (SKY_ROWS, 2 SKY_ROWS) of a sky and its mirror image. sun: (3,) towards it."""
    a, b, c, d, e = shape
    view = directions(2 * SKY_ROWS, SKY_ROWS)
    view = view * np.where(view[..., 1:2] < 0.0, [1.0, -1.0, 1.0], 1.0)
    cosine = np.clip(view @ sun, -1.0, 1.0)
    gradation = 1.0 + a * np.exp(b / np.maximum(view[..., 1], LOWEST_SINE))
    indicatrix = 1.0 + c * (np.exp(d * np.arccos(cosine)) - math.exp(d * 0.5 * PI)) + e * cosine**2
    return np.asarray(gradation * indicatrix)
