# SPDX-License-Identifier: Apache-2.0
"""Equal-area patches of the sphere about one direction (Lambert's azimuthal projection), without seam and poles.

A direction at an angle from the centre lies 2 sin(angle/2) from it on the patch, y upwards. Every pixel has the same
solid angle, and discs about the centre stay round.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.sphere import Array, unit


def tangent_frame(direction: ArrayLike) -> tuple[Array, Array, Array]:
    """Return (right, up, direction), orthonormal, for a direction (3,)."""
    d = unit(direction)
    x, y, z = map(float, d)
    low = abs(y) < 0.9  # away from the poles +y is the other axis, near them +z
    size = math.hypot(x, z if low else y)
    a, b, c = (-z / size, 0.0, x / size) if low else (y / size, -x / size, 0.0)
    return np.array([a, b, c]), np.array([b * z - c * y, c * x - a * z, a * y - b * x]), d


def patch_step(radius_rad: float, size: int) -> float:
    """Return the side of a pixel of a patch of `size` pixels; its square is the pixel's solid angle [sr]."""
    return 4.0 * math.sin(min(0.5 * radius_rad, 0.5)) / size


def patch_directions(direction: ArrayLike, radius_rad: float, size: int) -> Array:
    """Return the unit directions (size, size, 3) of a square patch about `direction`.

    Its inscribed circle has `radius_rad`, at most one radian, so that the corners stay on the sphere.
    """
    x = (np.arange(size) - 0.5 * (size - 1)) * patch_step(radius_rad, size)
    square = (x * x)[None, :] + (x * x)[:, None]
    ratio = np.sqrt(1.0 - 0.25 * square)
    place = np.empty((size, size, 3))
    np.multiply(ratio, x[None, :], out=place[..., 0])
    np.multiply(ratio, -x[:, None], out=place[..., 1])
    np.subtract(1.0, 0.5 * square, out=place[..., 2])
    out: Array = place @ np.stack(tangent_frame(direction))
    return out
