# SPDX-License-Identifier: Apache-2.0
"""Pattern of the sunlight that the water has turned by small angles: the caustics, blurred along the path.

After a path p a `BeamSpread` is a sum of Gaussians over a plane across the beam, of standard deviations angle p. On a
level plane they are wider by 1/L_y along the sun's azimuth, L the direction towards the sun in the water. The mean of
the map stays: light that has turned is counted in the beam already, as the rest of it (see `medium.small_angles`).
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.flux.sun_disc import LEAST_PIXELS
from mr360uw.types import BeamSpread

Array = NDArray[np.floating[Any]]

_LEAST_TURNED = 0.02
"""Fraction of the beam that has turned at the deepest plane below which its pattern is not computed."""
LEAST_WEIGHT = 1e-3
"""Weight of a Gaussian below which it is left out."""


def is_soft(spread: BeamSpread | None, deepest_m: float, sun_in_water: Array) -> bool:
    """Return whether enough light has turned at a depth for its pattern to matter."""
    return spread is not None and 1.0 - spread.unturned(deepest_m / float(sun_in_water[1])) >= _LEAST_TURNED


def gaussians(spread: BeamSpread, depth_m: float, sun_in_water: Array, pixel_m: float) -> list[tuple[float, Array]]:
    """Return the weights, sum 1, and (2, 2) matrices [m] over (x, z) of the Gaussians on a level plane at a depth.

    Those narrower than `LEAST_PIXELS` pixels of a map have the matrix 0.
    """
    up = float(sun_in_water[1])
    azimuth = sun_in_water[[0, 2]] / max(float(np.hypot(*sun_in_water[[0, 2]])), 1e-12)
    across = depth_m / up * (np.eye(2) + (1.0 / up - 1.0) * np.outer(azimuth, azimuth))
    weights = spread.weights(depth_m / up)
    weights = np.where(weights >= LEAST_WEIGHT, weights, 0.0)
    found = zip((weights / weights.sum()).tolist(), spread.angle_rad.tolist(), strict=True)
    wide, least_m = float(np.linalg.norm(across, 2)), LEAST_PIXELS * pixel_m
    return [(weight, angle * across * (angle * wide >= least_m)) for weight, angle in found if weight > 0.0]


def soft_light(ratio: Array, blurs: list[tuple[float, Array]], tile_m: float) -> Array:
    """Return a periodic map (size, size) convolved with a sum of `gaussians`, in float64; the mean stays."""
    from scipy.fft import irfft2, rfft2

    factor = soft_transform(blurs, len(ratio), tile_m)
    return np.maximum(irfft2(rfft2(ratio) * factor, s=ratio.shape), 0.0)


def soft_transform(blurs: list[tuple[float, Array]], size: int, tile_m: float) -> Array:
    """Return the factor (size, size/2 + 1) of a sum of `gaussians` on a map's real Fourier transform."""
    return _kept_transform(tuple((weight, tuple(matrix.ravel().tolist())) for weight, matrix in blurs), size, tile_m)


@functools.lru_cache(maxsize=32)
def _kept_transform(blurs: tuple[tuple[float, tuple[float, ...]], ...], size: int, tile_m: float) -> Array:
    """Return the real Fourier transform (size, size/2 + 1) of a sum of `gaussians`."""
    x, z = np.fft.rfftfreq(size, tile_m / size), np.fft.fftfreq(size, tile_m / size)[:, None]
    factor = np.zeros((size, size // 2 + 1))
    for weight, (xx, xz, zx, zz) in blurs:
        factor += weight * np.exp(-2.0 * np.pi**2 * ((xx * x + zx * z) ** 2 + (xz * x + zz * z) ** 2))
    return factor
