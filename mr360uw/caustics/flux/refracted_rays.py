# SPDX-License-Identifier: Apache-2.0
"""Refracted sun rays below a surface, and the flux into its facets.

A ray that enters at P with the refracted direction of travel t meets the plane at depth d at P.xz + slope (P.y + d),
slope = t.xz/-t.y. It is stored as `origin` = P.xz + slope P.y, where it crosses the mean surface, and `slope`: at any
depth d the hit is origin + slope d. A facet of area vector A takes in the flux T (L.A), L towards the sun in air and T
Fresnel's transmittance; its refracted image on the plane carries that flux.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import fresnel_transmittance, refract_clamped
from mr360uw.types import Surface

Array = NDArray[np.floating[Any]]

STEEPEST_RAY = 0.05
"""Least downward component of a refracted ray's direction (3 degrees below the horizon); it keeps slopes finite.

Only facets tilted by more than 39 degrees can reach it. Twice as large, their light lands half as far.
"""


@dataclass(frozen=True, slots=True)
class Rays:
    """origin: (..., 2) over (x, z). slope: (..., 2) metres per metre of depth. transmittance: (...,)."""

    origin: Array
    slope: Array
    transmittance: Array

    def hit(self, depth_m: float) -> Array:
        """Return where the rays meet the plane at a depth, (..., 2) over (x, z)."""
        return self.origin + self.slope * depth_m


def ray_slope(normal: Array, sun_in_air: Array, refractive_index: float) -> Array:
    """Return the horizontal travel (..., 2) of refracted sunlight for each metre of depth."""
    t = refract_clamped(-sun_in_air, normal, 1.0 / refractive_index)
    return t[..., [0, 2]] / np.maximum(-t[..., 1:2], STEEPEST_RAY)


def ray_transmittance(normal: Array, sun_in_air: Array, refractive_index: float) -> Array:
    """Return the transmitted fraction of the sun's flux, 0 for surfaces turned away from it."""
    return fresnel_transmittance(normal @ sun_in_air, refractive_index)


def refracted_rays(surface: Surface, sun_in_air: Array, refractive_index: float) -> Rays:
    """Return the rays that enter at each point of a surface."""
    slope = ray_slope(surface.normal, sun_in_air, refractive_index)
    origin = surface.position[..., [0, 2]] + slope * surface.position[..., 1:2]
    return Rays(origin, slope, ray_transmittance(surface.normal, sun_in_air, refractive_index))


def facet_flux(a: Array, b: Array, c: Array, transmittance: Array, sun_in_air: Array) -> Array:
    """Return the flux (...,) into the water through triangles (..., 3), per unit irradiance across the beam.

    transmittance: of the triangle. The corners run so that (b - a) x (c - a) points up; facets turned away get nothing.
    """
    u, v = b - a, c - a
    twice = (
        sun_in_air[..., 0] * (u[..., 1] * v[..., 2] - u[..., 2] * v[..., 1])
        + sun_in_air[..., 1] * (u[..., 2] * v[..., 0] - u[..., 0] * v[..., 2])
        + sun_in_air[..., 2] * (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
    )
    return 0.5 * transmittance * np.maximum(twice, 0.0)
