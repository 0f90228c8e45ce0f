# SPDX-License-Identifier: Apache-2.0
"""Synthetic panoramas in linear light, 256 x 128."""

from __future__ import annotations

import numpy as np

from mr360uw.base.sphere import directions
from mr360uw.types import Floats

SIZE = (128, 256)


def water(color: tuple[float, float, float]) -> Floats:
    """Return open water of a colour at the horizon, lighter above and darker below."""
    y = directions(SIZE[1], SIZE[0])[..., 1:2]
    return (np.exp(1.2 * y) * np.array(color)).astype(np.float32)


def air(
    sky: tuple[float, float, float] = (0.1, 0.25, 0.6), ground: tuple[float, float, float] = (0.3, 0.22, 0.12)
) -> Floats:
    """Return a blue sky, whiter at the horizon, over rough ground."""
    y = directions(SIZE[1], SIZE[0])[..., 1:2]
    white = np.exp(-6.0 * np.abs(y)) * 0.5
    rough = np.random.default_rng(1).uniform(0.5, 1.5, (*SIZE, 1))
    return np.where(y > 0.0, white + (1.0 - white) * np.array(sky), rough * np.array(ground)).astype(np.float32)
