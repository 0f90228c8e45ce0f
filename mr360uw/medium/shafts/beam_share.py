# SPDX-License-Identifier: Apache-2.0
"""Fraction of the veil that shafts can change, and the beam's whole light scattered once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.lookup import beam_fraction
from mr360uw.medium.medium import Medium
from mr360uw.medium.shafts.shaft_water import ShaftWater
from mr360uw.types import Floats

Array = NDArray[np.float64]

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
