# SPDX-License-Identifier: Apache-2.0
"""The sky over the sea: radiance by direction and footprint, and the light that it sends into the water.

Standard skies are those of the CIE (CIE S 011/E:2003, ISO 15469:2004; Darula & Kittler 2002):

    L(v) = (1 + a exp(b/v_y)) (1 + c (exp(d x) - exp(d pi/2)) + e cos^2 x)

x: angle to the sun. v_y: sine of elevation.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.constants import PI
from mr360uw.base.optics import fresnel_transmittance
from mr360uw.base.parameters import numbers
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.base.texels import Vector, between, four
from mr360uw.errors import ParameterError
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.jit import exact
from mr360uw.medium.ray_field import SkyShape
from mr360uw.types import Array, Floats, Sun

Shape = tuple[float, float, float, float, float]
"""The numbers a to e of a sky."""
CLEAR: Shape = (-1.0, -0.32, 10.0, -3.0, 0.45)
"""Type 12: clear, low turbidity."""
OVERCAST: Shape = (4.0, -0.7, 0.0, -1.0, 0.0)
"""Type 1: overcast, steep."""
SKY_ROWS = 64
"""Rows of a dome, 2.8 degrees each: the skies are smooth. Twice as many change the light in the water by 1e-3."""
LOWEST_SINE = 0.02
"""Least sine of an elevation: the exponent has a pole at the horizon."""


def standard_sky(shape: Shape, sun: Floats) -> NDArray[np.float64]:
    """Return the relative radiance (SKY_ROWS, 2 SKY_ROWS) of a sky and its mirror image. sun: (3,) towards it."""
    a, b, c, d, e = shape
    view = directions(2 * SKY_ROWS, SKY_ROWS)
    view = view * np.where(view[..., 1:2] < 0.0, [1.0, -1.0, 1.0], 1.0)
    cosine = np.clip(view @ sun, -1.0, 1.0)
    gradation = 1.0 + a * np.exp(b / np.maximum(view[..., 1], LOWEST_SINE))
    indicatrix = 1.0 + c * (np.exp(d * np.arccos(cosine)) - math.exp(d * 0.5 * PI)) + e * cosine**2
    return np.asarray(gradation * indicatrix)


_RINGS, _IN_RING = (5.0, 20.0, 35.0, 50.0, 65.0, 80.0, 90.0), (16, 12, 12, 8, 6, 1)
"""Edges [deg] of elevation of the patches that the sky is divided into, from the horizon up, and patches of a ring. The
lowest 5 degrees give 0.2 % of a uniform sky's light in the water and join the lowest ring."""
_SHAPE_NODES = 17
"""Sines of elevation at which the water is told how bright the sky is."""
_BRIGHT = 10.0
"""Radiance over the sky's mean beyond which it is divided into patches: light up to there may be sought by rays at
random, as a sun's disc of 6 degrees then has 3 % of it."""


SkyPatch = tuple[Array, Array, float]
"""What is bright in a part of the sky, as a light: direction (3,) to its middle in the air, irradiance (3,) that it
brings on a level plane just below a flat surface, and radius [rad] of a disc of its solid angle."""


