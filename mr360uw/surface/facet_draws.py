# SPDX-License-Identifier: Apache-2.0
"""Waves smaller than a pixel, by the statistics of their slopes: compiled, for one ray at a time.

    symbol   meaning
    s        slope over (x, z) of a facet; its normal is (-s_x, 1, -s_z) scaled to length 1
    p(s)     Gaussian density of slopes about that of the surface that is drawn (Cox & Munk 1954)
    f(s)     -d.(-s_x, 1, -s_z), the area of a facet that a ray of direction d meets, per unit level area; its sign is
             turned for rays in the water, so that facets that a ray can meet have f > 0 on either side
    t        f in standard deviations from its mean: f = mean + spread t

A ray sees facets in proportion to p(s) max(f(s), 0), whose integral is that of Smith 1967.

Random numbers of rays are made from 32-bit keys by PCG as a hash (Jarzynski & Olano 2020).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mr360uw.base.texels import Vector
from mr360uw.jit import exact, exact_making
from mr360uw.surface.intersection import bent, mirrored, reflectance
from mr360uw.types import Array

SHARP = 0.05
"""Spread of slopes over the width of the sun's image in them below which the sun's edge is drawn."""
_LEAST = 1e-12
FARTHEST = 8.0
"""Standard deviations of slope beyond which there are no facets."""
_HALVINGS = 24
"""Bisections of that range: a slope is right to a millionth of its standard deviation."""


def facets_at(
    travel: Array, normal: Array, covariance: Array, from_below: bool, normal_numbers: Array
) -> tuple[Array, Array]:
    """Return facets that n rays meet: unit normals (n, 3), up, and f (n,) of their slopes, at least 0.

    travel: (n, 3). normal: (n, 3) of the mean slope, up. covariance: (n, 3) of slopes, xx, xz, zz. from_below: whether
    the rays run in the water. normal_numbers: (n, 2) independent ones that a facet's two slopes are made of.
    """
    c, (g, h) = covariance, normal_numbers.T
    xx = np.sqrt(np.maximum(c[:, 0], 0.0))
    zx = c[:, 1] / np.maximum(xx, _LEAST)
    zz = np.sqrt(np.maximum(c[:, 2] - zx * zx, 0.0))
    mean = -normal[:, [0, 2]] / np.maximum(normal[:, 1:2], _LEAST)
    x, z = (mean + np.stack([xx * g, zx * g + zz * h], axis=-1)).T
    facing = travel[:, 0] * x + travel[:, 2] * z - travel[:, 1]
    facet = np.stack([-x, np.ones(len(x)), -z], axis=-1)
    facet = facet / np.linalg.norm(facet, axis=-1, keepdims=True)
    return np.asarray(facet), np.maximum(-facing if from_below else facing, 0.0)


_BITS = 0xFFFFFFFF


@exact
def pcg(key: int) -> int:
    """Return the hash of a key, both in [0, 2^32)."""
    s = (key * 747796405 + 2891336453) & _BITS
    w = (((s >> ((s >> 28) + 4)) ^ s) * 277803737) & _BITS
    return (w >> 22) ^ w


@exact
def next_key(key: int, salt: int) -> int:
    """Return another key, a fixed function of this one."""
    return pcg(key ^ pcg(salt))


@exact
def uniform(key: int) -> float:
    """Return a number in (0, 1) of a key, of 24 bits."""
    return ((key >> 8) + 0.5) / 16777216.0


@exact
def _normal_cumulative(x: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))


@exact
def _normal_density(x: float) -> float:
    """Return the standard normal density."""
    return math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


@exact
def normal_quantile(p: float) -> float:
    """Return the x below which a share p of the standard normal distribution lies, 1e-11 < p < 1 - 1e-11.

    Wichura 1988, algorithm AS 241 (PPND16), without its part for smaller shares.
    """
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        upper = (((2509.0809287301226727 * r + 33430.575583588128105) * r + 67265.770927008700853) * r
                 + 45921.953931549871457) * r + 13731.693765509461125  # fmt: skip
        upper = ((upper * r + 1971.5909503065514427) * r + 133.14166789178437745) * r + 3.387132872796366608
        lower = (((5226.495278852854561 * r + 28729.085735721942674) * r + 39307.89580009271061) * r
                 + 21213.794301586595867) * r + 5394.1960214247511077  # fmt: skip
        return q * upper / (((lower * r + 687.1870074920579083) * r + 42.313330701600911252) * r + 1.0)
    r = math.sqrt(-math.log(min(p, 1.0 - p))) - 1.6
    upper = (((7.7454501427834140764e-4 * r + 0.0227238449892691845833) * r + 0.24178072517745061177) * r
             + 1.27045825245236838258) * r + 3.64784832476320460504  # fmt: skip
    upper = ((upper * r + 5.7694972214606914055) * r + 4.6303378461565452959) * r + 1.42343711074968357734
    lower = (((1.05075007164441684324e-9 * r + 5.475938084995344946e-4) * r + 0.0151986665636164571966) * r
             + 0.14810397642748007459) * r + 0.68976733498510000455  # fmt: skip
    value = upper / (((lower * r + 1.6763848301838038494) * r + 2.05319162663775882187) * r + 1.0)
    return value if q > 0.0 else -value


_NEAR = 1e-7
"""Step [standard deviations] of Newton's method after which nothing moves."""


