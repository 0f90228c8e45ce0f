# SPDX-License-Identifier: Apache-2.0
"""What keeps light off: the sun behind a body, and bodies in the ambient light.

The sun's visibility is the mean over directions that fill its disc, on a Fermat spiral (Vogel 1979). Water widens the
disc by forward scattering; a Gaussian spread of standard deviation sigma is taken as a disc of the same second moment,
radius^2 = half_angle^2 + 4 sigma^2.

The ambient light that a body keeps off a place is the sum of the form factors of its surfels (Bunnell 2005),

    F = sum A |n.w| max(0, N.w) / (pi r^2 + A)

with w towards the surfel, A n its area vector. Twin: shadow.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.sphere import unit
from mr360uw.types import Floats

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def effective_half_angle(half_angle_rad: float, spread_rad: float) -> float:
    """Return the angular radius of the disc that has the second moment of the sun's and the water's spread."""
    return float(np.sqrt(half_angle_rad**2 + 4.0 * spread_rad**2))


def basis(axis: ArrayLike) -> Floats:
    """Return (3, 3) rows (u, v, axis), orthonormal and right-handed; u is level, so that all turn with a yaw."""
    w = unit(axis)
    level = np.array([w[2], 0.0, -w[0]])
    length = float(np.hypot(w[0], w[2]))
    u = level / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    return np.stack([u, np.cross(w, u), w])


def disc_offsets(count: int) -> Floats:
    """Return points (count, 2) that fill the unit disc evenly; a single one is its centre."""
    k = np.arange(count)
    radius = np.sqrt((k + 0.5) / count) if count > 1 else np.zeros(1)
    return radius[:, None] * np.stack([np.cos(k * _GOLDEN_ANGLE), np.sin(k * _GOLDEN_ANGLE)], axis=-1)


def disc_directions(axis: ArrayLike, half_angle_rad: float, count: int) -> Floats:
    """Return directions (count, 3) over a disc of angular radius `half_angle_rad` about `axis`."""
    u, v, w = basis(axis)
    offsets = np.tan(half_angle_rad) * disc_offsets(count)
    return unit(w + offsets[:, :1] * u + offsets[:, 1:] * v)


def ambient_blocked(point: Floats, normal: Floats, surfel_position: Floats, surfel_area: Floats) -> Floats:
    """Return the part (...,) of the ambient irradiance on (point, normal), each (..., 3), that surfels block.

    Not clipped to 1, because several bodies add up. surfel_position, surfel_area: (s, 3); the area vectors' lengths are
    areas in m^2.
    """
    total = np.zeros(point.shape[:-1])
    for place, vector in zip(surfel_position, surfel_area, strict=True):
        towards = place - point
        squared = np.maximum(np.sum(towards * towards, -1), 1e-12)
        facing = np.abs(towards @ vector) * np.maximum(np.sum(towards * normal, -1), 0.0)
        total += facing / (squared * (np.pi * squared + np.linalg.norm(vector)))
    return total
