# SPDX-License-Identifier: Apache-2.0
"""What a panorama shows below the horizon: how much structure there is, and how light falls off with elevation.

Structure is taken between 3 and 12 degrees and along rows: grain is finer, and what open water does, it does in all
directions alike.
"""

from __future__ import annotations

import numpy as np

from mr360uw.color import luminance
from mr360uw.types import Floats

_FINE_DEG, _COARSE_DEG = 3.0, 12.0
_DARK = 0.01
"""Linear light that is added before the logarithm: what is darker has grain alone."""
_MARGIN_DEG = 36.0
"""Columns taken from the other side of the seam, three deviations of the coarse Gaussian."""


def ground_texture(image: Floats, lowest_deg: float, highest_deg: float) -> float:
    """Return the structure of a levelled panorama (h, w, 3) of linear light between two elevations.

    It is the root mean square along rows of the logarithm of light: 0.01 in open water, 0.06 and more over dry ground.
    """
    import cv2

    scale = image.shape[0] / 180.0
    margin = round(_MARGIN_DEG * scale)
    light = np.pad(luminance(np.maximum(image, 0.0)), ((0, 0), (margin, margin)), mode="wrap").astype(np.float32)
    fine = np.log(cv2.GaussianBlur(light, (0, 0), _FINE_DEG * scale) + _DARK)
    band = (fine - cv2.GaussianBlur(fine, (0, 0), _COARSE_DEG * scale))[_rows(scale, lowest_deg, highest_deg)]
    inner = band[:, margin:-margin]
    return float(np.std(inner - inner.mean(axis=1, keepdims=True)))


def light_at(image: Floats, lowest_deg: float, highest_deg: float) -> float:
    """Return the logarithm of a levelled panorama's light (h, w, 3) between two elevations: its median."""
    light = luminance(image[_rows(image.shape[0] / 180.0, lowest_deg, highest_deg)])
    return float(np.log(max(float(np.median(light)), 0.0) + _DARK))


def _rows(scale: float, lowest_deg: float, highest_deg: float) -> slice:
    return slice(round((90.0 - highest_deg) * scale), round((90.0 - lowest_deg) * scale))
