# SPDX-License-Identifier: Apache-2.0
"""Medium lookup: veil, transmittance, daylight and sun's beam from a `MediumTable`.

A pixel costs the same for any number of wavelengths in the table. Twin: lookup.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import BRIGHTEST_LOG
from mr360uw.texels import between_four
from mr360uw.types import Floats, MediumTable


def table_coordinate(length: ArrayLike, length_m: float) -> Floats:
    """Return S/(S + length_m) in [0, 1] for lengths S >= 0; 1 at infinity."""
    s = np.maximum(np.asarray(length, np.float64), 0.0)
    return 1.0 - length_m / (s + length_m)


def bilinear(table: Floats, u: ArrayLike, v: ArrayLike) -> Floats:
    """Return values (..., 3) of a table (U, V, 3) at coordinates in [0, 1], nodes at the ends."""
    rows, columns = table.shape[:2]
    u, v = np.broadcast_arrays(np.asarray(u, np.float64), np.asarray(v, np.float64))
    x, y = np.clip(u, 0.0, 1.0) * (rows - 1), np.clip(v, 0.0, 1.0) * (columns - 1)
    i, j = np.minimum(x.astype(np.int64), rows - 2), np.minimum(y.astype(np.int64), columns - 2)
    fx, fy = (x - i)[..., None], (y - j)[..., None]
    return np.asarray(between_four(table[i, j], table[i, j + 1], table[i + 1, j], table[i + 1, j + 1], fy, fx))


def linear(table: Floats, u: ArrayLike) -> Floats:
    """Return values (..., 3) of a table (U, 3) at coordinates in [0, 1], nodes at the ends."""
    x = np.clip(np.asarray(u, np.float64), 0.0, 1.0) * (len(table) - 1)
    i = np.minimum(x.astype(np.int64), len(table) - 2)
    f = (x - i)[..., None]
    return table[i] * (1.0 - f) + table[i + 1] * f


def in_water_distance(distance_m: ArrayLike, camera_depth_m: float, up: ArrayLike) -> Floats:
    """Return the length (...,) [m] of a camera ray that lies below the mean surface."""
    s, mu = np.broadcast_arrays(np.asarray(distance_m, np.float64), np.asarray(up, np.float64))
    return np.minimum(s, camera_depth_m / np.maximum(mu, 1e-9))


def veil_lookup(table: MediumTable, distance_m: ArrayLike, up: ArrayLike) -> Floats:
    """Return the radiance (..., 3) the water adds to a camera ray of length `distance_m`; `up` = y of its direction."""
    s = in_water_distance(distance_m, table.camera_depth_m, up)
    smooth = bilinear(table.veil, 0.5 + 0.5 * np.asarray(up, np.float64), table_coordinate(s, table.length_m))
    return -np.expm1(-s / table.length_m)[..., None] * smooth


def transmittance_lookup(table: MediumTable, distance_m: ArrayLike, up: ArrayLike) -> Floats:
    """Return the factor (..., 3) on the radiance of an object `distance_m` along a camera ray."""
    return np.exp(-optical_length(table, distance_m, up))


def optical_length(table: MediumTable, distance_m: ArrayLike, up: ArrayLike) -> Floats:
    """Return the negative logarithm (..., 3) of `transmittance_lookup`."""
    s = in_water_distance(distance_m, table.camera_depth_m, up)
    depth = table.camera_depth_m - np.where(np.isfinite(s), s, 0.0) * np.asarray(up, np.float64)
    attenuation = bilinear(
        table.attenuation, table_coordinate(depth, table.length_m), table_coordinate(s, table.length_m)
    )
    return attenuation * s[..., None]


def ambient_ratio(table: MediumTable, depth_m: ArrayLike, normal_up: ArrayLike = 1.0) -> Floats:
    """Return the ambient irradiance (..., 3) at a depth over that at the camera, on normals whose y is `normal_up`."""
    d = np.maximum(np.asarray(depth_m, np.float64), 0.0)
    normal = 0.5 + 0.5 * np.asarray(normal_up, np.float64)
    diffuse = bilinear(table.diffuse, normal, table_coordinate(d, table.length_m))
    return np.exp(np.minimum(-diffuse * (d - table.camera_depth_m)[..., None], BRIGHTEST_LOG))


def beam_ratio(table: MediumTable, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the sun's beam (..., 3) at a depth over that at the camera; `sun_up` = y of its direction."""
    here = path_attenuation(table, table.beam, table.camera_depth_m, sun_up)
    return np.exp(np.minimum(here - path_attenuation(table, table.beam, depth_m, sun_up), BRIGHTEST_LOG))


def beam_fraction(table: MediumTable, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the fraction (..., 3) of the sun's beam just below the surface that is left at a depth."""
    return np.exp(-path_attenuation(table, table.beam, depth_m, sun_up))


def path_attenuation(table: MediumTable, per_metre: Floats, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the optical length (..., 3) of the beam's path from the surface to a depth.

    per_metre: the table's `beam` or `unscattered`.
    """
    path = np.maximum(np.asarray(depth_m, np.float64), 0.0) / sun_up
    return linear(per_metre, table_coordinate(path, table.length_m)) * path[..., None]


def unscattered_share(table: MediumTable, depth_m: ArrayLike, sun_up: float) -> Floats:
    """Return the fraction s (..., 3) of the beam at a depth that is unscattered and so carries the caustic pattern.

    The beam of `beam_ratio` decays with c' = a + b (1 - f) [1/m]: the fraction f of the scattering is by small angles
    and leaves light in it. The caustic pattern C is carried by light that has not been scattered, which decays with
    c = a + b. After the path p = d/sun_up [m] the irradiance under waves is beam (1 + (C - 1) s), s = exp(-(c - c') p).
    Relative to all downwelling light, exp(-Kd d), the pattern has the contrast exp(-(c/sun_up - Kd) d). Light that has
    turned by small angles has a blurred pattern besides: see `small_angles`.
    """
    lost = path_attenuation(table, table.unscattered, depth_m, sun_up)
    return np.exp(np.minimum(path_attenuation(table, table.beam, depth_m, sun_up) - lost, 0.0))
