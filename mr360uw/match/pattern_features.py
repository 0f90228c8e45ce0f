# SPDX-License-Identifier: Apache-2.0
"""Numbers that tell the waves above a pattern of caustics: its spectrum, its speeds, and the shape of its light.

Waves that focus beyond their focal depth saturate: the variance no longer grows with the wind, and log spectra alone
tell wind and dominant wave to about 27 and 36 % (one standard deviation, 8 m of floor for 2 s). How the light is
distributed about its mean, and how steep its edges are, at several widths, tells both to about 10 %.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.match.pattern_measures import PatternMeasures
from mr360uw.types import Floats

Array = NDArray[np.float64]

_WIDTHS = (0.21, 0.42, 0.85)
"""Standard deviations of the blurs, over the shortest wavelength that is seen."""
_RANKS = (0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
_TINY = 1e-12


def pattern_features(relative: Floats, measures: PatternMeasures, pixel_m: float, finest_m: float) -> Array:
    """Return the features (f,) of a pattern C (T, n, n). finest_m: shortest wavelength that is seen."""
    found = [*np.log(measures.power + _TINY), *np.log(measures.frequency_rad_s + _TINY), np.hypot(*measures.direction)]
    for width in _WIDTHS:
        found += _shape(_blurred(relative, width * finest_m / pixel_m), measures.direction)
    return np.array(found)


def _shape(c: Floats, direction: Array) -> list[float]:
    """Return the distribution of a pattern's light, and how fast it changes over place and time."""
    spread = max(float(c.std()), _TINY)
    c = c / np.float32(spread)
    x, z, t = np.diff(c, axis=2)[:, :-1], np.diff(c, axis=1)[:, :, :-1], np.diff(c, axis=0)
    tensor = np.array([[np.mean(x * x), np.mean(x * z)], [np.mean(x * z), np.mean(z * z)]])
    along = direction / max(float(np.hypot(*direction)), _TINY)
    part = float(along @ tensor @ along) / max(float(np.trace(tensor)), _TINY)
    cube = c * c * c
    moments = [float(np.mean(cube)), np.log(float(np.mean(cube * c)) + _TINY)]
    change = [0.5 * np.log(float(np.trace(tensor)) + _TINY), np.log(float(t.std()) + _TINY)]
    return [np.log(spread), *moments, *np.quantile(c, _RANKS), *change, part]


def _blurred(relative: Floats, sigma: float) -> NDArray[np.float32]:
    import cv2

    c = relative.astype(np.float32)
    return np.array([cv2.GaussianBlur(one, (0, 0), sigma) for one in c])
