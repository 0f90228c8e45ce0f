# SPDX-License-Identifier: Apache-2.0
"""Gains of the published pointwise inverse tone mapping operators.

Each is a gain on linear RGB, a function of one number per pixel, so that hue is kept and a video frame needs one table
of 256 or 1024 gains. Y' is luma, the weighted sum of code values in [0, 1]; L = decode(Y') is linear luminance.

    operator    gain                                                source
    mr360       strength Y'^power + base                            Iorns 2016; Thompson 2019 section 3
    landis      1 - w + peak w,   w = ((L - t)/(1 - t))^alpha       Landis 2002
    akyuz       peak L^(gamma - 1)                                  Akyuz 2007
    piecewise   slope 1 up to diffuse white, steeper above it       Meylan 2006

MR360 is published with the strength 10, the power 10, the base 1.8 and the weights .3 .59 .11; Landis with the
threshold t = 0.5 and the exponent alpha = 2, Akyuz with gamma = 1. Diffuse white is at 0.85.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import DISPLAY_CURVE, LUMINANCE, decode
from mr360uw.ibl.settings import LightSettings, Operator

Array = NDArray[np.float64]

POINTWISE: tuple[Operator, ...] = ("mr360", "landis", "akyuz", "piecewise")
"""Operators whose gain is a function of one pixel's luma. The others are "none", "closure" (a sum over the picture) and
"kovaleski" (of a pixel's surroundings)."""
MR360_WEIGHTS = np.array([0.3, 0.59, 0.11])
"""Luma weights of the MR360 operator, as published."""


def mr360_gain(luma: ArrayLike, strength: float = 10.0, power: float = 10.0, base: float = 1.8) -> Array:
    """Return the MR360 gain of luma (...,) in [0, 1]."""
    return strength * np.power(luma, power) + base


def landis_gain(value: ArrayLike, peak: float, threshold: float = 0.5, alpha: float = 2.0) -> Array:
    """Return the gain of Landis 2002 for linear luminance in [0, 1]."""
    w = np.power(np.maximum(np.asarray(value) - threshold, 0.0) / (1.0 - threshold), alpha)
    return 1.0 + (peak - 1.0) * w


def akyuz_gain(value: ArrayLike, peak: float, gamma: float = 1.0) -> Array:
    """Return the gain of Akyuz 2007 for linear luminance in [0, 1], with black at 0 and white at 1."""
    return peak * np.power(np.maximum(value, 1e-6), gamma - 1.0)


def piecewise_gain(value: ArrayLike, peak: float, split: float = 0.85) -> Array:
    """Return the gain of the two slopes of Meylan 2006 for linear luminance in [0, 1]."""
    excess = np.maximum(np.asarray(value) - split, 0.0)
    return 1.0 + excess * ((peak - split) / (1.0 - split) - 1.0) / np.maximum(value, split)


def gain(luma: ArrayLike, settings: LightSettings) -> Array:
    """Return the gain of the chosen pointwise operator at luma (...,); 1 for those that are not pointwise."""
    luma = np.clip(np.asarray(luma, np.float64), 0.0, 1.0)
    if settings.operator == "mr360":
        return mr360_gain(luma)
    value = decode(luma, DISPLAY_CURVE)
    if settings.operator == "landis":
        return landis_gain(value, settings.peak)
    if settings.operator == "akyuz":
        return akyuz_gain(value, settings.peak)
    if settings.operator == "piecewise":
        return piecewise_gain(value, settings.peak)
    return np.ones_like(luma)


def luma_weights(settings: LightSettings) -> Array:
    """Return the weights (3,) of R', G', B' in the luma that the chosen operator reads."""
    return MR360_WEIGHTS if settings.operator == "mr360" else LUMINANCE
