# SPDX-License-Identifier: Apache-2.0
"""One direction of the sun for a shot, or a slow path where the camera turns.

Waves move what is measured by a degree or two with periods of seconds; the sun stands still. The direction of a shot is
the middle of its measurements, with outliers weighed down (Student's t). A camera of unknown rotation is taken to stand
unless the measurements say otherwise: averaged over longer than waves last they leave that middle, the path through
them is further from it than waves reach, or they drift by more than chance lets waves do. The path is smoothed over a
wave's period at least.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.ibl.sun.smooth import smooth, strength_of_period

Array = NDArray[np.float64]
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
    middle = _middle(direction[seen], weight[seen])
    still = np.broadcast_to(middle, direction.shape).copy()
    if camera == "tracked" or len(times_s) < 2:
        return still
    step = float(np.median(np.diff(times_s)))
    path = _path(direction, weight, WAVE_PERIOD_S / step)
    if not _turns(times_s, direction, weight, middle, path):
        return still
    return path if camera == "unknown" else _at_elevation(path, direction[seen], weight[seen])


def _middle(direction: Array, weight: Array) -> Array:
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
