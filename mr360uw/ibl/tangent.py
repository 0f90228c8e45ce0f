# SPDX-License-Identifier: Apache-2.0
"""A round look at the sphere about one direction, without seam and poles.

Lambert's azimuthal equal-area projection: position (x, y) of the patch is |(x, y)| = 2 sin(angle/2) away from its
centre, y upwards. Every pixel has the same solid angle, and what is symmetrical about the centre stays so.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.sphere import Array, unit


def tangent_frame(direction: ArrayLike) -> tuple[Array, Array, Array]:
    """Return (right, up, direction), orthonormal, for a direction (3,)."""
    d = unit(direction)
    axis = np.array([0.0, 1.0, 0.0]) if abs(d[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = unit(np.cross(d, axis))
    return right, np.cross(right, d), d


def patch_step(radius_rad: float, size: int) -> float:
    """Return the side of a pixel of a patch of `size` pixels; its square is the pixel's solid angle [sr]."""
    return 4.0 * math.sin(min(0.5 * radius_rad, 0.5)) / size


def patch_directions(direction: ArrayLike, radius_rad: float, size: int) -> Array:
    """Return the unit directions (size, size, 3) of a square patch about `direction`.

    Its inscribed circle has `radius_rad`, at most one radian, so that the corners stay on the sphere.
    """
    x = (np.arange(size) - 0.5 * (size - 1)) * patch_step(radius_rad, size)
    square = (x * x)[None, :] + (x * x)[:, None]
    right, up, forward = tangent_frame(direction)
    ratio = np.sqrt(1.0 - 0.25 * square)
    out = (1.0 - 0.5 * square)[..., None] * forward
    out += (ratio * x[None, :])[..., None] * right
    out -= (ratio * x[:, None])[..., None] * up
    return out
