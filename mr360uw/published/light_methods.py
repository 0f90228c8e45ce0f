# SPDX-License-Identifier: Apache-2.0
"""Published ways of taking light from a plate: inverse tone mapping, and irradiance by nine spherical harmonics.

Inverse tone mapping gives gains on linear RGB, so that hue is kept.

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

Irradiance maps by nine spherical harmonics (Ramamoorthi 2001, equations 5 to 8):

    E(n) = sum_lm A_l L_lm Y_lm(n),   L_lm = int L(d) Y_lm(d) dd,   A_0, A_1, A_2 = pi, 2 pi/3, pi/4

Smooth, a few percent off under a sun, and negative there on the far side: the exact integral (`ibl.cosine`) is as fast.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import DISPLAY_CURVE, LUMINANCE, decode, encode
from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.sphere import directions, row_solid_angle
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


_COSINE_BANDS = np.pi * np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 0.25, 0.25, 0.25, 0.25, 0.25])


@functools.cache
def _harmonics(columns: int, rows: int) -> NDArray[np.float64]:
    """Return the nine real harmonics of order 0 to 2 in the directions of a map, (H, W, 9)."""
    x, y, z = np.moveaxis(directions(columns, rows), -1, 0)
    one = np.ones_like(x)
    basis = [
        0.282095 * one, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
        0.315392 * (3.0 * z * z - 1.0), 1.092548 * x * z, 0.546274 * (x * x - y * y),
    ]  # fmt: skip
    return np.stack(basis, axis=-1)


def harmonic_irradiance(radiance: ArrayLike) -> Floats:
    """Return the irradiance map (32, 64, 3), in radiance x sr, of a radiance map (H, W, 3)."""
    image = np.asarray(radiance, np.float64)
    height, width = image.shape[:2]
    basis = _harmonics(width, height) * row_solid_angle(width, height)[:, None, None]
    harmonics = np.tensordot(basis, image, ([0, 1], [0, 1]))
    return (_harmonics(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS) @ (_COSINE_BANDS[:, None] * harmonics)).astype(np.float32)
