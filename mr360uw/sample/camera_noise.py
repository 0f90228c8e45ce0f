# SPDX-License-Identifier: Apache-2.0
"""Noise of a camera's sensor: that of counted photons and of reading them out, on linear light before its curve."""

from __future__ import annotations

import numpy as np

from mr360uw.types import Floats

_FULL_WELL = 6000.0
"""Electrons of a pixel that is white, of a small camera in good light. Half as many: noise is 1.4 times as strong."""
_READ = 3.0
"""Standard deviation of reading a pixel out, in electrons."""


def with_noise(image: Floats, strength: float, seed: int, index: int) -> Floats:
    """Return a linear image (H, W, 3) as a sensor counts it; `strength` is a factor on the variance.

    The variance of a value v is (v/N + (r/N)^2) strength: N electrons are white, r those of reading out. Normal
    deviates stand for counts. Seed and index decide them.
    """
    if strength <= 0.0:
        return image
    rng = np.random.default_rng((seed, index, 0x4E01))
    variance = strength * (np.maximum(image, 0.0) / _FULL_WELL + (_READ / _FULL_WELL) ** 2)
    return np.asarray(image + np.sqrt(variance, dtype=np.float32) * rng.standard_normal(image.shape, np.float32))
