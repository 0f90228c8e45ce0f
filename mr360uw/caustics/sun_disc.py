# SPDX-License-Identifier: Apache-2.0
"""Blur of caustics by the sun's disc, by waves that are too short to be drawn, and by light that the water turns.

The sun is a disc of angular radius r, so every ray is a narrow cone. On a plane at depth d its footprint is an ellipse,
from the derivative of Snell's law: semi-axes d r cos(theta_a)/(n cos^3(theta_w)) along the sun's azimuth and
d r/(n cos(theta_w)) across it. The map is convolved with that ellipse, evenly filled.

Waves of random slope s turn a ray's slope m by J s to first order. Below their own focus many of them send light to
every place, and what is seen is the mean over their slopes: on a plane at depth d the map is convolved with the
distribution of d J s. Slopes are Gaussian (Cox & Munk 1954) and even over all directions, of variance slope^2/2 along
each axis, so the convolution is with a Gaussian of matrix d slope/sqrt(2) J.

With L_a and L_w the directions towards the sun in air and water, u the horizontal part of L_w and n the refractive
index, the derivative of Snell's law on a flat sea is

    J = f (I + u u^T/L_wy^2)        f = 1 - L_ay/(n L_wy)

Sunlight that the water has turned by small angles has the pattern of the caustics, blurred along the path. After a path
p a `BeamSpread` is a sum of Gaussians over a plane across the beam, of standard deviations angle p. On a level plane
they are wider by 1/L_y along the sun's azimuth, L the direction towards the sun in the water. The mean of the map
stays: light that has turned is counted in the beam already, as the rest of it (see `medium.scattered_light`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.optics import refract_to_water
from mr360uw.types import BeamSpread, Floats

_LEAST_TURNED = 0.02
"""Fraction of the beam that has turned at the deepest plane below which its pattern is not computed."""
_LEAST_WEIGHT = 1e-3
"""Weight of a Gaussian below which it is left out."""


def is_soft(spread: BeamSpread | None, deepest_m: float, sun_in_water: Floats) -> bool:
    """Return whether enough light has turned at a depth for its pattern to matter."""
    return spread is not None and 1.0 - spread.unturned(deepest_m / float(sun_in_water[1])) >= _LEAST_TURNED


def gaussians(spread: BeamSpread, depth_m: float, sun_in_water: Floats, pixel_m: float) -> list[tuple[float, Floats]]:
    """Return the weights, sum 1, and (2, 2) matrices [m] over (x, z) of the Gaussians on a level plane at a depth.

    Those narrower than `_LEAST_PIXELS` pixels of a map have the matrix 0.
    """
    up = float(sun_in_water[1])
    azimuth = sun_in_water[[0, 2]] / max(float(np.hypot(*sun_in_water[[0, 2]])), 1e-12)
    across = depth_m / up * (np.eye(2) + (1.0 / up - 1.0) * np.outer(azimuth, azimuth))
    weights = spread.weights(depth_m / up)
    weights = np.where(weights >= _LEAST_WEIGHT, weights, 0.0)
    found = zip((weights / weights.sum()).tolist(), spread.angle_rad.tolist(), strict=True)
    wide, least_m = float(np.linalg.norm(across, 2)), _LEAST_PIXELS * pixel_m
    return [(weight, angle * across * (angle * wide >= least_m)) for weight, angle in found if weight > 0.0]


def soft_light(ratio: Floats, blurs: list[tuple[float, Floats]], tile_m: float) -> Floats:
    """Return a periodic map (size, size) convolved with a sum of `gaussians`, in float64; the mean stays."""
    from scipy.fft import irfft2, rfft2

    factor = soft_transform(blurs, len(ratio), tile_m)
    return np.maximum(irfft2(rfft2(ratio) * factor, s=ratio.shape), 0.0)


def soft_transform(blurs: list[tuple[float, Floats]], size: int, tile_m: float) -> Floats:
    """Return the factor (size, size/2 + 1) of a sum of `gaussians` on a map's real Fourier transform."""
    return _kept_transform(tuple((weight, tuple(matrix.ravel().tolist())) for weight, matrix in blurs), size, tile_m)


