# SPDX-License-Identifier: Apache-2.0
"""A round look at the sphere about one direction, without seam and poles.

Azimuthal equidistant: position (x, y) [rad] of the patch lies |(x, y)| away from its centre, y upwards where there is
an up. Great circles through the centre are straight, so that anything symmetrical about it stays so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.sphere import Array, unit


def tangent_frame(direction: ArrayLike) -> tuple[Array, Array, Array]:
    """Return (right, up, direction), orthonormal, for a unit direction (3,)."""
    d = unit(direction)
    axis = np.array([0.0, 1.0, 0.0]) if abs(d[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = unit(np.cross(d, axis))
    return right, np.cross(right, d), d


def patch_directions(direction: ArrayLike, radius_rad: float, size: int) -> Array:
    """Return the unit directions (size, size, 3) of a square patch whose inscribed circle has `radius_rad`."""
    step = 2.0 * radius_rad / size
    x = (np.arange(size) + 0.5) * step - radius_rad
    return patch_point(direction, x[None, :], -x[:, None])


def patch_point(direction: ArrayLike, x: ArrayLike, y: ArrayLike) -> Array:
    """Return the unit directions (..., 3) at patch positions [rad] about `direction`."""
    right, up, forward = tangent_frame(direction)
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    angle = np.hypot(x, y)
    ratio = np.sinc(angle / np.pi)
    return ratio[..., None] * (x[..., None] * right + y[..., None] * up) + np.cos(angle)[..., None] * forward


def patch_solid_angle(radius_rad: float, size: int) -> Array:
    """Return the solid angle [sr] of every pixel of `patch_directions`, (size, size)."""
    step = 2.0 * radius_rad / size
    x = (np.arange(size) + 0.5) * step - radius_rad
    return step * step * np.sinc(np.hypot(x[None, :], x[:, None]) / np.pi)
