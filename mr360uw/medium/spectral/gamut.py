# SPDX-License-Identifier: Apache-2.0
"""Gamut compression: maps colours outside Rec.709 into it smoothly instead of clipping them.

Light in clear water is more saturated than any mixture of Rec.709 primaries: its red is negative. Each channel's
distance from the largest, d = 1 - x/max, is compressed above a threshold towards 1, so that no channel is negative and
colours well inside are unchanged. The luminance is then restored. The curve is that of the reference gamut compression
of ACES 1.3 (AMPAS 2021) with its limit at infinity. It scales: k times a colour gives k times the result.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import luminance
from mr360uw.constants import GAMUT_POWER, GAMUT_THRESHOLD
from mr360uw.shapes import vectors

Array = NDArray[np.float64]


def compress_gamut(rgb: ArrayLike) -> Array:
    """Return linear Rec.709 colours (..., 3) with no negative channel and the luminance they had (0 if negative)."""
    c = vectors("rgb", rgb).astype(np.float64, copy=False)
    largest = np.maximum(c.max(axis=-1, keepdims=True), 0.0)
    d = 1.0 - np.divide(c, largest, out=np.ones(c.shape), where=largest > 0.0)
    x = np.maximum(d - GAMUT_THRESHOLD, 0.0) / (1.0 - GAMUT_THRESHOLD)
    compressed = GAMUT_THRESHOLD + (1.0 - GAMUT_THRESHOLD) * x / (1.0 + x**GAMUT_POWER) ** (1.0 / GAMUT_POWER)
    mapped = largest * (1.0 - np.where(d > GAMUT_THRESHOLD, compressed, d))
    before, after = luminance(c)[..., None], luminance(mapped)[..., None]
    return mapped * np.divide(np.maximum(before, 0.0), after, out=np.ones(before.shape), where=after > 0.0)
