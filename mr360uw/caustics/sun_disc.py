# SPDX-License-Identifier: Apache-2.0
"""The blur of caustics by the sun's disc.

The sun is a disc of angular radius r; every ray is a narrow cone. On a plane at depth d the cone's footprint is an
ellipse, from the derivative of Snell's law: semi-axes d r cos(theta_a)/(n cos^3(theta_w)) along the sun's azimuth and d
r/(n cos(theta_w)) across it. Convolution with a uniform disc multiplies the spectrum by 2 J1(p)/p (Goodman 2005 section
2.1.5).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.refraction import refract_to_water

Array = NDArray[np.float64]


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
    return irfft2(rfft2(image) * disc_transform(p), s=image.shape)


def marginal_kernel(radius_pixel: float, size: int, keep: float = 1e-3) -> Array:
    """Return (2 m + 1,) symmetric weights, sum 1, of the disc's projection on one axis, periodic over `size` pixels.

    The product of two such kernels stands for the disc on the GPU: its spectrum equals the disc's along both axes.
    Weights below `keep` at both ends are dropped.
    """
    frequency = 2.0 * np.pi / size * np.arange(size // 2 + 1)
    weights = np.fft.irfft(disc_transform(radius_pixel * frequency), size)
    reach = size // 2 - 1 if size > 2 else 0
    large = np.flatnonzero(np.abs(weights[: reach + 1]) >= keep * weights[0])
    half = weights[: large[-1] + 1]
    kernel = np.concatenate([half[:0:-1], half])
    return kernel / kernel.sum()
