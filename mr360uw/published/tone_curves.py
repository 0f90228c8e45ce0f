# SPDX-License-Identifier: Apache-2.0
"""Gains of the published inverse tone mapping operators: on linear RGB, so that hue is kept.

Four are functions of one number per pixel. Y' is luma, the weighted sum of code values in [0, 1]; L = decode(Y') is
linear luminance.

    operator    gain                                                source
    mr360       strength Y'^power + base                            Iorns 2016; Thompson 2019 section 3
    landis      1 - w + peak w,   w = ((L - t)/(1 - t))^alpha       Landis 2002
    akyuz       peak L^(gamma - 1),   gamma = 1                     Akyuz 2007
    piecewise   slope 1 up to diffuse white, steeper above it       Meylan 2006

MR360 is published with the strength 10, the power 10, the base 1.8 and the weights .3 .59 .11; Landis with the
threshold t = 0.5 and the exponent alpha = 2, Akyuz with gamma = 1. Diffuse white is at 0.85.

The brightness enhancement of Kovaleski 2009 depends on a pixel's surroundings. A mask of pixels near the clip is spread
by a cross-bilateral filter that stops at edges of the luminance; it is worked out on a small map of the frame, whose
pixels are finer than the filter's reach by a factor of fifteen:

    gain = 1 + boost e,   e = cross-bilateral(mask; luminance),   sigma 150 pixels of 1920 in space, 25/255 in range
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import DISPLAY_CURVE, LUMINANCE, decode, encode
from mr360uw.types import Floats

Array = NDArray[np.float64]

_SIGMA_SPACE = 150.0 / 1920.0
"""Standard deviation of the filter in space, over the width of the frame, as published."""
_SIGMA_RANGE = 25.0 / 255.0
"""Standard deviation of the filter in code values of luma, as published."""
_THRESHOLD = 0.9
"""Code value of the brightest channel from which on a pixel counts as clipped."""
_BOOST = 3.0
"""Gain that is added where the filter finds nothing but such pixels."""
_DIFFUSE_WHITE = 0.85
"""Linear luminance from which on the slope of piecewise is steeper."""
MR360_WEIGHTS = np.array([0.3, 0.59, 0.11])
"""Luma weights of the MR360 operator, as published."""


def pointwise_gain(operator: str, encoded: Floats, peak: float) -> Array:
    """Return the gain (...,) of an operator for encoded colours (..., 3). peak: of landis, akyuz and piecewise."""
    luma = np.clip(encoded @ (MR360_WEIGHTS if operator == "mr360" else LUMINANCE).astype(encoded.dtype), 0.0, 1.0)
    luma = luma.astype(np.float64)
    if operator == "mr360":
        return 10.0 * np.power(luma, 10.0) + 1.8
    value = decode(luma, DISPLAY_CURVE)
    if operator == "landis":
        return 1.0 + (peak - 1.0) * np.square(np.maximum(value - 0.5, 0.0) / 0.5)
    if operator == "akyuz":
        return np.full_like(value, peak)
    slope = (peak - _DIFFUSE_WHITE) / (1.0 - _DIFFUSE_WHITE) - 1.0
    return 1.0 + np.maximum(value - _DIFFUSE_WHITE, 0.0) * slope / np.maximum(value, _DIFFUSE_WHITE)


def enhancement_gain(linear: Floats) -> NDArray[np.float32]:
    """Return the gain (h, w) of Kovaleski 2009 for every pixel of a small linear map (h, w, 3) in [0, 1]."""
    import cv2

    sigma = _SIGMA_SPACE * linear.shape[1]
    code = encode(linear, DISPLAY_CURVE).astype(np.float32)
    mask = (code.max(axis=-1) >= _THRESHOLD).astype(np.float32)
    luma = (code @ LUMINANCE).astype(np.float32)
    pad = int(2.0 * sigma)  # the frame closes at the seam
    guide, source = (np.pad(image, ((0, 0), (pad, pad)), mode="wrap") for image in (luma, mask))
    spread = cv2.ximgproc.jointBilateralFilter(guide, source, d=2 * pad + 1, sigmaColor=_SIGMA_RANGE, sigmaSpace=sigma)
    return (1.0 + _BOOST * spread[:, pad:-pad]).astype(np.float32)
