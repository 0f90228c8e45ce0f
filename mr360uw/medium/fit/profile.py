# SPDX-License-Identifier: Apache-2.0
"""Colour of the open water in a plate as a profile over elevation, robust against animals, divers and rocks.

The gain of the veil is told by a thin band at the horizon, where rays are long and show water alone.

    g = typical over azimuths of plate/model        residual = rms of (plate/(g model) - 1)

Below the band lies the ground, above it the surface. Azimuths in which a body or a rock breaks the horizon have clearly
more red than water, or stand out of the others; both lose weight continuously, so that the gain changes no faster than
the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.color import luminance
from mr360uw.constants import PI
from mr360uw.errors import ParameterError
from mr360uw.medium.medium import Medium
from mr360uw.shapes import exactly, numbers, real, vectors
from mr360uw.texels import smoothstep
from mr360uw.types import Array, Floats

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


BAND_RAD = np.radians(1.0)
"""Half height [rad] of the band, one row at least. Twice as high, sand 3 m below shows in the clearest water."""
SECTORS = 64
"""Azimuths that are told apart; each is a mean over hundreds of pixels, in which noise and dither are gone."""
DOUBTFUL = 0.45
"""Residual from which the gain counts as not known: open water varies by up to 0.37 about a low sun, by a tenth without
one; rocks and walls by 0.5 and more."""
_TYPICAL_RANK = 0.3
"""Rank in red of an azimuth that shows water alone, as long as bodies and rocks leave a third of the horizon."""
_DARKEST = 1e-300
"""Least light that is divided by: that of deep murky water has hundreds of digits before it."""
_LEAST_EXCESS, _MOST_EXCESS = 1.2, 1.6
"""Red over that azimuth's between which the weight of an azimuth falls to 0.

Dark red is coarse in a video: weights by rank alone would choose the azimuths whose codes were rounded down, and the
gain of red would be 1 to 3 % low.
"""
MIDDLE = 0.5
"""Fraction of the open azimuths about the median that is averaged; bodies may cover a quarter of them unseen."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """A plate's light just above and below the horizon.

    up: (2,) y of the directions, of either sign. radiance: (2, SECTORS, 3) means, linear, not clipped.
    """

    up: Array
    radiance: Floats


def fit_level(medium: Medium, view: LevelView) -> tuple[Array, float]:
    """Return the gain (3,) that makes the model's level radiance that of the plate's water, and the residual.

    residual: rms of the luminance's relative deviation over the azimuths, whether they are taken for water or not; from
    `DOUBTFUL` on there is no open water to measure. A channel that is black has the gain 0.
    """
    seen = vectors("radiance", view.radiance).astype(np.float64)
    up = exactly("up", view.up, (len(seen),)).astype(np.float64)
    model = medium.level_radiance(up)
    columns = (seen / np.maximum(model, _DARKEST)[:, None]).mean(axis=0)
    shown = np.maximum(seen.mean(axis=0), 0.0)
    gain = np.maximum(typical(columns, _openness(shown), MIDDLE), 0.0)
    light = luminance(gain * model.mean(axis=0))
    if light <= 0.0:
        return gain, 0.0
    return gain, float(np.sqrt(np.mean((luminance(shown) / light - 1.0) ** 2)))


def _openness(shown: Array) -> Array:
    """Return the weight (c,) of azimuths by the fraction of red in their light (c, 3): bodies have more than water."""
    red = shown[:, 0] / np.maximum(shown.sum(axis=1), _DARKEST)
    excess = red / max(float(np.quantile(red, _TYPICAL_RANK)), _DARKEST)
    weight = smoothstep(excess, _MOST_EXCESS, _LEAST_EXCESS)
    return np.asarray(weight if np.any(weight > 0.0) else np.ones(len(red)))
