# SPDX-License-Identifier: Apache-2.0
"""One direction of the sun for a shot, or a slow path where the camera turns.

Waves move what is measured by a degree or two with periods of seconds; the sun stands still. The direction of a shot is
the middle of its measurements, with outliers weighed down (Student's t). A camera of unknown rotation is taken to stand
unless the measurements say otherwise: averaged over longer than waves last they leave that middle, the path through
them is further from it than waves reach, or they drift by more than chance lets waves do. The path is smoothed over a
wave's period at least.

`smooth` takes a random walk in acceleration plus white noise for its model:

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
from typing import Literal

import numpy as np
from numpy.typing import NDArray


_ORDER = 3
"""Order of the differences that are penalised. With 2 curved paths would be pulled straight."""
_LAMBDAS = 10.0 ** np.arange(-2.0, 11.1, 0.5)
"""Strengths that are tried, up to where the factorisation still holds in double precision, if most samples are seen."""
_OUTLIER_SIGMA = 3.0
"""Residual, in standard deviations, at which a sample's weight is halved."""
_SMOOTH_ROUNDS = 4
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
    for _ in range(_SMOOTH_ROUNDS):
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
        trust = w / (1.0 + square / (_OUTLIER_SIGMA**2 * spread))
    return x


Camera = Literal["tracked", "levelled", "unknown"]

WAVE_PERIOD_S = 2.0
"""Period [s] of the waves that disturb the sun most: wind waves of a light breeze."""
_CALM_S = 2.0 * WAVE_PERIOD_S
"""Time [s] over which waves average out."""
_WANDERING_RAD = np.radians(1.0)
"""Deviation of such averages from the middle, rms, above which the camera turns."""
_WAVES_RAD = np.radians(2.5)
"""Deviation of the path itself, rms, above which it does: waves leave half of it."""
_SURE, _FEWEST = 3.0, 8
"""Standard deviations of a trend above which it is one, and the fewest samples it is told from."""
_OUTLIER = 2.5
"""Distance, over the median one, at which the weight of a measurement is halved."""
_ROUNDS = 20
"""Rounds of reweighting."""


def steady_directions(times_s: Array, direction: Array, weight: Array, camera: Camera) -> Array:
    """Return the unit directions (n, 3) of the sun in a shot; NaN where it is never seen.

    times_s: (n,). direction: (n, 3) measured, in world axes, used where weight (n,) > 0.
    """
    seen = weight > 0.0
    if not seen.any():
        return np.full_like(direction, np.nan)
    middle = _mean_direction(direction[seen], weight[seen])
    still = np.broadcast_to(middle, direction.shape).copy()
    if camera == "tracked" or len(times_s) < 2:
        return still
    step = float(np.median(np.diff(times_s)))
    path = _path(direction, weight, WAVE_PERIOD_S / step)
    if not _turns(times_s, direction, weight, middle, path):
        return still
    return path if camera == "unknown" else _at_elevation(path, direction[seen], weight[seen])


def _mean_direction(direction: Array, weight: Array) -> Array:
    """Return the unit vector in the middle of directions (n, 3), outliers weighed down."""
    trust = weight
    middle = np.zeros(3)
    for _ in range(_ROUNDS):
        middle = trust @ direction
        middle = middle / max(float(np.linalg.norm(middle)), 1e-12)
        distance = np.linalg.norm(direction - middle, axis=1)
        spread = _OUTLIER * max(float(np.median(distance)), 1e-6)
        trust = weight / (1.0 + (distance / spread) ** 2)
    return middle


def _path(direction: Array, weight: Array, least_samples: float) -> Array:
    """Return the smoothed path (n, 3), without what changes within so many samples."""
    used = np.where((weight > 0.0)[:, None], direction, 0.0)
    chord = smooth(used, weight, strength_of_period(least_samples))
    return chord / np.linalg.norm(chord, axis=1, keepdims=True)


def _turns(times: Array, direction: Array, weight: Array, middle: Array, path: Array) -> bool:
    """Return whether the measurements wander by more than waves make them."""
    seen = weight > 0.0
    offset = direction[seen] - middle
    near = (np.abs(times[seen][:, None] - times[seen]) <= 0.5 * _CALM_S) * weight[seen]
    # a shot that is no longer has one average, which says nothing
    calm = (near @ offset) / near.sum(axis=1, keepdims=True) if np.ptp(times[seen]) > _CALM_S else 0.0 * offset
    wanders = _rms(calm) > _WANDERING_RAD or _rms(path[seen] - middle) > _WAVES_RAD
    return bool(wanders or _drifts(times[seen], offset))


def _drifts(times: Array, offset: Array) -> bool:
    """Return whether offsets (n, 3) have a trend of a degree or more that waves would hardly make by chance."""
    count = len(times)
    if count < _FEWEST:
        return False
    x = (times - times.mean()) / max(float(np.ptp(times)), 1e-9)
    slope = (x @ offset) / (x @ x)
    rest = offset - offset.mean(axis=0) - x[:, None] * slope
    # samples that waves tie together count once: integrated autocorrelation up to where it first ends
    power = float((rest**2).sum())
    together = 1.0
    for lag in range(1, count // 2):
        tied = float((rest[lag:] * rest[:-lag]).sum()) / max(power, 1e-30)
        if tied <= 0.0:
            break
        together += 2.0 * tied
    chance = np.sqrt(power / count * together / float(x @ x))
    return float(np.linalg.norm(slope)) > max(_SURE * chance, _WANDERING_RAD)


def _rms(offset: Array) -> float:
    """Return the root mean square length of offsets (n, 3), the worst tenth left out."""
    square = np.sort((offset**2).sum(axis=1))
    return float(np.sqrt(square[: max(int(0.9 * len(square)), 1)].mean()))


def _at_elevation(path: Array, direction: Array, weight: Array) -> Array:
    """Return a path with its own azimuths, all at the middle elevation of the directions (n, 3) that were measured."""
    order = np.argsort(direction[:, 1])
    share = np.cumsum(weight[order])
    sine = float(np.interp(0.5 * share[-1], share, direction[order, 1]))
    flat = path[:, [0, 2]] / np.maximum(np.linalg.norm(path[:, [0, 2]], axis=1, keepdims=True), 1e-12)
    cosine = np.sqrt(max(1.0 - sine * sine, 0.0))
    return np.stack([cosine * flat[:, 0], np.full(len(path), sine), cosine * flat[:, 1]], axis=1)
