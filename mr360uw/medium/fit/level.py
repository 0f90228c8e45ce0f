# SPDX-License-Identifier: Apache-2.0
"""Gain of the veil from a thin band of a plate at the horizon, where rays are long and show water alone.

    g = typical over azimuths of plate/model        residual = rms of (plate/(g model) - 1)

Below the band lies the ground, above it the surface. Azimuths in which a body or a rock breaks the horizon have clearly
more red than water, or stand out of the others; both lose weight continuously, so that the gain changes no faster than
the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.medium.fit.profile import typical
from mr360uw.medium.medium import Medium
from mr360uw.shapes import exactly, vectors
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

Array = NDArray[np.float64]

BAND_RAD = np.radians(1.0)
"""Half height [rad] of the band, one row at least. Twice as high, sand 3 m below shows in the clearest water."""
SECTORS = 64
"""Azimuths that are told apart; each is a mean over hundreds of pixels, in which noise and dither are gone."""
DOUBTFUL = 0.45
"""Residual from which the gain counts as not known: open water varies by up to 0.37 about a low sun, by a tenth without
one; rocks and walls by 0.5 and more."""
_TYPICAL_RANK = 0.3
"""Rank in red of an azimuth that shows water alone, as long as bodies and rocks leave a third of the horizon."""
_OPEN, _CLOSED = 1.2, 1.6
"""Red over that azimuth's between which the weight of an azimuth falls to 0.

Dark red is coarse in a video: weights by rank alone would choose the azimuths whose codes were rounded down, and the
gain of red would be 1 to 3 % low.
"""
MIDDLE = 0.5
"""Fraction of the open azimuths about the median that is averaged; bodies may cover a quarter of them unseen."""
_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """A plate's light just above and below the horizon.

    up: (2,) y of the directions, of either sign. radiance: (2, SECTORS, 3) means, linear, not clipped.
    """

    up: Array
    radiance: Floats


def fit_level(medium: Medium, view: LevelView) -> tuple[Array, float]:
    """Return the gain (3,) that makes the model's level radiance that of the plate's water, and the residual.

    residual: rms of the luminance's relative deviation over the azimuths, whether they are taken for water or not; from
    `DOUBTFUL` on there is no open water to measure. A channel that is black has the gain 0.
    """
    seen = vectors("radiance", view.radiance).astype(np.float64)
    up = exactly("up", view.up, (len(seen),)).astype(np.float64)
    model = medium.level_radiance(up)
    columns = (seen / np.maximum(model, _TINY)[:, None]).mean(axis=0)
    shown = np.maximum(seen.mean(axis=0), 0.0)
    gain = np.maximum(typical(columns, _openness(shown), MIDDLE), 0.0)
    light = luminance(gain * model.mean(axis=0))
    if light <= 0.0:
        return gain, 0.0
    return gain, float(np.sqrt(np.mean((luminance(shown) / light - 1.0) ** 2)))


def _openness(shown: Array) -> Array:
    """Return the weight (c,) of azimuths by the fraction of red in their light (c, 3): bodies have more than water."""
    red = shown[:, 0] / np.maximum(shown.sum(axis=1), _TINY)
    excess = red / max(float(np.quantile(red, _TYPICAL_RANK)), _TINY)
    weight = smoothstep(excess, _CLOSED, _OPEN)
    return np.asarray(weight if np.any(weight > 0.0) else np.ones(len(red)))
