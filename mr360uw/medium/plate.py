# SPDX-License-Identifier: Apache-2.0
"""The water's own colour in a plate: its profile over elevation, and the gain that puts a model into its exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError
from mr360uw.types import Floats

if TYPE_CHECKING:
    from mr360uw.medium.medium import Medium

Array = NDArray[np.float64]

LEVEL_RAD = np.radians(12.0)
"""Rows this close to the horizon show water rather than surface or ground."""


def row_up(rows: int) -> Array:
    """Return the y of the direction of each row of an equirectangular map, (rows,), top row first."""
    return np.sin(np.pi * (0.5 - (np.arange(rows) + 0.5) / rows))


def check_map(radiance_map: Floats) -> Array:
    """Return a radiance map (H, W, 3) as float64; raise `ParameterError` for another shape or values."""
    m = np.asarray(radiance_map, np.float64)
    if m.ndim != 3 or m.shape[2] != 3 or m.shape[0] < 8 or not np.all(np.isfinite(m)) or np.any(m < 0.0):
        raise ParameterError(
            f"radiance_map - must be an equirectangular map (H, W, 3), finite, >= 0 (got {m.shape}) - "
            "pass the environment's radiance"
        )
    return m


@dataclass(frozen=True, slots=True, eq=False)
class PlateProfile:
    """The colour of a plate over elevation, without its fish and rocks.

    up: (r,) ascending, radiance: (r, 3).
    """

    up: Array
    radiance: Array

    def __call__(self, up: ArrayLike) -> Array:
        """Return the radiance (..., 3) in directions with the y component `up`."""
        mu = np.asarray(up, np.float64)
        return np.stack([np.interp(mu, self.up, channel) for channel in self.radiance.T], axis=-1)

    @classmethod
    def from_map(cls, radiance_map: Floats) -> PlateProfile:
        """Return the typical colour of each row where the view is open, smoothed over three rows.

        Open is the half of the azimuths with the least red about the horizon: water takes red first. Typical is the
        median over them after what lies more than three standard deviations off, by the median absolute deviation of
        the logarithm, has been left out: bodies that cover less than half of it do not count.
        """
        m = check_map(radiance_map)
        rows = _typical(m[:, _open_columns(m)])[::-1]
        padded = np.pad(rows, ((1, 1), (0, 0)), mode="edge")
        calm = np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0)
        padded = np.pad(calm, ((1, 1), (0, 0)), mode="edge")
        smooth = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
        return cls(row_up(len(m))[::-1].copy(), smooth)


def _open_columns(m: Array) -> NDArray[np.intp]:
    """The half of the columns of a map that show the least red about the horizon."""
    level = m[np.abs(np.arcsin(row_up(len(m)))) <= LEVEL_RAD].sum(axis=0)
    red = level[:, 0] / np.maximum(level.sum(axis=1), 1e-30)
    return np.argsort(red, kind="stable")[: max(m.shape[1] // 2, 1)]


def _typical(m: Array) -> Array:
    """The colour (r, 3) of most pixels of each row of a map (r, c, 3)."""
    x = np.log(np.maximum(m, 1e-6 * max(float(m.max()), 1e-30)))
    kept = x
    for _ in range(4):
        middle = np.nanmedian(kept, axis=1, keepdims=True)
        spread = 1.4826 * np.nanmedian(np.abs(kept - middle), axis=1, keepdims=True)
        near = np.all(np.abs(x - middle) <= 3.0 * spread + 1e-9, axis=-1, keepdims=True)
        kept = np.where(near | ~near.any(axis=1, keepdims=True), x, np.nan)
    return np.where(m.max(axis=1) > 0.0, np.exp(np.nanmedian(kept, axis=1)), 0.0)


def fit_gain(medium: Medium, radiance_map: Floats) -> tuple[Array, float]:
    """Return the gain (3,) that makes the model's level radiance that of the plate, and the residual of the fit.

    Rows within 12 degrees of the horizon count, each by its typical colour over the azimuth. The gain of a channel is
    the median ratio of plate to model over these rows; residual: rms of the relative deviation left, over rows and
    channels (0 = the model has the plate's colour at every elevation). Raises `ParameterError` for a black plate.
    """
    profile = PlateProfile.from_map(radiance_map)
    up = profile.up[np.abs(np.arcsin(profile.up)) <= LEVEL_RAD]
    measured = profile(up)
    model = medium.display(medium.model.radiance(medium.camera_depth_m, up))
    if np.any(np.median(measured, axis=0) <= 0.0) or np.any(model <= 0.0):
        raise ParameterError(
            f"gain - the plate is black about the horizon (got {np.median(measured, axis=0).tolist()}) - "
            "give the gain yourself"
        )
    gain = np.median(measured / model, axis=0)
    deviation = measured / (gain * model) - 1.0
    return gain, float(np.sqrt(np.mean(deviation**2)))
