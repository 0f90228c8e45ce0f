# SPDX-License-Identifier: Apache-2.0
"""Roll and pitch of an underwater camera, estimated from Snell's window in a radiance map.

From under water the whole sky lies within asin(1/n) of the vertical, 48.3 degrees in sea water; outside of that circle
the surface mirrors the water below. The estimate is the tilt at which a step of brightness at the circle's edge
explains most of the picture:

    log L = a + b y + c y^2 + (d + e y) x + (f + g y) z + s tanh((elevation - edge)/width)

over directions (x, y, z) in level axes, above the horizon; a to g and s are fitted by least squares. The smooth terms
model other gradients: the side towards the sun is brighter, which by itself would look like a tilt. Where haze or waves
hide the edge, the step explains little and the estimate is not reliable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import luminance
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.ibl.plate import snell_elevation
from mr360uw.ibl.tilt import level_matrix, roll_pitch
from mr360uw.sphere import directions, row_solid_angle, unit

Array = NDArray[np.float64]

LARGEST_TILT_RAD = np.radians(30.0)
"""Largest tilt that is tried [rad]. Beyond it the window would reach the horizon, where reefs are fitted instead."""
_WIDTH_RAD = np.radians(8.0)
"""Half width of the step [rad]: waves blur the edge about as much. Narrower, the fit follows single waves."""
_LOWEST_SINE = np.sin(np.radians(10.0))
"""Sine of the elevation below which pixels get no weight: there stand reefs and divers rather than the surface."""
_LEAST_EXPLAINED, _LEAST_CONTRAST = 0.7, 1.8
"""Smallest share of variance and brightness ratio of a reliable estimate. Lower ones accept clouds for a window."""
_ROUNDS = 3
"""Fits, each with outliers of the one before weighted down; the first two start from the best point of a grid."""
_OUTLIER = 2.5
"""Distance from the fit, in robust standard deviations, at which a pixel's weight is halved: divers, walls, the sun."""


@dataclass(frozen=True, slots=True)
class HorizonEstimate:
    """Roll and pitch [rad] estimated from one frame.

    explained: share, 0 to 1, of the variance left by the smooth terms that the edge of the window explains. contrast:
    brightness inside the window over that outside.
    """

    roll_rad: float
    pitch_rad: float
    explained: float
    contrast: float

    @property
    def reliable(self) -> bool:
        """Whether the edge of the window is distinct enough for an estimate within a degree or two."""
        return self.explained >= _LEAST_EXPLAINED and self.contrast >= _LEAST_CONTRAST


class _Fit:
    """The fit's normal equations for one picture."""

    def __init__(self, value: Array, direction: Array, solid_angle: Array, edge_rad: float) -> None:
        self._edge_rad = edge_rad
        self._value, self._direction, self._solid_angle = value, direction, solid_angle
        self.trust: Array = np.ones_like(value)

    def _equations(self, tilt: Array) -> tuple[Array, Array, Array, Array]:
        """Return each pixel's weight (n,), the equations' matrix (8, 8) and right side (8,), and the terms (8, n)."""
        x, y, z = (self._direction @ level_matrix(tilt[0], tilt[1]).T).T
        edge = np.tanh((np.arcsin(np.clip(y, -1.0, 1.0)) - self._edge_rad) / _WIDTH_RAD)
        above = np.clip((y - _LOWEST_SINE) / 0.1 + 0.5, 0.0, 1.0)
        terms, weight = np.stack([np.ones_like(y), y, y * y, x, z, x * y, z * y, edge]), self._solid_angle * above
        weighted = terms * (weight * self.trust)
        return weight, weighted @ terms.T + 1e-9 * np.eye(len(terms)), weighted @ self._value, terms

    def solve(self, tilt: Array) -> tuple[float, float]:
        """Return (share of variance not explained by the step, the step's half height in log brightness)."""
        weight, a, b, _ = self._equations(tilt)
        whole = np.linalg.solve(a, b)
        smooth = np.linalg.solve(a[:-1, :-1], b[:-1])
        total = float((weight * self.trust) @ self._value**2)
        left, without = total - float(b @ whole), total - float(b[:-1] @ smooth)
        if without <= 1e-9 * max(total, 1e-12) or whole[-1] <= 0.0:
            return 1.0, 0.0
        return left / without, float(whole[-1])

    def unexplained(self, tilt: Array) -> float:
        """Return the share of variance that a tilt leaves unexplained; more than 1 beyond the largest tilt."""
        size = float(np.hypot(*tilt))
        return 1.0 + size if size > LARGEST_TILT_RAD else self.solve(tilt)[0]

    def doubt_outliers(self, tilt: Array) -> None:
        """Set the weight of each pixel to 1/(1 + (distance from the fit/limit)^2)."""
        weight, a, b, terms = self._equations(tilt)
        fit = np.linalg.solve(a, b) @ terms
        distance = np.abs(self._value - fit)
        spread = 1.4826 * float(np.median(distance[weight > 0.5 * self._solid_angle])) + 1e-6
        self.trust = 1.0 / (1.0 + np.square(distance / (_OUTLIER * spread)))


def estimate_horizon(radiance: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> HorizonEstimate:
    """Return the tilt, up to 30 degrees, at which a radiance map (H, W, 3) of an underwater plate is level.

    Take the light without the sun (`Environment.residual`), a map of 64 x 32. refractive_index: of the water.
    """
    from scipy.optimize import minimize

    image = np.asarray(radiance, np.float64)
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ParameterError(f"radiance - must be an RGB map (got shape {image.shape}) - give (H, W, 3)")
    height, width = image.shape[:2]
    fit = _Fit(
        np.log(np.maximum(luminance(image), 1e-4)).ravel(),
        directions(width, height).reshape(-1, 3),
        np.repeat(row_solid_angle(width, height), width),
        snell_elevation(refractive_index),
    )
    steps = np.linspace(-0.4, 0.4, 9)
    grid = [np.array([a, b]) for a in steps for b in steps if np.hypot(a, b) <= LARGEST_TILT_RAD]
    tilt = grid[0]
    for turn in range(_ROUNDS):
        start = min(grid, key=fit.unexplained) if turn < 2 else tilt
        found = minimize(fit.unexplained, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7})
        tilt = found.x
        if turn < _ROUNDS - 1:
            fit.doubt_outliers(tilt)
    left, step = fit.solve(tilt)
    return HorizonEstimate(float(tilt[0]), float(tilt[1]), 1.0 - left, float(np.exp(2.0 * step)))


@dataclass(frozen=True, slots=True)
class ClipHorizon:
    """Roll and pitch [rad] of a clip, the median of its reliable frames; spread_rad: rms angle of these about it."""

    roll_rad: float
    pitch_rad: float
    spread_rad: float
    frames: int


def clip_horizon(estimates: Sequence[HorizonEstimate]) -> ClipHorizon | None:
    """Return the tilt that most frames of a clip agree on; None where fewer than half of them are reliable."""
    seen = [e for e in estimates if e.reliable]
    if not seen or 2 * len(seen) < len(estimates):
        return None
    ups = np.stack([level_matrix(e.roll_rad, e.pitch_rad)[1] for e in seen])
    up = unit(np.median(ups, axis=0))
    angle = np.arccos(np.clip(ups @ up, -1.0, 1.0))
    roll, pitch = roll_pitch(up)
    return ClipHorizon(float(roll), float(pitch), float(np.sqrt(np.mean(angle**2))), len(seen))
