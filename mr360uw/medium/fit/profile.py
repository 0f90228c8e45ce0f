# SPDX-License-Identifier: Apache-2.0
"""Colour of the open water in a plate as a profile over elevation, robust against animals, divers and rocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import PI
from mr360uw.errors import ParameterError
from mr360uw.shapes import numbers, real
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

Array = NDArray[np.float64]

_TINY = 1e-30
_OPEN, _CLOSED = 0.3, 0.7
"""Ranks in red, 0 for least, between which the weight of an azimuth falls from 1 (open water) to 0 (bodies, rocks)."""
_MIDDLE = 0.3
"""Fraction of the values about the median that is averaged: 35 % on either side may be outliers."""
LEVEL_RAD = np.radians(12.0)
"""Elevation [rad] up to which rows show water rather than surface or ground; twice as large, both come into view."""


def row_up(rows: int) -> Array:
    """Return the y of the direction of each row of an equirectangular map, (rows,), top row first."""
    return np.sin(np.pi * (0.5 - (np.arange(rows) + 0.5) / rows))


def upwelling(light: Floats) -> Array:
    """Return the irradiance (3,) of a level plane that faces down, in a levelled map (H, W, 3) of light."""
    up = row_up(len(light))
    of_row = np.maximum(-up, 0.0) * np.sqrt(1.0 - up**2) * (2.0 * PI * PI / light[..., 0].size)
    return np.asarray(np.einsum("r,rck->k", of_row, light))


def check_map(radiance_map: Floats) -> Array:
    """Return a radiance map (H, W, 3) as float64; raise `ParameterError` for another shape or values."""
    m = real("radiance_map", radiance_map).astype(np.float64)
    if m.ndim != 3 or m.shape[2] != 3 or m.shape[0] < 8 or not np.all(np.isfinite(m)) or np.any(m < 0.0):
        raise ParameterError(
            f"radiance_map - must be an equirectangular map (H, W, 3), finite, >= 0 (got {m.shape}) - "
            "pass the environment's radiance"
        )
    return m


@dataclass(frozen=True, slots=True, eq=False)
class PlateProfile:
    """Colour of a plate's water over elevation.

    up: (r,) ascending, radiance: (r, 3).
    """

    up: Array
    radiance: Array

    def __call__(self, up: ArrayLike) -> Array:
        """Return the radiance (..., 3) in directions with the y component `up`."""
        mu = numbers("up", up).astype(np.float64, copy=False)
        return np.stack([np.interp(mu, self.up, channel) for channel in self.radiance.T], axis=-1)

    @classmethod
    def from_map(cls, radiance_map: Floats) -> PlateProfile:
        """Return the typical colour of each row where the view is open, smoothed over three rows.

        Azimuths with less red about the horizon than the others count as open, because water absorbs red first. Typical
        is the trimmed mean of the logarithm over them, which ignores bodies that cover a third. All weights are
        continuous, so the profile of a clip changes no faster than its picture.
        """
        m = check_map(radiance_map)
        level = m[np.abs(np.arcsin(row_up(len(m)))) <= LEVEL_RAD].sum(axis=0)
        x = np.log(np.maximum(m, 1e-6 * max(float(m.max()), _TINY)))
        middle = np.exp(typical(x, openness(level), _MIDDLE))
        rows = np.where(m.max(axis=1) > 0.0, middle, 0.0)[::-1]
        padded = np.pad(rows, ((1, 1), (0, 0)), mode="edge")
        calm = np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0)
        padded = np.pad(calm, ((1, 1), (0, 0)), mode="edge")
        smooth = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
        return cls(row_up(len(m))[::-1].copy(), smooth)


def openness(level: Array) -> Array:
    """Return the weight (c,) of azimuths by the rank in red of their light (c, 3): 1 for the least, 0 for the most."""
    red = level[:, 0] / np.maximum(level.sum(axis=1), _TINY)
    rank = (np.argsort(np.argsort(red, kind="stable")) + 0.5) / len(red)
    return smoothstep(rank, _CLOSED, _OPEN)


def typical(values: Array, weight: Array, middle: float) -> Array:
    """Return the weighted mean (..., 3) of the middle of values (..., c, 3) of azimuths, by rank in each channel.

    weight: (c,). middle: fraction of the azimuths about the median that is averaged.
    """
    order = np.argsort(values, axis=-2, kind="stable")
    share = np.take_along_axis(np.broadcast_to((weight / weight.sum())[:, None], values.shape), order, -2)
    end = np.cumsum(share, axis=-2)
    low, high = 0.5 - 0.5 * middle, 0.5 + 0.5 * middle
    inside = np.clip(end, low, high) - np.clip(end - share, low, high)
    return np.asarray((inside * np.take_along_axis(values, order, -2)).sum(axis=-2) / inside.sum(axis=-2))
