# SPDX-License-Identifier: Apache-2.0
"""Blurs of a periodic map by two passes: the sun's disc, and Gaussians.

A disc is the product of its projections on both axes. A Gaussian of covariance S is the product of one along x of
variance S_xx - S_xz^2/S_zz and one of variance S_zz over rows, each row moved by S_xz/S_zz along x.
"""

from __future__ import annotations

import functools
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.sun_disc import KERNEL_STEP, marginal_kernel
from mr360uw.caustics.gl.passes import Passes
from mr360uw.gl.context import texture_from_array

Array = NDArray[np.floating[Any]]

NO_BLUR_PIXELS = 0.25
"""Half width [pixel] of the sun's image below which maps are not blurred.

The standard deviation that is left out is an eighth of a pixel; a bilinear read adds half a pixel anyway.
"""
_REACH = 3.5
"""Half width of kernels in standard deviations; what lies beyond is 5e-4 of the weight."""
_AROUND = 2
"""Most tiles that a kernel reaches to either side; a Gaussian of half a tile leaves 1e-2 of the longest wave."""
_NO_SHEAR = 1e-3
"""Shift along x for each row below which rows are not moved: a tenth of a pixel a hundred rows away."""
_STEP = 1.0 / 64.0
"""Standard deviations are rounded to multiples of this [pixel], so that a slowly moving sun reuses kernels."""


def disc_blur(
    passes: Passes, target: moderngl.Texture, image: moderngl.Texture, radii_pixel: tuple[float, float]
) -> None:
    """Fill a texture with an image (size, size) convolved with a disc of half widths along x and z [pixel]."""
    half = passes.texture("half blurred", image.width, image.width)
    for to, source, radius, axis in (
        (half, image, radii_pixel[0], (1, 0)), (target, half, radii_pixel[1], (0, 1))
    ):  # fmt: skip
        kernel = marginal_kernel(round(radius / KERNEL_STEP) * KERNEL_STEP, image.width)
        reach = len(kernel) // 2
        passes.fill(
            [to], "blur", {"image": source, "weights": texture_from_array(kernel[None, reach:])}, axis=axis, shear=0.0,
            scale=1.0, reach=reach, size=image.width,
        )  # fmt: skip


def gaussian_sum(
    passes: Passes, name: str, image: moderngl.Texture, blurs: list[tuple[float, Array]], pixels_per_m: float
) -> moderngl.Texture:
    """Return a texture of an image convolved with a sum of Gaussians: weights, and (2, 2) matrices [m]."""
    size, onto = image.width, None
    for number, (weight, matrix) in enumerate(blurs):
        target = passes.texture(name if number % 2 == (len(blurs) - 1) % 2 else f"{name}, before", size, size)
        gaussian_blur(passes, target, image, matrix @ matrix.T * pixels_per_m**2, weight, onto)
        onto = target
    assert onto is not None
    return onto


def gaussian_blur(
    passes: Passes,
    target: moderngl.Texture,
    image: moderngl.Texture,
    covariance: Array,
    weight: float = 1.0,
    onto: moderngl.Texture | None = None,
) -> None:
    """Fill a texture with an image (size, size) convolved with a Gaussian of a covariance (2, 2) [pixel^2].

    It is multiplied by `weight` and added to the image `onto`.
    """
    (xx, xz), (_, zz) = covariance.tolist()
    shear = xz / zz if zz > 0.0 else 0.0
    along_x = xx - shear * xz
    shear = 0.0 if abs(shear) < _NO_SHEAR else shear
    half = passes.texture("half blurred", image.width, image.width)
    for to, source, variance, axis, moved in ((half, image, along_x, (1, 0), 0.0), (target, half, zz, (0, 1), shear)):
        kernel = gaussian_weights(round(float(np.sqrt(max(variance, 0.0))) / _STEP) * _STEP, image.width)
        inputs = {"image": source, "weights": texture_from_array(kernel[None])}
        uniforms: dict[str, Any] = {"axis": axis, "shear": moved, "reach": len(kernel) - 1, "size": image.width}
        if to is target and onto is not None:
            inputs["onto"] = onto
            uniforms["ADD"] = 1
        passes.fill([to], "blur", inputs, scale=weight if to is target else 1.0, **uniforms)


@functools.lru_cache(maxsize=64)
def gaussian_weights(sigma_pixel: float, size: int) -> NDArray[np.float64]:
    """Return the middle and one side (m + 1,) of a sampled Gaussian of sum 1; it may reach around the map."""
    reach = min(int(np.ceil(_REACH * sigma_pixel)), _AROUND * size)
    weights = np.exp(-0.5 * (np.arange(reach + 1) / max(sigma_pixel, 1e-2)) ** 2)
    return weights / (2.0 * weights.sum() - weights[0])
