# SPDX-License-Identifier: Apache-2.0
"""Sun and sky of a clear day as they light the water: colour, and fraction of the light that is the sun's beam."""

from __future__ import annotations

import numpy as np

from mr360uw.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R, REFRACTIVE_INDEX_SEA
from mr360uw.ibl.sun.closure import BALANCED_SINE, clear_ratio, sunlight
from mr360uw.optics import fresnel_transmittance
from mr360uw.types import Floats

CLEAR_SKY_DIRECT = 0.75
"""Direct fraction of the irradiance just below the surface, for a high sun in a clear sky."""
_LEAST_WHITE = 0.65
"""Least share of a beam whose colour makes the sum with the sky white. Beams of less, of low suns and in haze, keep its
colour: with a share of 0.2 a white sum would leave no blue in them."""
CLEAR_SKY = np.array([CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B])


def beam_below(share: float, air_sine: float) -> Floats:
    """Return the irradiance (3,) of the sun's beam just below the surface over that of sun and sky together.

    share: of the beam in the luminance. air_sine: sine of the sun's elevation above the surface. A beam of a high sun
    and a sky of the colour `CLEAR_SKY` are white together; a sun below 45 degrees is redder by its longer way through
    the air.
    """
    high = max(share, _LEAST_WHITE)
    white = share * (1.0 - (1.0 - high) * CLEAR_SKY) / high
    return np.asarray(white * sunlight(min(air_sine, BALANCED_SINE)))


def direct_share(sine: float) -> float:
    """Return the fraction of the irradiance just below the surface that is the beam of a sun at a sine of elevation.

    Direct over diffuse goes with what clear air lets through over what it scatters, times what the surface lets through
    of the beam; at 45 degrees the fraction is `CLEAR_SKY_DIRECT`.
    """

    enters = fresnel_transmittance(np.array([sine, BALANCED_SINE]), REFRACTIVE_INDEX_SEA)
    whole = CLEAR_SKY_DIRECT / (1.0 - CLEAR_SKY_DIRECT) * float(enters[0] / enters[1])
    ratio = whole * clear_ratio(sine) / clear_ratio(BALANCED_SINE)
    return ratio / (1.0 + ratio)
