# SPDX-License-Identifier: Apache-2.0
"""Fresnel's equations and refraction for one ray, compiled. Twin: optics.py, which says what the symbols are."""

from __future__ import annotations

import math
from typing import NamedTuple

from mr360uw.jit import exact

Vector = tuple[float, float, float]


class Ray(NamedTuple):
    """A ray of light. origin: [m], y over the mean surface. side: 1 in the air, -1 in the water. width, spread: of its
    footprint at its origin, and its growth per metre.
    """

    origin: Vector
    direction: Vector
    side: float
    width: float
    spread: float


@exact
def reflectance(cosine: float, m: float) -> tuple[float, float]:
    """Return `optics.fresnel` of a cosine of incidence and the cosine of refraction."""
    before = max(cosine, 1e-300)
    behind = math.sqrt(max(1.0 - (1.0 - before * before) / (m * m), 0.0))
    across, along = (before - m * behind) / (before + m * behind), (m * before - behind) / (m * before + behind)
    return 0.5 * (across * across + along * along), behind


@exact
def bent(dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, eta: float) -> Vector:
    """Return the unit direction of `optics.refract_clamped`; a normal (nx, ny, nz) against the travel (dx, dy, dz)."""
    cosine = dx * nx + dy * ny + dz * nz
    k = eta * cosine + math.sqrt(max(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0))
    x, y, z = eta * dx - k * nx, eta * dy - k * ny, eta * dz - k * nz
    length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    return x / length, y / length, z / length


@exact
def mirrored(dx: float, dy: float, dz: float, nx: float, ny: float, nz: float) -> Vector:
    """Return the direction of `optics.reflect`."""
    twice = 2.0 * (dx * nx + dy * ny + dz * nz)
    return dx - twice * nx, dy - twice * ny, dz - twice * nz
