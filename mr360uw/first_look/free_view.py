# SPDX-License-Identifier: Apache-2.0
"""Finds the part of a panorama before which an object off the ground is seen best: open water, or sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.color import luminance
from mr360uw.first_look.water_or_air import red_ratio
from mr360uw.types import Floats

_WIDE_DEG, _HIGH_DEG = 26.0, 18.0
"""Size [deg] of the part that is looked for: somewhat more than an object."""
_COARSE_DEG = 4.0
"""Standard deviation [deg] of the blur whose difference from the picture counts as texture."""
_STEP_DEG = 5.0
_DIM = 0.002
"""Light that is added before logarithms are taken: noise of dark plates is no texture."""
_RED, _BLACK, _WHITE = 1.5, 0.25, 1.5
"""Costs of red, of darkness (a factor of e) and of clipping, over those of texture (rms of the logarithm of light)."""
_CLIPPED = 0.97
"""Linear light from which a pixel counts as clipped. Under water that is the sun's glitter; in air, an overcast sky."""
_OFF_LEVEL, _OFF_MIDDLE = 0.008, 0.002
"""Costs for a degree from the wanted elevation, and from the middle of the frame: ties go to where one looks first."""


@dataclass(frozen=True, slots=True)
class FreeView:
    """A part of a panorama. texture: rms of the logarithm of its light about its coarse course; 0.05 is open water.

    color: (3,) mean linear light.
    """

    azimuth_deg: float
    elevation_deg: float
    texture: float
    color: tuple[float, float, float]


def free_view(image: Floats, elevation_deg: tuple[float, float], *, underwater: bool) -> FreeView:
    """Return the freest part of a levelled panorama (h, w, 3) of linear light, its middle within these elevations.

    underwater: parts with the veil's colour, without red, are preferred, and parts that are not clipped. The cost is
    texture and what the constants say.
    """
    import cv2

    height, width = image.shape[:2]
    scale = height / 180.0
    pad = width // 8
    wrapped = np.concatenate([image[:, -pad:], image, image[:, :pad]], axis=1).astype(np.float32)
    light = np.log(np.maximum(luminance(wrapped), 0.0) + _DIM)
    fine = light - cv2.GaussianBlur(light, (0, 0), _COARSE_DEG * scale)
    box = (round(_WIDE_DEG * scale), round(_HIGH_DEG * scale))

    def mean(values: Floats) -> Floats:
        return np.asarray(cv2.blur(np.asarray(values, np.float32), box)[:, pad : pad + width])

    texture = np.sqrt(np.maximum(mean(fine * fine), 0.0))
    bright = mean(light)
    cost = texture + _BLACK * np.maximum(np.quantile(bright, 0.8) - bright, 0.0)
    if underwater:
        cost += _WHITE * mean((wrapped.max(axis=-1) > _CLIPPED).astype(np.float32))
        cost += _RED * mean(np.nan_to_num(np.minimum(red_ratio(wrapped), 1.0), nan=0.0))
    elevation = 90.0 - (np.arange(height) + 0.5) / scale
    azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 360.0
    low, high = elevation_deg
    cost += _OFF_LEVEL * np.abs(elevation - 0.5 * (low + high))[:, None] + _OFF_MIDDLE * np.abs(azimuth)
    cost[(elevation < low) | (elevation > high)] = np.inf
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    color = tuple(float(mean(wrapped[..., k])[row, column]) for k in range(3))
    near_azimuth, near_elevation = (round(v / _STEP_DEG) * _STEP_DEG + 0.0 for v in (azimuth[column], elevation[row]))
    near_elevation = float(np.clip(near_elevation, low, high))
    return FreeView(near_azimuth, near_elevation, float(texture[row, column]), (color[0], color[1], color[2]))