class Facets(NamedTuple):
    """Facets that a ray meets. slope_x, slope_z: mean. xx, zx, zz: lower triangular root of the covariance of slopes.
    mean: f of the mean slope. along_x, along_z: change of f with each of the two normal numbers that make a slope.
    seen: mean of max(f, 0).
    """

    slope_x: float
    slope_z: float
    xx: float
    zx: float
    zz: float
    mean: float
    along_x: float
    along_z: float
    seen: float


@exact
def facing(dx: float, dy: float, dz: float, slope_x: float, slope_z: float, side: float) -> float:
    """Return f; side: 1 for rays in the air, -1 in the water."""
    return side * (dx * slope_x + dz * slope_z - dy)


@exact
def facets_of(travel: Vector, normal: Vector, covariance: Vector, side: float) -> Facets:
    """Return the facets about a normal, up, with a covariance of slopes xx, xz, zz."""
    dx, dy, dz = travel
    up = max(normal[1], _LEAST)
    slope_x, slope_z = -normal[0] / up, -normal[2] / up
    xx = math.sqrt(max(covariance[0], 0.0))
    zx = covariance[1] / max(xx, _LEAST)
    zz = math.sqrt(max(covariance[2] - zx * zx, 0.0))
    mean = facing(dx, dy, dz, slope_x, slope_z, side)
    along_x, along_z = side * (dx * xx + dz * zx), side * dz * zz
    seen = _seen_below(FARTHEST, mean, math.hypot(along_x, along_z))
    return Facets(slope_x, slope_z, xx, zx, zz, mean, along_x, along_z, seen)


@exact
def _seen_below(t: float, mean: float, spread: float) -> float:
    """Return the integral of max(f, 0) over the normal density up to t, at least 1e-12 of the spread."""
    s = max(spread, _LEAST)
    start = min(max(-mean / s, -FARTHEST), FARTHEST)
    end = max(min(t, FARTHEST), start)
    light = mean * (_normal_cumulative(end) - _normal_cumulative(start)) - s * (
        _normal_density(end) - _normal_density(start)
    )
    return max(light, _LEAST * s)


@exact
def _seen_deviation(share: float, mean: float, spread: float, seen: float) -> float:
    """Return the t up to which a share of the integral `seen` of max(f, 0) lies, by Newton's method within bounds."""
    s = max(spread, _LEAST)
    low, high = min(max(-mean / s, -FARTHEST), FARTHEST), FARTHEST
    # light(t) = mean (P(t) - P(low)) - s (p(t) - p(low)), P and p the normal distribution and its density
    wanted = share * seen + mean * _normal_cumulative(low) - s * _normal_density(low)
    t = normal_quantile(share)
    if mean < s:  # near the density of max(t, 0), which is Rayleigh's
        t = low + math.sqrt(-2.0 * math.log(1.0 - share)) * (0.5 if mean < 0.0 else 1.0)
    if t <= low or t >= high:
        t = 0.5 * (low + high)
    for _ in range(2 * _HALVINGS):
        density = _normal_density(t)
        off = mean * _normal_cumulative(t) - s * density - wanted
        if off < 0.0:
            low = t
        else:
            high = t
        rate = (mean + s * t) * density
        step = off / rate if rate > 0.0 else math.inf
        before = t
        t -= step
        if not low < t < high:
            t = 0.5 * (low + high)
        if abs(t - before) < _NEAR:
            break
    return t


@exact
def drawn(facets: Facets, key: int) -> Vector:
    """Return the normal of one facet, in proportion to what the ray sees; the key chooses it."""
    spread = math.hypot(facets.along_x, facets.along_z)
    along = _seen_deviation(uniform(next_key(key, 11)), facets.mean, spread, facets.seen)
    across = normal_quantile(uniform(next_key(key, 12)))
    cosine, sine = 1.0, 0.0
    if spread > _LEAST:
        cosine, sine = facets.along_x / spread, facets.along_z / spread
    g, h = cosine * along - sine * across, sine * along + cosine * across
    x, z = -facets.slope_x - facets.xx * g, -facets.slope_z - facets.zx * g - facets.zz * h
    length = math.sqrt(x * x + 1.0 + z * z)
    return x / length, 1.0 / length, z / length


# The sun, mirrored or refracted by facets of the surface: compiled, for one ray at a time.
#
# A sun of solid angle W is seen by the facets in an area A = W |ds/dw| of slopes about the one that points it at the
# ray. Where facets hardly differ, its disc is drawn. Symbols: slopes.py.

