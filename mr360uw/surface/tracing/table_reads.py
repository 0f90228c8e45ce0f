# SPDX-License-Identifier: Apache-2.0
"""Reads of tables and maps for one ray, compiled: mip maps that repeat, the dome, the water's tables.

Twins: caustic_lookup.py, ibl/lookup.py and medium/lookup.py, which say what they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import borrowing, exact, inlined
from mr360uw.texels import between_four, periodic_four

_between_four = inlined(between_four)
_periodic_four = inlined(periodic_four)


class WaterTable(NamedTuple):
    """Where the tables of a light lie in the water's arrays, and the scales of a `MediumTable`: the light's length and
    the depth at which its rays start.
    """

    at: int
    length_m: float
    depth_m: float


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


@borrowing
def sky_radiance(t: Any, n: Any, dx: float, dy: float, dz: float, footprint: float) -> Vector:
    """Return the radiance of the sky over a footprint [rad]; directions below the horizon see its mirror image.

    t: (n, 3) texels of the dome; n: (L, 3) first texel, width and height of every level.
    """
    last = len(n) - 1
    wanted = footprint * n[0, 2] / math.pi
    level = min(math.log2(wanted), float(last)) if wanted > 1.0 else 0.0
    lower = int(level)
    share = level - lower
    longitude = math.atan2(dx, -dz) / (2.0 * math.pi) + 0.5
    latitude = 0.5 - math.atan2(abs(dy), math.hypot(dx, dz)) / math.pi
    value = _dome_level(t, n[lower, 0], n[lower, 1], n[lower, 2], longitude, latitude)
    if share <= 0.0:
        return value
    lower += 1
    return between(value, _dome_level(t, n[lower, 0], n[lower, 1], n[lower, 2], longitude, latitude), share)


@borrowing
def panorama(t: Any, first: int, width: int, height: int, v: Vector) -> Vector:
    """Return `ibl.lookup.environment_lookup` of a map whose texels begin in row `first` of t (n, 3)."""
    longitude = math.atan2(v[0], -v[2]) / (2.0 * math.pi) + 0.5
    latitude = 0.5 - math.atan2(v[1], math.hypot(v[0], v[2])) / math.pi
    return _dome_level(t, first, width, height, longitude, latitude)


@borrowing
def _dome_level(t: Any, first: int, width: int, height: int, longitude: float, latitude: float) -> Vector:
    x, y = longitude * width - 0.5, latitude * height - 0.5
    column, row = math.floor(x), math.floor(y)
    i, j = int(column), int(row)
    above, below = first + max(j, 0) * width, first + min(j + 1, height - 1) * width
    # a row beyond a pole is the row before it, half a turn away
    over, under = width // 2 if j < 0 else 0, width // 2 if j + 1 >= height else 0
    return four(
        t, above + (i + over) % width, above + (i + 1 + over) % width, below + (i + under) % width,
        below + (i + 1 + under) % width, x - column, y - row,
    )  # fmt: skip


@borrowing
def _bilinear(table: Any, at: int, u: float, v: float) -> Vector:
    """Return the value of table `at` of (n, U, V, 3) at coordinates in [0, 1] (`medium.lookup.bilinear`)."""
    x, y = min(max(u, 0.0), 1.0) * (table.shape[1] - 1), min(max(v, 0.0), 1.0) * (table.shape[2] - 1)
    i, j = min(int(x), table.shape[1] - 2), min(int(y), table.shape[2] - 2)
    return _channel(table, at, i, j, x, y, 0), _channel(table, at, i, j, x, y, 1), _channel(table, at, i, j, x, y, 2)


@inlined
def _channel(t: Any, at: int, i: int, j: int, x: float, y: float, k: int) -> Any:
    return _between_four(t[at, i, j, k], t[at, i, j + 1, k], t[at, i + 1, j, k], t[at, i + 1, j + 1, k], y - j, x - i)


@borrowing
def veil(veils: Any, table: WaterTable, distance: float, up: float) -> Vector:
    """Return `medium.lookup.veil_lookup` of a ray that may be infinite."""
    s = min(distance, table.depth_m / max(up, 1e-9))
    smooth = _bilinear(veils, table.at, 0.5 + 0.5 * up, 1.0 - table.length_m / (s + table.length_m))
    filled = -math.expm1(-s / table.length_m)
    return filled * smooth[0], filled * smooth[1], filled * smooth[2]


@borrowing
def transmittance(attenuations: Any, table: WaterTable, distance: float, up: float) -> Vector:
    """Return `medium.lookup.transmittance_lookup` of a finite ray."""
    s = min(distance, table.depth_m / max(up, 1e-9))
    depth = max(table.depth_m - s * up, 0.0)
    length = table.length_m
    a = _bilinear(attenuations, table.at, 1.0 - length / (depth + length), 1.0 - length / (s + length))
    return math.exp(-a[0] * s), math.exp(-a[1] * s), math.exp(-a[2] * s)


# Fresnel's equations and refraction for one ray, compiled. Twin: optics.py, which says what the symbols are.

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
