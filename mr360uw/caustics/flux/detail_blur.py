# SPDX-License-Identifier: Apache-2.0
"""Blur of caustics by waves that are too short to be drawn.

Waves of random slope s turn a ray's slope m by J s to first order. Below their own focus many of them send light to
every place, and what is seen is the mean over their slopes: on a plane at depth d the map is convolved with the
distribution of d J s. Slopes are Gaussian (Cox & Munk 1954) and even over all directions, of variance slope^2/2 along
each axis, so the convolution is with a Gaussian of matrix d slope/sqrt(2) J.

With L_a and L_w the directions towards the sun in air and water, u the horizontal part of L_w and n the refractive
index, the derivative of Snell's law on a flat sea is

    J = f (I + u u^T/L_wy^2)        f = 1 - L_ay/(n L_wy)
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import refract_to_water

Array = NDArray[np.floating[Any]]

_STEP = 1.0 / 64.0
"""Gaussians' matrices are rounded to multiples of this [pixel], so that a slowly moving sun reuses their transforms."""
LEAST_PIXELS = 0.5
"""Standard deviation [pixel] up to which maps are not blurred: that of a bilinear read of a pixel."""
_SAMPLED_BELOW = 1.0
"""Least standard deviation [pixel] of Gaussians whose Fourier transform is taken from the continuous one.

Narrower ones are sampled: the continuous transform has not faded at the map's highest frequency, and rings below zero.
"""
_REACH = 5.0
"""Half width of sampled Gaussians in standard deviations."""


def detail_footprint(sun_in_air: Array, refractive_index: float, rms_slope: float, depth_m: float) -> Array:
    """Return the symmetric (2, 2) matrix A [m] over (x, z) whose A A^T is the blur's covariance on the plane."""
    water = refract_to_water(sun_in_air, refractive_index)
    across = water[[0, 2]] / water[1]
    bend = 1.0 - float(sun_in_air[1]) / (refractive_index * float(water[1]))
    return depth_m * rms_slope / np.sqrt(2.0) * bend * (np.eye(2) + np.outer(across, across))


def gaussian_transform(matrix_m: Array, size: int, tile_m: float) -> Array | None:
    """Return the factor (size, size/2 + 1) on a map's real Fourier transform, 1 at its mean; None below `LEAST_PIXELS`.

    matrix_m: (2, 2) A of `detail_footprint`.
    """
    steps = gaussian_steps(matrix_m, size, tile_m)
    if np.linalg.norm(np.reshape(steps, (2, 2)), 2) * _STEP < LEAST_PIXELS:
        return None
    return transform_of_steps(steps, size)


def gaussian_steps(matrix_m: Array, size: int, tile_m: float) -> tuple[float, ...]:
    """Return a (2, 2) matrix [m] as its elements in the steps [pixel] that Gaussians are rounded to."""
    return tuple(np.round(matrix_m * (size / tile_m) / _STEP).ravel().tolist())


@functools.lru_cache(maxsize=32)
def transform_of_steps(steps: tuple[float, ...], size: int) -> Array:
    """Return the factor (size, size/2 + 1) of a Gaussian's matrix in steps."""
    matrix = np.reshape(steps, (2, 2)) * _STEP
    if np.linalg.norm(matrix, -2) < _SAMPLED_BELOW:
        return np.asarray(np.fft.rfft2(_sampled(matrix @ matrix.T, size)).real)
    x, z = np.fft.rfftfreq(size), np.fft.fftfreq(size)[:, None]
    along = [matrix[0, i] * x + matrix[1, i] * z for i in (0, 1)]
    return np.exp(-2.0 * np.pi**2 * (along[0] ** 2 + along[1] ** 2))


def _sampled(covariance: Array, size: int) -> Array:
    """Return a Gaussian (size, size) of a covariance [pixel^2] about pixel (0, 0), sum 1, periodic."""
    reach = min(int(np.ceil(_REACH * np.sqrt(np.trace(covariance)))), (size - 1) // 2)
    at = np.arange(-reach, reach + 1)
    x, z = np.meshgrid(at, at)
    a, b, c = np.linalg.inv(covariance + 1e-4 * np.eye(2))[[0, 0, 1], [0, 1, 1]]
    kernel = np.zeros((size, size))
    kernel[np.ix_(at, at)] = np.exp(-0.5 * (a * x * x + 2.0 * b * x * z + c * z * z))
    return kernel / kernel.sum()
