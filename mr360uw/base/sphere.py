# SPDX-License-Identifier: Apache-2.0
"""The equirectangular sphere: pixels, directions, solid angles, rotations.

Right-handed axes, +y up, forward = -z, right = +x. Pixel (column i, row j) of a W x H frame has

    longitude = 2 pi ((i + .5)/W - .5)        latitude = pi (.5 - (j + .5)/H)
    direction = (cos lat sin lon, sin lat, -cos lat cos lon)

so the centre of the frame looks along -z and a quarter turn to the right is +x. Continuous frame coordinates
(x, y) put pixel (i, j) at [i, i + 1) x [j, j + 1). Twin: sphere.glsl.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.parameters import common_shape, vectors
from mr360uw.errors import ParameterError

Array = NDArray[np.float64]

_PIECES = 2.7
"""Points in the innermost ring."""
_TURN = np.pi * (3.0 - np.sqrt(5.0))
"""Rotation from ring to ring, the golden angle [rad], so that pieces do not line up."""


def direction_from_frame(x: ArrayLike, y: ArrayLike, width: int, height: int) -> Array:
    """Return the unit directions (..., 3) seen at continuous frame coordinates, pixel centres at i + .5."""
    direction = np.empty((*common_shape(x=x, y=y), 3))
    longitude = 2.0 * np.pi * (np.asarray(x, np.float64) / width - 0.5)
    latitude = np.pi * (0.5 - np.asarray(y, np.float64) / height)
    # a row and a column of coordinates take as many sines, not those of every place
    cos_latitude = np.cos(latitude)
    np.multiply(cos_latitude, np.sin(longitude), out=direction[..., 0])
    direction[..., 1] = np.sin(latitude)
    np.multiply(-cos_latitude, np.cos(longitude), out=direction[..., 2])
    return direction


def frame_from_direction(direction: ArrayLike, width: int, height: int) -> tuple[Array, Array]:
    """Return continuous frame coordinates (x in [0, W], y in [0, H]) of directions (..., 3) of any length."""
    d = vectors("direction", direction).astype(np.float64, copy=False)
    longitude = np.arctan2(d[..., 0], -d[..., 2])
    latitude = np.arctan2(d[..., 1], np.hypot(d[..., 0], d[..., 2]))
    return width * (longitude / (2.0 * np.pi) + 0.5), height * (0.5 - latitude / np.pi)


def directions(width: int, height: int) -> Array:
    """Return the unit direction of every pixel centre, (H, W, 3)."""
    return direction_from_frame(np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None], width, height)


def row_solid_angle(width: int, height: int) -> Array:
    """Return the exact solid angle [sr] of one pixel of every row, (H,); W times its sum is 4 pi."""
    edge = np.sin(np.pi * (0.5 - np.arange(height + 1) / height))
    return (2.0 * np.pi / width) * (edge[:-1] - edge[1:])


def unit(vector: ArrayLike) -> Array:
    """Return vectors (..., 3) scaled to length 1; raise `ParameterError` where one is zero or not finite."""
    v = vectors("direction", vector).astype(np.float64, copy=False)
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    if not np.all(np.isfinite(length)) or not np.all(length > 0.0):
        raise ParameterError(f"direction - must be finite and not zero (got {v.tolist()!r:.80}) - give three numbers")
    return v / length


def direction_from_angles(azimuth_rad: float, elevation_rad: float) -> Array:
    """Return the unit direction (3,) at an azimuth (0 = forward, positive to the right) and elevation [rad]."""
    cos_elevation = np.cos(elevation_rad)
    return np.array([cos_elevation * np.sin(azimuth_rad), np.sin(elevation_rad), -cos_elevation * np.cos(azimuth_rad)])


def yaw_matrix(yaw_rad: float) -> Array:
    """Return the (3, 3) rotation about +y that turns forward (-z) to the right (+x) for positive angles."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def basis(axis: ArrayLike) -> Array:
    """Return (3, 3) rows (u, v, axis), orthonormal and right-handed; u is level, so a yaw rotates all three alike."""
    w = unit(axis)
    level = np.array([w[2], 0.0, -w[0]])
    length = float(np.hypot(w[0], w[2]))
    u = level / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    return np.stack([u, np.cross(w, u), w])


def disc_offsets(count: int) -> Array:
    """Return points (count, 2) of the unit disc that represent equal areas; a single one is its centre.

    The areas are pieces of rings of equal width, each point at the root mean square radius of its piece. At the
    straight edge of a shadow the error is half that of a Fermat spiral of as many points.
    """
    rings = max(round(np.sqrt(count / _PIECES)), 1)
    ends = np.round(count * (np.arange(rings + 1) / rings) ** 2).astype(np.int64)
    points = []
    for ring, (first, last) in enumerate(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)):
        radius = np.sqrt(0.5 * (first + last) / count) if last > 1 else 0.0
        angle = 2.0 * np.pi * (np.arange(last - first) + 0.5) / max(last - first, 1) + ring * _TURN
        points.append(radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return np.concatenate(points)


def disc_directions(axis: ArrayLike, half_angle_rad: float, count: int) -> Array:
    """Return directions (count, 3) over a disc of angular radius `half_angle_rad` about `axis`."""
    u, v, w = basis(axis)
    offsets = np.tan(half_angle_rad) * disc_offsets(count)
    return unit(w + offsets[:, :1] * u + offsets[:, 1:] * v)


def effective_half_angle(half_angle_rad: ArrayLike, spread_rad: ArrayLike) -> Array:
    """Return the radius (...,) [rad] of the disc with the second moment of the sun's disc and the water's spread."""
    return np.asarray(np.sqrt(np.square(half_angle_rad) + 4.0 * np.square(spread_rad)))


@functools.cache
def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Return the Gauss-Legendre nodes (count,) on (-1, 1) and their weights, shared by all callers: not to be written.

    They are eigenvalues, which take longer to find than most integrals over them.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    for values in (nodes, weights):
        values.flags.writeable = False
    return nodes, weights
