# SPDX-License-Identifier: Apache-2.0
"""Smooths a signal over time without lag, with a strength estimated from the data.

The model is a random walk in acceleration plus white noise:

    minimise  sum w_t |x_t - z_t|^2 + lambda sum |third difference of x|^2

(Whittaker 1923). Its solution is that of a Kalman filter run forward and a smoother run backward (Rauch 1965)
for that random walk; here one banded Cholesky factorisation eliminates forward and
substitutes backward. Lambda maximises the restricted likelihood, so a still camera is averaged over the whole shot
and a turning one is followed. Samples of weight 0 are bridged; outliers lose their weight by iteration (Student's t).
Before the first sample of some weight and after the last the signal stays what it is there: a third-order model would
leave them along a parabola.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ORDER = 3
"""Order of the differences that are penalised. With 2 curved paths would be pulled straight."""
_LAMBDAS = 10.0 ** np.arange(-2.0, 11.1, 0.5)
"""Strengths that are tried, up to where the factorisation still holds in double precision, if most samples are seen."""
_OUTLIER = 3.0
"""Residual, in standard deviations, at which a sample's weight is halved."""
_ROUNDS = 4
"""Iterations of the outliers' weights."""


def _penalty(count: int) -> Array:
    """Return the upper bands (order + 1, n) of the matrix of summed squared differences of that order."""
    difference = [(-1.0) ** (_ORDER - k) * math.comb(_ORDER, k) for k in range(_ORDER + 1)]
    bands = np.zeros((_ORDER + 1, count))
    for i in range(_ORDER + 1):
        for j in range(i, _ORDER + 1):
            bands[_ORDER + i - j, j : count - _ORDER + j] += difference[i] * difference[j]
    return bands


def _fit(z: Array, w: Array, strength: float, penalty: Array) -> tuple[Array, float]:
    """Return the smoothed signal and the log determinant of its system."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    system = strength * penalty
    system[-1] += w
    factor = cholesky_banded(system)
    return cho_solve_banded((factor, False), w[:, None] * z), 2.0 * float(np.log(factor[-1]).sum())


def strength_of_period(samples: float) -> float:
    """Return the strength that halves waves of this period: their frequency's power of twice the order, inverted."""
    return float((max(samples, 1.0) / (2.0 * math.pi)) ** (2 * _ORDER))


def smooth(values: Array, weight: Array, least_strength: float = 0.0) -> Array:
    """Return values (n, k) smoothed over n equidistant samples of weight (n,) >= 0, bridging those of weight 0.

    least_strength: the smoothing is at least so strong, whatever the data say (`strength_of_period`). With no more than
    three samples of some weight, or too few for their distance: their weighted mean throughout. NaN where no sample has
    any.
    """
    values, weight = np.asarray(values, np.float64), np.asarray(weight, np.float64)
    seen = np.flatnonzero(weight > 0.0)
    if not len(seen):
        return np.full_like(values, np.nan)
    first, last = int(seen[0]), int(seen[-1])
    among = _smoothed(values[first : last + 1], weight[first : last + 1], least_strength)
    return among[np.clip(np.arange(len(values)) - first, 0, last - first)]


def _smoothed(values: Array, weight: Array, least_strength: float) -> Array:
    """Return values (n, k) smoothed, of which the first and the last have some weight."""
    count, channels = values.shape
    seen = weight > 0.0
    mean = np.broadcast_to(np.average(values[seen], axis=0, weights=weight[seen]), values.shape)
    if np.count_nonzero(seen) <= _ORDER:
        return mean
    z = np.where(seen[:, None], values, 0.0)
    penalty = _penalty(count)
    degrees = np.count_nonzero(seen) - _ORDER
    w = np.where(seen, weight / weight[seen].mean(), 0.0)
    trust = w
    strengths = np.unique(np.clip(_LAMBDAS, min(least_strength, _LAMBDAS[-1]), None))
    for _ in range(_ROUNDS):
        best = (np.inf, mean)
        for strength in strengths:
            try:
                x, log_determinant = _fit(z, trust, strength, penalty)
            except np.linalg.LinAlgError:
                break  # singular to rounding, and so with all that are stronger
            rough = np.diff(x, _ORDER, axis=0)
            loss = float((trust[:, None] * (z - x) ** 2).sum() + strength * (rough**2).sum())
            variance = max(loss / (channels * degrees), 1e-30)
            score = degrees * np.log(variance) + log_determinant - (count - _ORDER) * np.log(strength)
            best = min(best, (score, x), key=lambda pair: pair[0])
        x = best[1]
        square = ((z - x) ** 2).sum(axis=1) / channels
        spread = max(float(np.median(square[seen])), 1e-24) / 0.6
        trust = w / (1.0 + square / (_OUTLIER**2 * spread))
    return x
