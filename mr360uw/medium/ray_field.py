# SPDX-License-Identifier: Apache-2.0
"""Radiance along rays through water whose light is a sum of exponentials of depth, down to a floor if there is one.

In each mode the light that scatters into a direction mu falls off as exp(-k y), so the path integral of every mode is
the closed form of `closed_form.path_integral`. mu: y of the view direction, +1 straight up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.medium.closed_form import check_ray, path_modes, ray_in_water
from mr360uw.optics import fresnel_from_below

Array = NDArray[np.float64]

_CHUNK = 64
"""Rays evaluated together, so that their modes stay in the processor's cache."""
_SHARED = 8
"""Rays of one start and direction from which on they are evaluated together: their modes are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class RayField:
    """Light of n wavelengths in j modes, and its scattering into rays.

    extinction: (n,) [1/m] of the rays. rate: (n, j) [1/m]. origin_m: (j,) depth at which modes have their amounts.
    source: (n, l, j) [1/(m sr)] Legendre coefficients over mu of the light scattered into a ray, there. sky: (n,)
    radiance of the sky as it would be just below the surface without reflection. index: refractive index of the water.
    floor_m, floor: depth and radiance (n,) of a Lambert floor; infinity: none.
    """

    extinction: Array
    rate: Array
    origin_m: Array
    source: Array
    sky: Array
    index: float
    floor_m: float
    floor: Array

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) scattered into camera rays (...,), cut at the surface.

        radiance(camera) = inscatter + exp(-extinction S) radiance(end) holds exactly as far as the floor. Beyond it the
        water goes on and scatters what it does at the floor, which keeps tables smooth.
        """
        check_ray(distance_m, depth_m, up)
        s, y, mu = np.broadcast_arrays(
            ray_in_water(distance_m, depth_m, up), np.asarray(depth_m, np.float64), np.asarray(up, np.float64)
        )
        result = self._within(s, y, mu)
        deeper = np.maximum(s - self.to_floor(y, mu), 0.0)
        below = deeper > 0.0
        if np.any(below):
            lost = self.extinction * deeper[below][:, None]
            left = np.exp(-self.extinction * (s - deeper)[below][:, None])
            result[below] += left * -np.expm1(-lost) / self.extinction * self.scattered(self.floor_m, mu[below])
        return result

    def _within(self, s: Array, y: Array, mu: Array) -> Array:
        """Return the radiance (..., n) scattered into rays between surface and floor."""
        s = np.minimum(s, self.to_floor(y, mu))
        # tables ask for few directions and many distances
        directions, of_start = np.unique(mu, return_inverse=True)
        start, of_ray = np.unique(
            np.stack([of_start.ravel(), np.minimum(y, self.floor_m).ravel()]), axis=1, return_inverse=True
        )
        direction = start[0].astype(np.intp)
        source = self._source_modes(directions)
        fall = self.extinction[:, None] - self.rate * directions[:, None, None]
        distance, result = s.ravel(), np.zeros((s.size, len(self.extinction)))
        for rays, starts in _bundles(of_ray.ravel()):
            to, decay = direction[starts], self.rate * (start[1][starts, None, None] - self.origin_m)
            result[rays] = path_modes(source[to], fall[to], decay, distance[rays])
        return result.reshape(*s.shape, len(self.extinction))

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) that arrives at a depth from the directions `up`, without the sun's beam."""
        check_ray(0.0, depth_m, up)
        y, mu = np.broadcast_arrays(np.asarray(depth_m, np.float64), np.asarray(up, np.float64))
        s = np.minimum(ray_in_water(np.inf, y, mu), self.to_floor(y, mu))
        result = self._within(s, y, mu) + np.exp(-self.extinction * s[..., None]) * self.floor
        rising = mu > 0.0
        if np.any(rising):
            left = np.exp(-self.extinction * s[rising][:, None])
            result[rising] += left * (self.below_surface(mu[rising]) - self.floor)
        return result

    def scattered(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance [1/m] (..., n) that the water at a depth scatters into rays."""
        y, mu = np.broadcast_arrays(np.asarray(depth_m, np.float64), np.asarray(up, np.float64))
        modes = np.exp(-self.rate * (np.minimum(y, self.floor_m)[..., None, None] - self.origin_m))
        return np.asarray(np.sum(self._source_modes(mu) * modes, axis=-1))

    def below_surface(self, up: ArrayLike) -> Array:
        """Return the radiance (..., n) just below the surface that travels down, up >= 0: sky, and reflected light."""
        mu = np.asarray(up, np.float64)
        directions, place = np.unique(mu, return_inverse=True)
        reflectance = fresnel_from_below(directions, self.index)[:, None]
        light = self.sky * (1.0 - reflectance) + reflectance * self.radiance(0.0, -directions)
        return light[place].reshape(*mu.shape, len(self.sky))

    def to_floor(self, y: Array, mu: Array) -> Array:
        """Return the length (...,) [m] of rays down to the floor, infinite for others."""
        above = np.maximum(self.floor_m - y, 0.0)
        return np.divide(above, -mu, out=np.full(mu.shape, np.inf), where=mu < 0.0)

    def _source_modes(self, mu: Array) -> Array:
        """Return the source (..., n, j) of every mode in directions mu, where it has its amount."""
        return np.asarray(np.tensordot(legendre_polynomials(mu, self.source.shape[1]), self.source, axes=(-1, 1)))


def _bundles(start: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield the rays (r,) that are evaluated together and their starts: (1,) of many rays that share it, else (r,).

    start: (rays,) number of the start of each.
    """
    order = np.argsort(start, kind="stable")
    many = np.bincount(start)[start[order]] >= _SHARED
    ends = np.flatnonzero(np.diff(start[order][many])) + 1
    for rays in np.split(order[many], ends):
        for first in range(0, len(rays), _CHUNK):
            part = rays[first : first + _CHUNK]
            yield part, start[part[:1]]
    rest = order[~many]
    for first in range(0, len(rest), _CHUNK):
        part = rest[first : first + _CHUNK]
        yield part, start[part]


def legendre_polynomials(x: Array, count: int) -> Array:
    """Return P_0 ... (..., count) at x (...,)."""
    p = np.polynomial.legendre.legvander(np.asarray(x, np.float64), count - 1)
    return np.asarray(p, np.float64).reshape(*np.shape(x), count)


def cosine_kernel(mu: ArrayLike, normal_up: ArrayLike) -> Array:
    """Return the integral over azimuth of max(0, cos) between directions at height mu and a normal at `normal_up`."""
    mu, n = np.asarray(mu, np.float64), np.clip(np.asarray(normal_up, np.float64), -1.0, 1.0)
    along = np.asarray(mu * n)
    across = np.sqrt(np.maximum(1.0 - mu * mu, 0.0)) * np.sqrt(1.0 - n * n)
    ratio = np.divide(-along, across, out=np.array(-np.sign(along)), where=across > np.abs(along))
    half = np.arccos(np.clip(ratio, -1.0, 1.0))
    return 2.0 * (along * half + across * np.sin(half))
