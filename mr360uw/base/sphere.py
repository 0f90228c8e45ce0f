# SPDX-License-Identifier: Apache-2.0
"""The equirectangular sphere: pixels, directions, solid angles, rotations; and interpolation between texels.

Right-handed axes, +y up, forward = -z, right = +x. Pixel (column i, row j) of a W x H frame has

    longitude = 2 pi ((i + .5)/W - .5)        latitude = pi (.5 - (j + .5)/H)
    direction = (cos lat sin lon, sin lat, -cos lat cos lon)

so the centre of the frame looks along -z and a quarter turn to the right is +x. Continuous frame coordinates
(x, y) put pixel (i, j) at [i, i + 1) x [j, j + 1). Twin: sphere.glsl.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.parameters import common_shape, vectors
from mr360uw.errors import ParameterError
from mr360uw.jit import borrowing, exact, inlined

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


# --- Between texels and numbers -------------------------------------------------------------------------------------

# Interpolation of numbers and arrays: between the four texels around a place (`jit.inlined` makes these part of
# kernels), and the cubic step.


Vector = tuple[float, float, float]


def between_four(a: Any, b: Any, c: Any, d: Any, x: Any, y: Any) -> Any:
    """Return the value at a place x in [0, 1] from left to right, y down, between texels a, b above and c, d below."""
    return (a * (1.0 - x) + b * x) * (1.0 - y) + (c * (1.0 - x) + d * x) * y


def periodic_four(first: int, size: int, x: float, y: float) -> tuple[int, int, int, int, float, float]:
    """Return the numbers of the texels around (x, y), of a picture that repeats, and x and y between them.

    The rows of the picture follow each other from texel `first` on. size: its side, a power of two. Texel 0 is at 0.
    """
    column, row, last = math.floor(x), math.floor(y), size - 1
    i, j = int(column), int(row)
    above, below = first + (j & last) * size, first + ((j + 1) & last) * size
    left, right = i & last, (i + 1) & last
    return above + left, above + right, below + left, below + right, x - column, y - row


def texels_around(x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Return column and row of the texel to the upper left of places (...,), and (..., 1) how far these are from it."""
    i, j = np.floor(x), np.floor(y)
    return i.astype(np.int64), j.astype(np.int64), (x - i)[..., None], (y - j)[..., None]


def smoothstep(value: ArrayLike, zero: float, one: float) -> NDArray[Any]:
    """Return the cubic step (...,) from 0 for values on the side of `zero` to 1 on that of `one`."""
    t = np.clip((np.asarray(value) - zero) / (one - zero), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


_periodic_four = inlined(periodic_four)


def packed(pictures: Sequence[NDArray[Any]]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the texels (n, 3) of pictures (1, height, width, 1 or 3), and first texel, width and height of each."""
    table, texels, first = [], [], 0
    for picture in pictures:
        height, width = picture.shape[1:3]
        table.append((first, width, height))
        texels.append(np.broadcast_to(picture, (1, height, width, 3)).reshape(-1, 3).astype(np.float32))
        first += width * height
    return np.concatenate(texels), np.array(table, np.int64)


@exact
def add(a: Vector, b: Vector, share: float) -> Vector:
    """Return a + share b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@exact
def times(a: Vector, b: Vector) -> Vector:
    """Return the products of the parts of two vectors."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@borrowing
def four(t: Any, a: int, b: int, c: int, d: int, fx: float, fy: float) -> Vector:
    """Return the value between four texels of t (n, 3): a, b above, c, d below."""
    wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        wa * t[a, 0] + wb * t[b, 0] + wc * t[c, 0] + wd * t[d, 0],
        wa * t[a, 1] + wb * t[b, 1] + wc * t[c, 1] + wd * t[d, 1],
        wa * t[a, 2] + wb * t[b, 2] + wc * t[c, 2] + wd * t[d, 2],
    )


@borrowing
def periodic(t: Any, n: Any, first: int, levels: int, u: float, v: float, level: float) -> Vector:
    """Return the value of a picture with its halves at tile coordinates (`caustic_lookup.periodic_trilinear`).

    t: (n, 3) texels of all pictures. n: (k, 3) first texel, width and height of every level of all; those of this one
    are `levels` from row `first` on, squares whose sides are powers of two. level: fractional.
    """
    lower = min(int(level), levels - 1)
    share = level - lower
    value = _periodic_level(t, n[first + lower, 0], n[first + lower, 1], u, v)
    if share <= 0.0 or lower + 1 >= levels:
        return value
    return between(value, _periodic_level(t, n[first + lower + 1, 0], n[first + lower + 1, 1], u, v), share)


@exact
def between(a: Vector, b: Vector, share: float) -> Vector:
    """Return (1 - share) a + share b."""
    rest = 1.0 - share
    return rest * a[0] + share * b[0], rest * a[1] + share * b[1], rest * a[2] + share * b[2]


@borrowing
def _periodic_level(t: Any, first: int, size: int, u: float, v: float) -> Vector:
    a, b, c, d, fx, fy = _periodic_four(first, size, u * size - 0.5, v * size - 0.5)
    return four(t, a, b, c, d, fx, fy)


@exact
def level_for(footprint: float, pixel: float, last: int) -> float:
    """Return the level for a footprint and a pixel [m] (`caustic_lookup.mip_level`)."""
    wanted = footprint / (math.sqrt(3.0) * pixel)
    return min(math.log2(wanted), float(last)) if wanted > 1.0 else 0.0
