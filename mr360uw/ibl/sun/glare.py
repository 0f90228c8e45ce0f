# SPDX-License-Identifier: Apache-2.0
"""Takes the glare about a sun out of the sky that a camera sees through Snell's window.

Waves and the water's small-angle scattering spread the sun over many degrees. That light is the beam's; what stays of
it in the sky would count twice, and most of all in red, of which deep water leaves the sky little. The sky itself
hardly depends on the azimuth, so near the sun it is that of the same elevation far from the sun:

    residual' = residual + w (sky(elevation) - residual)       w: `amount` near the sun, 0 from `_REACH_RAD` on

Bodies before the sky, far darker than it, stay.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.ibl.level.upward import elevation_sine
from mr360uw.ibl.plate import Plate, coarse_directions, coarse_solid_angle
from mr360uw.ibl.sun.split import Split
from mr360uw.types import Floats

_REACH_RAD = np.radians(20.0)
"""Angle from the sun [rad] from which the sky is its own. At 16 and at 25 degrees its irradiance differs by 1 %; far
beyond, the sky near a high sun would be read from the window's edge."""
_FADE = 0.25
"""Fraction of that angle over which the weight falls to 0."""
_RINGS = 64
"""Steps of elevation, 1.4 degrees, a pixel of the coarse map each."""
_FEWEST = 6
"""Fewest pixels far from the sun that tell the sky of an elevation; others take that of the nearest."""
_BODY, _SKY = 0.4, 0.7
"""Luminance over that of the sky up to which a pixel is a body, and from which it is sky."""


def without_glare(split: Split, plate: Plate, amount: float = 1.0) -> Split:
    """Return a split whose residual near the sun is the sky's; what is taken out of it is added to the sun.

    amount: of the glare that is taken out, 0 to 1.
    """
    if amount <= 0.0:
        return split
    above, elevation, rings = _rings(tuple(plate.up.tolist()))
    angle = np.arccos(np.clip(coarse_directions() @ split.sun.direction.astype(np.float32), -1.0, 1.0))
    near = above & (angle < _REACH_RAD)
    far = above & ~near
    ring = rings[far]
    count = np.bincount(ring, minlength=_RINGS)
    told = count >= _FEWEST
    if not np.any(near) or not np.any(told):
        return split
    place = np.bincount(ring, elevation[far], _RINGS)[told] / count[told]
    shown = split.residual[far]
    sky = np.stack(
        [
            np.interp(elevation[near], place, np.bincount(ring, shown[:, k], _RINGS)[told] / count[told])
            for k in range(3)
        ],
        axis=-1,
    )
    seen = split.residual[near]
    clear = np.clip((luminance(seen) / np.maximum(luminance(sky), 1e-12) - _BODY) / (_SKY - _BODY), 0.0, 1.0)
    weight = amount * clear * np.clip((_REACH_RAD - angle[near]) / (_FADE * _REACH_RAD), 0.0, 1.0)
    change = weight[:, None] * (sky - seen)
    residual = split.residual.copy()
    residual[near] = seen + change
    area = np.broadcast_to(coarse_solid_angle(), near.shape)[near]
    taken: Floats = np.maximum(split.sun.irradiance - area @ change, 0.0).astype(np.float32)
    return Split(residual, replace(split.sun, irradiance=taken))


@functools.lru_cache(maxsize=4)
def _rings(up: tuple[float, ...]) -> tuple[NDArray[np.bool_], Floats, NDArray[Any]]:
    """Return of the coarse map's pixels (128, 256): whether they are above the horizon, elevation [rad], and ring."""
    sine = elevation_sine(coarse_directions(), np.array(up))
    elevation = np.arcsin(np.clip(sine, -1.0, 1.0))
    ring = np.clip((elevation * (2.0 * _RINGS / np.pi)).astype(np.int64), 0, _RINGS - 1)
    return sine > 0.0, elevation, ring
