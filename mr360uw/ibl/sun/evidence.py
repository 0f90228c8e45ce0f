# SPDX-License-Identifier: Apache-2.0
"""How strong a clipped sun was, by what did not clip: the sky's glow about it, and the ground that it lights.

    R = sqrt(R_glow R_ground)         direct over diffuse horizontal irradiance
    R_glow = 0.1 (G - 4)              G: radiance of the sky 4 degrees from the sun, over that far from it
    R_ground = B / 0.3 - 1            B: radiance of the bright part of the ground, over white's under the sky alone

The clearer the air, the more of its light a sun sends straight and the steeper the glow that is left; G is 4 or less
under a cloud or at dusk, without any beam. Where more is clipped than 4 degrees, the glow further out is followed
inwards as the inverse of the angle. The brightest tenth of the ground is sunlit and of albedo 0.3, or lit by the sky
alone. Neither is exact; only where both speak for a sun there is much of one. Where hardly more than the sun's
disc is clipped, it shines through clear air, whose ratio then stands for that of the glow.
"""

from __future__ import annotations

import itertools

import numpy as np

from mr360uw.color import luminance
from mr360uw.ibl.plate import Plate, coarse_directions, coarse_solid_angle, plate_sines
from mr360uw.types import Floats

_GLOW_PER_RATIO, _GLOW_OF_CLOUD = 0.1, 4.0
_ALBEDO = 0.3
_NEAR_RAD, _FAR_RAD = np.radians(4.0), np.radians(50.0)
"""Angles from the sun [rad] whose radiance is compared."""
_RINGS = 12
"""Rings of the sky between them that are looked at, evenly spaced in the logarithm of the angle."""
_FEWEST = 4
"""Fewest pixels of a ring; of the ground, and of the sky far from the sun, a hundred times as many."""
_CLIPPED = 0.9
"""Radiance up to which a coarse pixel, a mean of many of the plate's, holds none that clipped."""
_LOWEST_SINE = 0.05
"""Sine of the elevation above which is sky, and below whose negative is ground."""
_GROUND_QUANTILE = 0.9
_LEAST, _MOST = 0.05, 5.0
"""Limits of both ratios: from a sun behind clouds to the clearest sky."""
UNKNOWN_RATIO = 1.0
"""The ratio where a plate shows neither: between haze (0.2) and a clear sky (5)."""


def shown_ratio(plate: Plate, direction: Floats, sky: Floats, clear: float | None) -> float:
    """Return the direct over diffuse horizontal irradiance that a clipped plate speaks for.

    direction: (3,) of the sun. sky: (3,) horizontal irradiance without it. clear: the ratio in clear air where the
    plate shows the sun's disc, None where it does not.
    """
    value = luminance(plate.coarse)
    sine = plate_sines(plate)
    known = [
        float(np.clip(ratio, _LEAST, _MOST))
        for ratio in (_by_glow(plate, value, sine, direction) if clear is None else clear, ground_ratio(plate, sky))
        if ratio is not None
    ]
    return float(np.exp(np.mean(np.log(known)))) if known else UNKNOWN_RATIO


def _by_glow(plate: Plate, value: Floats, sine: Floats, direction: Floats) -> float | None:
    angle = np.arccos(np.clip(coarse_directions() @ direction, -1.0, 1.0))
    above = sine > _LOWEST_SINE
    far = value[above & (angle > _FAR_RAD)]
    open_sky = above & (plate.brightest < _CLIPPED)
    edges = np.geomspace(_NEAR_RAD / 1.25, _FAR_RAD, _RINGS + 1)
    if far.size < 100 * _FEWEST or float(np.median(far)) <= 0.0:
        return None
    for inner, outer in itertools.pairwise(edges):
        ring = (angle > inner) & (angle <= outer)
        seen = ring & open_sky
        if np.count_nonzero(seen) < max(_FEWEST, 0.5 * np.count_nonzero(ring & above)):
            continue
        near = float(np.median(value[seen])) * float(np.sqrt(inner * outer)) / _NEAR_RAD
        return _GLOW_PER_RATIO * (near / float(np.median(far)) - _GLOW_OF_CLOUD)
    return None


def ground_ratio(plate: Plate, sky: Floats) -> float | None:
    """Return the ratio that the ground alone speaks for; below 0 where it is darker than the sky lights it.

    sky: (3,) horizontal irradiance. None where there is neither ground nor light.
    """
    value = luminance(plate.coarse)
    ground = plate_sines(plate) < -_LOWEST_SINE
    white = float(luminance(sky)) / np.pi
    if np.count_nonzero(ground) < 100 * _FEWEST or white <= 0.0:
        return None
    weight = np.broadcast_to(coarse_solid_angle(), value.shape)[ground]
    order = np.argsort(value[ground])
    share = np.cumsum(weight[order])
    bright = float(np.interp(_GROUND_QUANTILE * share[-1], share, value[ground][order]))
    return bright / white / _ALBEDO - 1.0
