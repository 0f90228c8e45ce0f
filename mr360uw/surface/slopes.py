# SPDX-License-Identifier: Apache-2.0
"""Waves smaller than a pixel, by the statistics of their slopes.

    symbol   meaning
    s        slope over (x, z) of a facet; its normal is (-s_x, 1, -s_z) scaled to length 1
    p(s)     Gaussian density of slopes about that of the surface that is drawn (Cox & Munk 1954)
    f(s)     -d.(-s_x, 1, -s_z), the area of a facet that a ray of direction d meets, per unit level area

A ray sees facets in proportion to p(s) max(f(s), 0), whose integral is that of Smith 1967. A sun of solid angle W is
seen by the facets in an area A = W |ds/dw| of slopes about the one that points it at the ray.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from mr360uw.constants import PI
from mr360uw.optics import fresnel, radiance_factor, reflect, refract_clamped
from mr360uw.types import Sun

Array = NDArray[np.float64]
Keys = NDArray[np.uint32]

SHARP = 0.05
"""Spread of slopes over the width of the sun's image in them below which the sun's edge is drawn."""
LEAST = 1e-12
FARTHEST = 8.0
"""Standard deviations of slope beyond which there are no facets."""
HALVINGS = 24
"""Bisections of that range: a slope is right to a millionth of its standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class FacetsOfRays:
    """Facets that n rays meet. travel, normal: (n, 3), the normal up; covariance: (n, 3) of slopes, xx, xz, zz.
    from_below: whether the rays run in the water.
    """

    travel: Array
    normal: Array
    covariance: Array
    from_below: bool

    @property
    def slope(self) -> Array:
        """Mean slopes (n, 2)."""
        return -self.normal[:, [0, 2]] / np.maximum(self.normal[:, 1:2], LEAST)

    def facing(self, slope: Array) -> Array:
        """Return f (n,) of slopes (n, 2), positive on the side that the ray comes from."""
        d = self.travel
        turned = d[:, 0] * slope[:, 0] + d[:, 2] * slope[:, 1] - d[:, 1]
        return -turned if self.from_below else turned

    def mean_facing(self) -> Array:
        """Return the mean (n,) of max(f, 0) over the slopes (Smith 1967)."""
        mean, (across, along) = self.facing(self.slope), self._spread()
        return np.asarray(facing_below(np.inf, mean, np.hypot(across, along)))

    def drawn(self, keys: Keys) -> Array:
        """Return the normal (n, 3) of one facet for each ray, in proportion to what the ray sees; `keys` (n,) choose
        it.
        """
        first, second = uniform_pair(keys)
        mean, (a, b) = self.facing(self.slope), self._spread()
        spread = np.hypot(a, b)
        along = seen_deviation(first, mean, spread)
        across = ndtri(second)
        turned = spread > LEAST
        cosine = np.where(turned, a / np.maximum(spread, LEAST), 1.0)
        sine = np.where(turned, b / np.maximum(spread, LEAST), 0.0)
        turned_back = np.stack([cosine * along - sine * across, sine * along + cosine * across], axis=-1)
        return normal_of(self.at(turned_back))

    def at(self, normal_numbers: Array) -> Array:
        """Return the slopes (n, 2) that two independent normal numbers (n, 2) stand for."""
        g, h = normal_numbers.T
        xx, zx, zz = self._root
        return np.asarray(self.slope + np.stack([xx * g, zx * g + zz * h], axis=-1))

    @property
    def _root(self) -> tuple[Array, Array, Array]:
        """Lower triangular root (xx, zx, zz), each (n,), of the covariance."""
        c = self.covariance
        xx = np.sqrt(np.maximum(c[:, 0], 0.0))
        zx = c[:, 1] / np.maximum(xx, LEAST)
        return xx, zx, np.sqrt(np.maximum(c[:, 2] - zx * zx, 0.0))

    def _spread(self) -> tuple[Array, Array]:
        """Return the change (n,) of f with each of two independent normal numbers that make a slope."""
        xx, zx, zz = self._root
        side = -1.0 if self.from_below else 1.0
        return side * (self.travel[:, 0] * xx + self.travel[:, 2] * zx), side * self.travel[:, 2] * zz

    def sunlight(self, sun: Sun, refractive_index: float) -> Array:
        """Return the radiance (n, 3) of the sun that the facets send back along the rays.

        From above it is mirrored, from below refracted. sun: as seen in the air.
        """
        solid_angle = 2.0 * PI * (1.0 - np.cos(sun.half_angle_rad))
        normal, cosine, image, factor = self._towards(sun, solid_angle, refractive_index)
        slope = -normal[:, [0, 2]] / np.maximum(normal[:, 1:2], LEAST)
        seen = (cosine > 0.0) & (normal[:, 1] > 0.0)
        off = slope - self.slope
        c = self.covariance
        own = image / (4.0 * PI)  # variance of the sun's image in slopes, along each axis
        sharp = np.sqrt(np.maximum(c[:, 0] * c[:, 2] - c[:, 1] ** 2, 0.0)) < SHARP * own
        xx, xz, zz = c[:, 0] + own, c[:, 1], c[:, 2] + own
        determinant = np.maximum(xx * zz - xz * xz, 1e-300)
        square = (zz * off[:, 0] ** 2 - 2.0 * xz * off[:, 0] * off[:, 1] + xx * off[:, 1] ** 2) / determinant
        share = image * np.exp(-0.5 * square) / (2.0 * PI * np.sqrt(determinant))
        weight = np.maximum(self.facing(slope), 0.0) / self.mean_facing()
        light = np.where(seen, np.minimum(share, 1.0) * weight * factor, 0.0)
        light = np.where(sharp, self._disc(sun, refractive_index), light)
        return np.asarray(light[:, None] * (sun.irradiance / solid_angle))

    def _disc(self, sun: Sun, n: float) -> Array:
        """Return the radiance (n,) of the sun's disc over its own, seen by facets of the mean slope alone."""
        against = -self.normal if self.from_below else self.normal
        cosine = np.clip(-np.sum(self.travel * against, axis=-1), 0.0, 1.0)
        if self.from_below:
            out = refract_clamped(self.travel, against, n)
            factor = (1.0 - fresnel(cosine, 1.0 / n)) * n * n
        else:
            out, factor = reflect(self.travel, against), fresnel(cosine, n)
        return np.where(out @ sun.direction >= np.cos(sun.half_angle_rad), factor, 0.0)

    def _towards(self, sun: Sun, solid_angle: float, n: float) -> tuple[Array, Array, Array, Array]:
        """Return the normal (n, 3) of the facets that point the sun at the rays, the cosine (n,) at which rays meet
        them, the sun's area (n,) in slopes, and radiance towards the camera over that of the sun.

        Jacobians of half vectors: Walter et al. 2007 eq. 14 and 17.
        """
        d, to_sun = self.travel, np.broadcast_to(sun.direction, self.travel.shape)
        half = n * d - to_sun if self.from_below else to_sun - d
        length = np.linalg.norm(half, axis=-1)
        normal = half / np.maximum(length, LEAST)[:, None]
        cosine = np.sum(d * normal, axis=-1) * (1.0 if self.from_below else -1.0)
        at_sun = np.sum(to_sun * normal, axis=-1)
        per_direction = np.maximum(at_sun, 0.0) / np.maximum(length, LEAST) ** 2
        image = solid_angle * per_direction / np.maximum(np.abs(normal[:, 1]), 1e-3) ** 3
        at = np.clip(cosine, 0.0, 1.0)
        factor = radiance_factor(np.clip(at_sun, 0.0, 1.0), n) if self.from_below else fresnel(at, n)
        return normal, cosine, np.maximum(image, LEAST), np.where(at_sun > 0.0, factor, 0.0)


