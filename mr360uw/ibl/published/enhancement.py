# SPDX-License-Identifier: Apache-2.0
"""Gain of the brightness enhancement of Kovaleski 2009, which depends on a pixel's surroundings.

A mask of pixels near the clip is spread by a cross-bilateral filter that stops at edges of the luminance:

    gain = 1 + boost e,   e = cross-bilateral(mask; luminance),   sigma 150 pixels of 1920 in space, 25/255 in range

It is worked out on the coarse map, whose pixels are finer than the filter's reach by a factor of fifteen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import DISPLAY_CURVE, encode
from mr360uw.constants import LUMINANCE_B, LUMINANCE_G, LUMINANCE_R
from mr360uw.types import Floats

_SIGMA_SPACE = 150.0 / 1920.0
"""Standard deviation of the filter in space, over the width of the frame, as published."""
_SIGMA_RANGE = 25.0 / 255.0
"""Standard deviation of the filter in code values of luma, as published."""
_THRESHOLD = 0.9
"""Code value of the brightest channel from which on a pixel counts as clipped."""
_BOOST = 3.0
"""Gain that is added where the filter finds nothing but such pixels."""


def enhancement_gain(coarse: Floats) -> NDArray[np.float32]:
    """Return the gain (h, w) of every pixel of a coarse linear map (h, w, 3) in [0, 1]."""
    import cv2

    width = coarse.shape[1]
    sigma = _SIGMA_SPACE * width
    code = encode(np.clip(coarse, 0.0, 1.0), DISPLAY_CURVE).astype(np.float32)
    mask = (code.max(axis=-1) >= _THRESHOLD).astype(np.float32)
    value = (code @ np.array([LUMINANCE_R, LUMINANCE_G, LUMINANCE_B], np.float32)).astype(np.float32)
    pad = int(2.0 * sigma)  # the frame closes at the seam
    guide, source = (np.pad(image, ((0, 0), (pad, pad)), mode="wrap") for image in (value, mask))
    spread = cv2.ximgproc.jointBilateralFilter(guide, source, d=2 * pad + 1, sigmaColor=_SIGMA_RANGE, sigmaSpace=sigma)
    return (1.0 + _BOOST * spread[:, pad:-pad]).astype(np.float32)