class Dome:
    """Radiance of the sky by direction, with maps of halved size for wide footprints."""

    def __init__(self, radiance: ArrayLike) -> None:
        """Take an equirectangular map (h, w, 3); raises `ParameterError` for other shapes and negative light."""
        map_ = numbers("dome", radiance).astype(np.float64)
        if map_.ndim != 3 or map_.shape[2] != 3 or min(map_.shape[:2]) < 2 or map_.shape[1] % 2:
            raise ParameterError(f"dome - must be (h, w, 3), w even (got shape {map_.shape}) - give a map of the sky")
        if map_.min() < 0.0:
            raise ParameterError(f"dome - radiance must not be negative (got {map_.min():g}) - clip it")
        self.radiance: Array = map_

    @functools.cached_property
    def levels(self) -> list[Array]:
        """The map and its halves, by solid angle."""
        levels = [self.radiance]
        while min(levels[-1].shape[:2]) >= 8 and levels[-1].shape[0] % 2 == 0 and levels[-1].shape[1] % 4 == 0:
            m = levels[-1]
            row = row_solid_angle(m.shape[1], m.shape[0])[:, None, None]
            rows = (m * row).reshape(m.shape[0] // 2, 2, *m.shape[1:]).sum(axis=1)
            area = row.reshape(-1, 2, 1, 1).sum(axis=1)
            levels.append(0.5 * (rows[:, 0::2] + rows[:, 1::2]) / area)
        return levels

    def look(self, direction: Array, footprint_rad: Array) -> Array:
        """Return the radiance (n, 3) of directions (n, 3), averaged over footprints (n,) [rad].

        Directions below the horizon see its mirror image, so that facets that point slightly down stay lit.
        """
        up = direction * np.array([1.0, 0.0, 1.0]) + np.abs(direction) * np.array([0.0, 1.0, 0.0])
        level = np.log2(np.maximum(footprint_rad * len(self.radiance) / PI, 1.0))
        level = np.minimum(level, len(self.levels) - 1.0)
        out = np.zeros((len(up), 3))
        for k, map_ in enumerate(self.levels):
            weight = np.maximum(1.0 - np.abs(level - k), 0.0)
            used = np.flatnonzero(weight)
            if len(used):
                out[used] += weight[used, None] * environment_lookup(map_, up[used])
        return out

    @functools.cached_property
    def irradiance(self) -> Array:
        """Irradiance (3,) on a level plane above the surface."""
        return np.asarray(np.einsum("hwc,hw->c", self._upper, self._weights))

    @functools.cached_property
    def shape(self) -> SkyShape:
        """The sky's radiance by elevation, mean over azimuths and channels."""
        edge = np.sin(np.linspace(0.0, 0.5 * PI, len(self._upper) + 1))
        ring = self._upper[::-1].mean(axis=(1, 2))
        below = np.concatenate([[0.0], np.cumsum(ring * np.diff(edge))])
        if below[-1] <= 0.0:
            return SkyShape()
        bound = np.clip((np.arange(_SHAPE_NODES + 1) - 0.5) / (_SHAPE_NODES - 1), 0.0, 1.0)
        mean = np.diff(np.interp(bound, edge, below)) / np.diff(bound) / below[-1]
        return SkyShape(tuple(np.round(mean, 4).tolist()))

    def irradiance_below(self, refractive_index: float) -> Array:
        """Return the irradiance (3,) on a level plane just below a flat surface."""
        passed = fresnel_transmittance(self._view[..., 1], refractive_index)
        return np.asarray(np.einsum("hwc,hw->c", self._upper, self._weights * passed))

    @shared(keep=4)
    def divided(self, refractive_index: float) -> tuple[Dome, list[SkyPatch]]:
        """Return the soft part of the sky, and as patches what is brighter: all of `irradiance_below` in sum."""
        most = _BRIGHT * float(self.irradiance.max()) / PI
        kept = most / np.maximum(self.radiance.max(axis=-1, keepdims=True), max(most, 1e-300))
        soft = Dome(self.radiance * kept)
        return soft, self._patches(self._upper - soft._upper, refractive_index)

    def _patches(self, bright: Array, refractive_index: float) -> list[SkyPatch]:
        """Return radiance (h/2, w, 3) above the horizon as patches."""
        weight = self._weights * fresnel_transmittance(self._view[..., 1], refractive_index)
        solid = np.broadcast_to(row_solid_angle(*self._shape)[: len(weight), None], weight.shape)
        elevation = np.degrees(np.arcsin(np.clip(self._view[..., 1], -1.0, 1.0)))
        ring = np.clip(np.searchsorted(_RINGS, elevation) - 1, 0, len(_IN_RING) - 1)
        turn = np.arctan2(self._view[..., 0], -self._view[..., 2]) / (2.0 * PI) + 0.5
        part = np.minimum((turn * np.take(_IN_RING, ring)).astype(np.int64), np.take(_IN_RING, ring) - 1)
        number = np.concatenate([[0], np.cumsum(_IN_RING)])[ring] + part
        out, lit = list[SkyPatch](), bright.max(axis=-1) > 0.0
        for k in np.unique(number[lit]):
            inside = lit & (number == k)
            light = np.einsum("nc,n->c", bright[inside], weight[inside])
            middle = np.einsum("nk,n->k", self._view[inside], weight[inside] * bright[inside].mean(axis=1))
            half = np.arccos(1.0 - min(float(solid[inside].sum()) / (2.0 * PI), 0.12))
            out.append((middle / np.linalg.norm(middle), light, float(half)))
        return out

    @property
    def _shape(self) -> tuple[int, int]:
        return self.radiance.shape[1], self.radiance.shape[0]

    @functools.cached_property
    def _view(self) -> Array:
        """Directions of the rows above the horizon."""
        return directions(*self._shape)[: self._shape[1] // 2]

    @functools.cached_property
    def _upper(self) -> Array:
        return self.radiance[: self._shape[1] // 2]

    @functools.cached_property
    def _weights(self) -> Array:
        """Solid angle times cosine (h/2, w) of those rows."""
        return row_solid_angle(*self._shape)[: self._shape[1] // 2, None] * self._view[..., 1]


def sun_below(sun: Sun | None, refractive_index: float) -> Array:
    """Return the irradiance (3,) that the sun brings on a level plane just below a flat surface."""
    if sun is None or sun.direction[1] <= 0.0:
        return np.zeros(3)
    up = float(sun.direction[1])
    return np.asarray(sun.irradiance * up * fresnel_transmittance(up, refractive_index), np.float64)


@exact
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


@exact
def panorama(t: Any, first: int, width: int, height: int, v: Vector) -> Vector:
    """Return `ibl.lookup.environment_lookup` of a map whose texels begin in row `first` of t (n, 3)."""
    longitude = math.atan2(v[0], -v[2]) / (2.0 * math.pi) + 0.5
    latitude = 0.5 - math.atan2(v[1], math.hypot(v[0], v[2])) / math.pi
    return _dome_level(t, first, width, height, longitude, latitude)


@exact
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