def facing_below(x: Array | float, mean: Array, spread: Array) -> Array:
    """Return the integral (n,) of max(mean + spread t, 0) over the normal density of t, up to t = x."""
    s = np.maximum(spread, LEAST)
    start = np.clip(-mean / s, -FARTHEST, FARTHEST)
    end = np.maximum(np.minimum(x, FARTHEST), start)
    light = mean * (ndtr(end) - ndtr(start)) - s * (_normal(end) - _normal(start))
    return np.asarray(np.maximum(light, LEAST * s))


def seen_deviation(share: Array, mean: Array, spread: Array) -> Array:
    """Return the t (n,) up to which a share (n,) of that integral lies, by bisection."""
    low = np.clip(-mean / np.maximum(spread, LEAST), -FARTHEST, FARTHEST)
    high = np.full(len(low), FARTHEST)
    wanted = share * facing_below(np.inf, mean, spread)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        less = facing_below(middle, mean, spread) < wanted
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return np.asarray(0.5 * (low + high))


def _normal(x: Array) -> Array:
    return np.asarray(np.exp(-0.5 * x * x) / np.sqrt(2.0 * PI))


def normal_of(slope: Array) -> Array:
    """Return unit normals (n, 3) up of slopes (n, 2)."""
    normal = np.stack([-slope[:, 0], np.ones(len(slope)), -slope[:, 1]], axis=-1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def next_keys(keys: Keys, salt: int) -> Keys:
    """Return other keys (n,), a fixed function of these (PCG as a hash, Jarzynski & Olano 2020)."""
    return _pcg(keys ^ _pcg(np.full(1, salt, np.uint32)))


def _pcg(keys: Keys) -> Keys:
    with np.errstate(over="ignore"):
        s = keys * np.uint32(747796405) + np.uint32(2891336453)
        w = ((s >> ((s >> np.uint32(28)) + np.uint32(4))) ^ s) * np.uint32(277803737)
    return np.asarray((w >> np.uint32(22)) ^ w)


def uniform_pair(keys: Keys) -> tuple[Array, Array]:
    """Return two numbers (n,) in (0, 1) of each key."""
    first, second = (next_keys(keys, salt) for salt in (11, 12))
    return uniform(first), uniform(second)


def uniform(keys: Keys) -> Array:
    """Return a number (n,) in (0, 1) of each key, of 24 bits."""
    return (np.right_shift(keys, np.uint32(8)).astype(np.float64) + 0.5) / 2.0**24