@shared(keep=32)
def _kept_transform(blurs: tuple[tuple[float, tuple[float, ...]], ...], size: int, tile_m: float) -> Floats:
    """Return the real Fourier transform (size, size/2 + 1) of a sum of `gaussians`."""
    x, z = np.fft.rfftfreq(size, tile_m / size), np.fft.fftfreq(size, tile_m / size)[:, None]
    factor = np.zeros((size, size // 2 + 1))
    for weight, (xx, xz, zx, zz) in blurs:
        factor += weight * np.exp(-2.0 * np.pi**2 * ((xx * x + zx * z) ** 2 + (xz * x + zz * z) ** 2))
    return factor


GAUSSIAN_STEP = 1.0 / 64.0
"""Gaussians' matrices are rounded to multiples of this [pixel], so that a slowly moving sun reuses their transforms."""
_LEAST_PIXELS = 0.5
"""Standard deviation [pixel] up to which maps are not blurred: that of a bilinear read of a pixel."""
_SAMPLED_BELOW = 1.0
"""Least standard deviation [pixel] of Gaussians whose Fourier transform is taken from the continuous one.

Narrower ones are sampled: the continuous transform has not faded at the map's highest frequency, and rings below zero.
"""
_REACH = 5.0
"""Half width of sampled Gaussians in standard deviations."""


def detail_footprint(sun_in_air: Floats, refractive_index: float, rms_slope: float, depth_m: float) -> Floats:
    """Return the symmetric (2, 2) matrix A [m] over (x, z) whose A A^T is the blur's covariance on the plane."""
    water = refract_to_water(sun_in_air, refractive_index)
    across = water[[0, 2]] / water[1]
    bend = 1.0 - float(sun_in_air[1]) / (refractive_index * float(water[1]))
    return depth_m * rms_slope / np.sqrt(2.0) * bend * (np.eye(2) + np.outer(across, across))


def gaussian_transform(matrix_m: Floats, size: int, tile_m: float) -> Floats | None:
    """Return the factor (size, size/2 + 1) on a map's Fourier transform, 1 at its mean; none below `_LEAST_PIXELS`.

    matrix_m: (2, 2) A of `detail_footprint`.
    """
    steps = steps_of(matrix_m, GAUSSIAN_STEP, size, tile_m)
    if np.linalg.norm(np.reshape(steps, (2, 2)), 2) * GAUSSIAN_STEP < _LEAST_PIXELS:
        return None
    return transform_of_steps(steps, size)


def steps_of(matrix_m: Floats, step: float, size: int, tile_m: float) -> tuple[float, ...]:
    """Return a (2, 2) matrix [m] as its elements in multiples of a step [pixel] of a map (size, size)."""
    return tuple(np.round(matrix_m * (size / tile_m) / step).ravel().tolist())


@shared(keep=32)
def transform_of_steps(steps: tuple[float, ...], size: int) -> Floats:
    """Return the factor (size, size/2 + 1) of a Gaussian's matrix in steps."""
    matrix = np.reshape(steps, (2, 2)) * GAUSSIAN_STEP
    if np.linalg.norm(matrix, -2) < _SAMPLED_BELOW:
        return np.asarray(np.fft.rfft2(_sampled(matrix @ matrix.T, size)).real)
    x, z = np.fft.rfftfreq(size), np.fft.fftfreq(size)[:, None]
    along = [matrix[0, i] * x + matrix[1, i] * z for i in (0, 1)]
    return np.exp(-2.0 * np.pi**2 * (along[0] ** 2 + along[1] ** 2))


def _sampled(covariance: Floats, size: int) -> Floats:
    """Return a Gaussian (size, size) of a covariance [pixel^2] about pixel (0, 0), sum 1, periodic."""
    reach = min(int(np.ceil(_REACH * np.sqrt(np.trace(covariance)))), (size - 1) // 2)
    at = np.arange(-reach, reach + 1)
    x, z = np.meshgrid(at, at)
    a, b, c = np.linalg.inv(covariance + 1e-4 * np.eye(2))[[0, 0, 1], [0, 1, 1]]
    kernel = np.zeros((size, size))
    kernel[np.ix_(at, at)] = np.exp(-0.5 * (a * x * x + 2.0 * b * x * z + c * z * z))
    return kernel / kernel.sum()


KERNEL_STEP = 1.0 / 256.0
"""Footprints are rounded to multiples of this [pixel], so that a slowly moving sun reuses kernels."""
_WIDEST_DIRECT = 11
"""Width [pixel] of a kernel up to which a direct sum is quicker than two Fourier transforms, as measured."""


def footprint(sun_in_air: Floats, refractive_index: float, half_angle_rad: float, depth_m: float) -> Floats:
    """Return the (2, 2) matrix that maps the unit disc to the sun's image on the plane, in metres over (x, z)."""
    water = refract_to_water(sun_in_air, refractive_index)
    horizontal = sun_in_air[[0, 2]]
    sine = float(np.hypot(*horizontal))
    along = horizontal / sine if sine > 0.0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    scale = depth_m * half_angle_rad / (refractive_index * water[1])
    return scale * np.stack([along * sun_in_air[1] / water[1] ** 2, across], axis=1)


def blur(image: Floats, footprint_m: Floats, tile_m: float, transform: Floats | None = None) -> Floats:
    """Return a periodic image (size, size) convolved with the disc's footprint; the mean stays.

    transform: (size, size/2 + 1) real Fourier transform of one more kernel, or None.
    """
    size = image.shape[0]
    steps = steps_of(footprint_m, KERNEL_STEP, size, tile_m)
    kernel = _kept_kernel(steps, size)
    reach = len(kernel) // 2
    if reach == 0 and transform is None:
        return image
    if transform is not None or len(kernel) > min(_WIDEST_DIRECT, size):
        from scipy.fft import irfft2, rfft2

        spectrum = rfft2(image) if transform is None else rfft2(image) * transform
        if reach:
            spectrum *= disc_transform(steps, size)
        return np.maximum(irfft2(spectrum, s=image.shape), 0.0)
    import cv2

    wide = cv2.copyMakeBorder(image, reach, reach, reach, reach, cv2.BORDER_WRAP)
    turned = np.ascontiguousarray(kernel[::-1, ::-1])  # because OpenCV correlates
    return cv2.filter2D(wide, -1, turned)[reach:-reach, reach:-reach]


@shared(keep=32)
def _kept_kernel(steps: tuple[float, ...], size: int) -> NDArray[np.float64]:
    """Return the kernel (2 r + 1, 2 r + 1) of a footprint in steps as far as it reaches about its middle."""
    kernel = disc_kernel(np.reshape(steps, (2, 2)) * KERNEL_STEP, size)
    at = (np.stack(np.nonzero(kernel)) + size // 2) % size - size // 2
    near = np.arange(-np.abs(at).max(), np.abs(at).max() + 1)
    return kernel[np.ix_(near, near)]


@shared(keep=32)
def disc_transform(steps: tuple[float, ...], size: int) -> NDArray[np.complex128]:
    """Return the real Fourier transform (size, size/2 + 1) of the kernel of a footprint in steps, 1 at the mean."""
    from scipy.fft import rfft2

    kernel = _kept_kernel(steps, size)
    reach = len(kernel) // 2
    around = np.zeros((size, size))
    around[np.ix_(*2 * (np.arange(-reach, reach + 1),))] = kernel
    transform: NDArray[np.complex128] = rfft2(around)
    return transform


def disc_kernel(footprint_pixel: Floats, size: int) -> NDArray[np.float64]:
    """Return the periodic kernel (size, size), sum 1, of the disc mapped by a (2, 2) matrix, in pixels."""
    (xa, xb), (za, zb) = footprint_pixel
    points = _disc_points(float(abs(xa * zb - xb * za))) @ footprint_pixel.T
    cell, part = _drawn_in(points)
    kernel = np.zeros((size, size))
    for dx in (0, 1):
        for dz in (0, 1):
            weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dz - part[:, 1])
            np.add.at(kernel, ((cell[:, 1] + dz) % size, (cell[:, 0] + dx) % size), weight / len(points))
    return kernel


def _disc_points(area_over_pi: float) -> NDArray[np.float64]:
    """Return (n, 2) points spread evenly over the unit disc on a sunflower's spiral (Vogel 1979)."""
    i = np.arange(int(np.clip(60.0 * area_over_pi, 2048, 500_000)))
    radius, angle = np.sqrt((i + 0.5) / len(i)), i * (np.pi * (3.0 - np.sqrt(5.0)))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _drawn_in(points: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the pixel (n, k) of each point's splat and its fractional part, with points scaled towards the middle.

    Sharing a point between the pixels around it widens the kernel by the variance part (1 - part). Points are scaled
    down until the kernel has the variance of the disc; that matters for discs of about a pixel.
    """
    wanted = float(np.mean(points**2))
    low, high = 0.0, 1.0
    for _ in range(40):
        scale = 0.5 * (low + high)
        part = scale * points - np.floor(scale * points)
        wide = float(np.mean((scale * points) ** 2 + part * (1.0 - part)))
        low, high = (scale, high) if wide < wanted else (low, scale)
    cell = np.floor(low * points)
    return cell.astype(np.int64), low * points - cell