_DARK = 80.0
"""Square of the distance in standard deviations at which 1e-17 of the facets are left."""


class Disc(NamedTuple):
    """The sun in the air: its direction, cosine of its angular radius, solid angle [sr], and its radiance; the solid
    angle is 0 where there is none over the horizon.
    """

    x: float
    y: float
    z: float
    edge: float
    solid_angle: float
    red: float
    green: float
    blue: float


@exact
def sunlight(sun: Disc, travel: Vector, normal: Vector, facets: Facets, side: float, index: float) -> float:
    """Return the radiance that the facets send back along a ray, over that of the sun.

    From above (side 1) it is mirrored, from below (-1) refracted. normal: of the mean slope, up. Jacobians of half
    vectors: Walter et al. 2007 eq. 14 and 17.
    """
    dx, dy, dz = travel
    hx, hy, hz = sun.x - dx, sun.y - dy, sun.z - dz
    if side < 0.0:
        hx, hy, hz = index * dx - sun.x, index * dy - sun.y, index * dz - sun.z
    length = max(math.sqrt(hx * hx + hy * hy + hz * hz), _LEAST)
    nx, ny, nz = hx / length, hy / length, hz / length
    cosine = -side * (dx * nx + dy * ny + dz * nz)
    at_sun = sun.x * nx + sun.y * ny + sun.z * nz
    per_direction = max(at_sun, 0.0) / (length * length)
    image = max(sun.solid_angle * per_direction / max(abs(ny), 1e-3) ** 3, _LEAST)
    own = image / (4.0 * math.pi)  # variance of the sun's image in slopes, along each axis
    # the covariance and its determinant, of its root
    cxx, cxz = facets.xx * facets.xx, facets.xx * facets.zx
    czz = facets.zx * facets.zx + facets.zz * facets.zz
    if facets.xx * facets.zz < SHARP * own:
        return _disc(sun, travel, normal, side, index)
    if at_sun <= 0.0 or cosine <= 0.0 or ny <= 0.0:
        return 0.0
    slope_x, slope_z = -nx / max(ny, _LEAST), -nz / max(ny, _LEAST)
    off_x, off_z = slope_x - facets.slope_x, slope_z - facets.slope_z
    xx, xz, zz = cxx + own, cxz, czz + own
    determinant = max(xx * zz - xz * xz, 1e-300)
    square = (zz * off_x * off_x - 2.0 * xz * off_x * off_z + xx * off_z * off_z) / determinant
    if square > _DARK:
        return 0.0
    share = min(image * math.exp(-0.5 * square) / (2.0 * math.pi * math.sqrt(determinant)), 1.0)
    weight = max(facing(dx, dy, dz, slope_x, slope_z, side), 0.0) / facets.seen
    factor = reflectance(min(cosine, 1.0), index)[0]
    if side < 0.0:
        factor = (1.0 - reflectance(min(at_sun, 1.0), index)[0]) * index * index
    return share * weight * factor


@exact_making
def glitter(sun: Disc, travel: Any, normal: Any, covariance: Any, side: float, index: float) -> Any:
    """Return `sunlight` (n,) of n rays (n, 3). covariance: (n, 3) xx, xz, zz of the slopes that each meets."""
    light = np.zeros(len(travel))
    for k in range(len(travel)):
        d = travel[k, 0], travel[k, 1], travel[k, 2]
        n = normal[k, 0], normal[k, 1], normal[k, 2]
        facets = facets_of(d, n, (covariance[k, 0], covariance[k, 1], covariance[k, 2]), side)
        light[k] = sunlight(sun, d, n, facets, side, index)
    return light


@exact
def _disc(sun: Disc, travel: Vector, normal: Vector, side: float, index: float) -> float:
    """Return the radiance of the sun's disc over its own, seen by facets of the mean slope alone."""
    dx, dy, dz = travel
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    cosine = min(max(-(dx * nx + dy * ny + dz * nz), 0.0), 1.0)
    if side < 0.0:
        x, y, z = bent(dx, dy, dz, nx, ny, nz, index)
        factor = (1.0 - reflectance(cosine, 1.0 / index)[0]) * index * index
    else:
        x, y, z = mirrored(dx, dy, dz, nx, ny, nz)
        factor = reflectance(cosine, index)[0]
    return factor if x * sun.x + y * sun.y + z * sun.z >= sun.edge else 0.0


@exact
def sun_seen(sun: Disc, half_angle: float, dx: float, dy: float, dz: float, spread: float) -> float:
    """Return the radiance of the sun that a ray sees without the sea, over that of its own disc.

    Wide footprints see it wider and dimmer.
    """
    seen = max(min(spread / math.sqrt(math.pi), 1.0), half_angle)
    if dx * sun.x + dy * sun.y + dz * sun.z <= math.cos(seen):
        return 0.0
    return sun.solid_angle / (2.0 * math.pi * (1.0 - math.cos(seen)))
