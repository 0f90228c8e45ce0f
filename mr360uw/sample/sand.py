# SPDX-License-Identifier: Apache-2.0
"""Albedo of a rippled sand floor: filtered noise and bent crests."""

from __future__ import annotations

import numpy as np

from mr360uw.types import Floats

SAND_TILE_M = 6.0
"""Side [m] of the square after which the sand repeats."""
_SAND_SIZE = 512
"""Pixels across that square, 12 mm each: finer than a frame 1024 pixels wide shows on the floor."""


def sand_albedo(seed: int) -> Floats:
    """Return a periodic albedo map (512, 512, 3) of a tile of sand."""
    rng = np.random.default_rng((seed, 0x5A4D))
    frequency = np.fft.fftfreq(_SAND_SIZE, 1.0 / _SAND_SIZE)
    radius = np.hypot(frequency[:, None], frequency[None, :])

    def noise(exponent: float, cutoff: float) -> Floats:
        spectrum = np.fft.fft2(rng.normal(size=(_SAND_SIZE, _SAND_SIZE)))
        field = np.fft.ifft2(spectrum * np.exp(-((radius / cutoff) ** 2)) / np.maximum(radius, 1.0) ** exponent).real
        return (field - field.mean()) / field.std()

    across = 2.0 * np.pi * 24.0 * np.arange(_SAND_SIZE) / _SAND_SIZE
    ripples = np.sin(across[:, None] + 1.6 * noise(2.0, 40.0))
    grey = 0.34 + 0.035 * ripples + 0.03 * noise(1.0, 120.0) + 0.035 * noise(1.6, 12.0)
    return np.clip(grey, 0.03, 0.9)[..., None] * np.array([1.06, 1.0, 0.86])
