# SPDX-License-Identifier: Apache-2.0
"""A displaced surface from its height, its horizontal shift and their derivatives.

A particle at rest at (x, 0, z) moves to P = (x + shift_x, height, z + shift_z). With the strains s_ab = d shift_a/d b
and slopes h_a = d height/d a, all at the *undisplaced* (x, z), the tangents are

    T_x = (1 + s_xx, h_x, s_xz)      T_z = (s_xz, h_z, 1 + s_zz)

N = T_z x T_x normalised and J = (1 + s_xx)(1 + s_zz) - s_xz^2, both exact (Finch 2004 drops terms of the normal;
its form holds for one wave only).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.types import Surface

Array = NDArray[np.floating[Any]]

FIELD_NAMES = ("height", "shift_x", "shift_z", "slope_x", "slope_z", "strain_xx", "strain_zz", "strain_xz")


@dataclass(frozen=True, slots=True)
class SurfaceFields:
    """The eight fields of a displaced surface, each (...,): metres, or metres per metre."""

    height: Array
    shift_x: Array
    shift_z: Array
    slope_x: Array
    slope_z: Array
    strain_xx: Array
    strain_zz: Array
    strain_xz: Array


def surface_normal(
    slope_x: Array, slope_z: Array, strain_xx: Array, strain_zz: Array, strain_xz: Array, detail: ArrayLike = 0.0
) -> Array:
    """Return unit normals (..., 3). detail: (..., 2) slopes of a detail map, added to those of the surface."""
    d = np.asarray(detail, np.float64)
    detail_x, detail_z = (d, d) if d.ndim == 0 else (d[..., 0], d[..., 1])
    across_x, across_z = 1.0 + strain_xx, 1.0 + strain_zz
    y = across_x * across_z - strain_xz * strain_xz
    x = slope_z * strain_xz - across_z * slope_x - detail_x * y
    z = slope_x * strain_xz - across_x * slope_z - detail_z * y
    return _vectors(x, y, z) / np.maximum(np.sqrt(x * x + y * y + z * z), 1e-30)[..., None]


def _vectors(x: Array, y: Array, z: Array) -> Array:
    """Return vectors (..., 3) of their components."""
    out = np.empty((*np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(z)), 3))
    out[..., 0], out[..., 1], out[..., 2] = x, y, z
    return out


def surface_jacobian(strain_xx: Array, strain_zz: Array, strain_xz: Array) -> Array:
    """Return the determinant of the horizontal displacement; positive where the surface does not fold over."""
    return (1.0 + strain_xx) * (1.0 + strain_zz) - strain_xz * strain_xz


def displaced_surface(x_m: Array, z_m: Array, fields: SurfaceFields, detail: ArrayLike = 0.0) -> Surface:
    """Return the surface over undisplaced points (x, z) [m]."""
    f = fields
    return Surface(
        _vectors(x_m + f.shift_x, f.height, z_m + f.shift_z),
        surface_normal(f.slope_x, f.slope_z, f.strain_xx, f.strain_zz, f.strain_xz, detail),
        surface_jacobian(f.strain_xx, f.strain_zz, f.strain_xz),
    )
