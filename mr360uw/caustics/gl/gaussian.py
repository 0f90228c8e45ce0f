# SPDX-License-Identifier: Apache-2.0
"""Gaussian blur of a periodic map by two passes, one along x and one along a line that runs mostly along z.

A Gaussian of covariance S is the product of one along x of variance S_xx - S_xz^2/S_zz and one of variance S_zz over
rows, each row moved by S_xz/S_zz along x.
"""

from __future__ import annotations

import functools
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.gl.passes import Passes
from mr360uw.gl.context import texture_from_array

Array = NDArray[np.floating[Any]]

_REACH = 3.5
"""Half width of kernels in standard deviations; what lies beyond is 5e-4 of the weight."""
_AROUND = 2
"""Most tiles that a kernel reaches to either side; a Gaussian of half a tile leaves 1e-2 of the longest wave."""
_NO_SHEAR = 1e-3
"""Shift along x for each row below which rows are not moved: a tenth of a pixel a hundred rows away."""
_STEP = 1.0 / 64.0
"""Standard deviations are rounded to multiples of this [pixel], so that a slowly moving sun reuses kernels."""


def gaussian_blur(passes: Passes, target: moderngl.Texture, image: moderngl.Texture, covariance: Array) -> None:
    """Fill a texture with an image (size, size) convolved with a Gaussian of a covariance (2, 2) [pixel^2]."""
    (xx, xz), (_, zz) = covariance.tolist()
    shear = xz / zz if zz > 0.0 else 0.0
    along_x = xx - shear * xz
    shear = 0.0 if abs(shear) < _NO_SHEAR else shear
    half = passes.texture("half blurred", image.width, image.width)
    for to, source, variance, axis, moved in ((half, image, along_x, (1, 0), 0.0), (target, half, zz, (0, 1), shear)):
        weights = gaussian_weights(round(float(np.sqrt(variance)) / _STEP) * _STEP, image.width)
        passes.fill(
            [to], "sheared", {"image": source, "weights": texture_from_array(weights[None])}, axis=axis, shear=moved,
            reach=len(weights) - 1, size=image.width,
        )  # fmt: skip


@functools.lru_cache(maxsize=64)
def gaussian_weights(sigma_pixel: float, size: int) -> NDArray[np.float64]:
    """Return the middle and one side (m + 1,) of a sampled Gaussian of sum 1; it may reach around the map."""
    reach = min(int(np.ceil(_REACH * sigma_pixel)), _AROUND * size)
    weights = np.exp(-0.5 * (np.arange(reach + 1) / max(sigma_pixel, 1e-2)) ** 2)
    return weights / (2.0 * weights.sum() - weights[0])
