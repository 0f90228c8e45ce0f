# SPDX-License-Identifier: Apache-2.0
"""The blur of caustics by the sun's disc.

The sun is a disc of angular radius r; every ray is a narrow cone. On a plane at depth d the cone's footprint is an
ellipse, from the derivative of Snell's law: semi-axes d r cos(theta_a)/(n cos^3(theta_w)) along the sun's azimuth and d
r/(n cos(theta_w)) across it. Convolution with a uniform disc multiplies the spectrum by 2 J1(p)/p (Goodman 2005 section
2.1.5). Sampled on pixels, that kernel rings a little; what falls below zero is cut, and the mean kept.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.refraction import refract_to_water

Array = NDArray[np.floating[Any]]

_FITTED_REACH = 4


def footprint(sun_in_air: Array, refractive_index: float, half_angle_rad: float, depth_m: float) -> Array:
    """Return the (2, 2) matrix that maps the unit disc to the sun's image on the plane, in metres over (x, z)."""
    water = refract_to_water(sun_in_air, refractive_index)
    horizontal = sun_in_air[[0, 2]]
    sine = float(np.hypot(*horizontal))
    along = horizontal / sine if sine > 0.0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    scale = depth_m * half_angle_rad / (refractive_index * water[1])
    return scale * np.stack([along * sun_in_air[1] / water[1] ** 2, across], axis=1)


def disc_transform(p: Array) -> Array:
    """Return 2 J1(p)/p, the Fourier transform of the uniform unit disc."""
    from scipy.special import j1

    safe = np.where(p == 0.0, 1.0, p)
    return np.where(p == 0.0, 1.0, 2.0 * j1(safe) / safe)


def blur(image: Array, footprint_m: Array, tile_m: float) -> Array:
    """Return a periodic image (size, size) convolved with the disc's footprint; the mean stays."""
    if not np.any(footprint_m):
        return image
    from scipy.fft import irfft2, rfft2

    size = image.shape[0]
    kx = 2.0 * np.pi / tile_m * np.arange(size // 2 + 1)
    kz = 2.0 * np.pi / tile_m * size * np.fft.fftfreq(size)[:, None]
    p = np.hypot(*(footprint_m[0, i] * kx + footprint_m[1, i] * kz for i in (0, 1)))
    blurred = np.maximum(irfft2(rfft2(image) * disc_transform(p), s=image.shape), 0.0)
    return blurred * (image.mean() / blurred.mean())


@functools.lru_cache(maxsize=64)
def marginal_kernel(radius_pixel: float, size: int) -> Array:
    """Return (2 m + 1,) symmetric weights, sum 1, of the disc's projection on one axis, periodic over `size` pixels.

    The product of two such kernels stands for the disc on the GPU: its spectrum equals the disc's along both axes. None
    is negative: small ones are fitted to that spectrum, large ones are its transform, cut at the disc's edge.
    """
    m = min(math.ceil(radius_pixel), (size - 1) // 2)
    if m == 0:
        return np.ones(1)
    if m <= _FITTED_REACH:
        from scipy.optimize import nnls

        w = np.linspace(0.0, np.pi, 200)[:, None]
        cosines = np.concatenate([np.ones_like(w), 2.0 * np.cos(w * np.arange(1, m + 1))], axis=1)
        emphasis = 1.0 / (1.0 + 3.0 * w)  # a caustic's spectrum falls off like this
        half, _ = nnls(cosines * emphasis, (disc_transform(radius_pixel * w) * emphasis)[:, 0])
    else:
        frequency = 2.0 * np.pi / size * np.arange(size // 2 + 1)
        half = np.maximum(np.fft.irfft(disc_transform(radius_pixel * frequency), size), 0.0)[: m + 1]
    kernel = np.concatenate([half[:0:-1], half])
    return kernel / kernel.sum()
