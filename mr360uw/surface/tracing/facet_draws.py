# SPDX-License-Identifier: Apache-2.0
"""Waves smaller than a pixel, by the statistics of their slopes: compiled, for one ray at a time.

    symbol   meaning
    s        slope over (x, z) of a facet; its normal is (-s_x, 1, -s_z) scaled to length 1
    p(s)     Gaussian density of slopes about that of the surface that is drawn (Cox & Munk 1954)
    f(s)     -d.(-s_x, 1, -s_z), the area of a facet that a ray of direction d meets, per unit level area; its sign is
             turned for rays in the water, so that facets that a ray can meet have f > 0 on either side
    t        f in standard deviations from its mean: f = mean + spread t

A ray sees facets in proportion to p(s) max(f(s), 0), whose integral is that of Smith 1967.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from mr360uw.jit import exact
from mr360uw.surface.slopes import FARTHEST, HALVINGS, LEAST
from mr360uw.surface.tracing.random_keys import next_key, normal_cumulative, normal_density, normal_quantile, uniform
from mr360uw.surface.tracing.ray_optics import Vector

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
    up = max(normal[1], LEAST)
    slope_x, slope_z = -normal[0] / up, -normal[2] / up
    xx = math.sqrt(max(covariance[0], 0.0))
    zx = covariance[1] / max(xx, LEAST)
    zz = math.sqrt(max(covariance[2] - zx * zx, 0.0))
    mean = facing(dx, dy, dz, slope_x, slope_z, side)
    along_x, along_z = side * (dx * xx + dz * zx), side * dz * zz
    seen = seen_below(FARTHEST, mean, math.hypot(along_x, along_z))
    return Facets(slope_x, slope_z, xx, zx, zz, mean, along_x, along_z, seen)


@exact
def seen_below(t: float, mean: float, spread: float) -> float:
    """Return the integral of max(f, 0) over the normal density up to t, at least 1e-12 of the spread."""
    s = max(spread, LEAST)
    start = min(max(-mean / s, -FARTHEST), FARTHEST)
    end = max(min(t, FARTHEST), start)
    light = mean * (normal_cumulative(end) - normal_cumulative(start)) - s * (
        normal_density(end) - normal_density(start)
    )
    return max(light, LEAST * s)


@exact
def seen_deviation(share: float, mean: float, spread: float, seen: float) -> float:
    """Return the t up to which a share of the integral `seen` of max(f, 0) lies, by Newton's method within bounds."""
    s = max(spread, LEAST)
    low, high = min(max(-mean / s, -FARTHEST), FARTHEST), FARTHEST
    # light(t) = mean (P(t) - P(low)) - s (p(t) - p(low)), P and p the normal distribution and its density
    wanted = share * seen + mean * normal_cumulative(low) - s * normal_density(low)
    t = normal_quantile(share)
    if mean < s:  # near the density of max(t, 0), which is Rayleigh's
        t = low + math.sqrt(-2.0 * math.log(1.0 - share)) * (0.5 if mean < 0.0 else 1.0)
    if t <= low or t >= high:
        t = 0.5 * (low + high)
    for _ in range(2 * HALVINGS):
        density = normal_density(t)
        off = mean * normal_cumulative(t) - s * density - wanted
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
    along = seen_deviation(uniform(next_key(key, 11)), facets.mean, spread, facets.seen)
    across = normal_quantile(uniform(next_key(key, 12)))
    cosine, sine = 1.0, 0.0
    if spread > LEAST:
        cosine, sine = facets.along_x / spread, facets.along_z / spread
    g, h = cosine * along - sine * across, sine * along + cosine * across
    x, z = -facets.slope_x - facets.xx * g, -facets.slope_z - facets.zx * g - facets.zz * h
    length = math.sqrt(x * x + 1.0 + z * z)
    return x / length, 1.0 / length, z / length
