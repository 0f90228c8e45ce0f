# SPDX-License-Identifier: Apache-2.0
"""The gain of a clip's veil: with the plate's exposure at once, and otherwise slowly, whatever swims by.

A camera that changes its exposure changes the whole picture in every channel. What only some of the picture does is no
exposure: the gain follows it if it stays.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import luminance
from mr360uw.medium.medium import Medium
from mr360uw.medium.profile import LEVEL_RAD, PlateProfile
from mr360uw.types import Floats

Array = NDArray[np.float64]

_TINY = 1e-30
_DARK, _BRIGHT = 1e-3, 0.9
"""Between them a pixel tells the exposure: below are the last codes, above the curve bends and clips."""
_ENOUGH = 0.25
"""Part of the picture that must tell it for a channel to count."""
_AGREE = 0.5
"""Part of the median change that three quarters of the picture must reach, which no body makes them do."""
_LEAST_CHANGE = 0.02
"""Log of an exposure's change from one frame to the next; less cannot be seen to lag, and moving water does as much."""
_CUT, _CUT_MEDIANS = 0.25, 6.0
"""A picture's change that is a cut: at least, and over the median of the clip's."""
_FLASH_FRAMES = 2
"""A change that is undone within as many frames is a flash."""
_PASSING_S = 1.0
"""What is gone again within this time does not count."""
_EASE_S = 1.0
"""Half the time over which the gain goes to what stays."""


def fit_gain(medium: Medium, radiance_map: Floats) -> tuple[Array, float]:
    """Return the gain (3,) that makes the model's level radiance that of the plate, and the residual of the fit.

    Rows within 12 degrees of the horizon count, each by its typical colour over the azimuth. The gain of a channel is
    the median ratio of plate to model over these rows; residual: rms of the relative deviation left, over rows and
    channels (0 = the model has the plate's colour at every elevation). A channel that is black about the horizon, as
    red is in deep water, has the gain 0 and no residual. Raises `ParameterError` for an unusable map.
    """
    profile = PlateProfile.from_map(radiance_map)
    up = profile.up[np.abs(np.arcsin(profile.up)) <= LEVEL_RAD]
    measured = profile(up)
    model = medium.level_radiance(up)
    gain = np.median(measured / np.maximum(model, _TINY), axis=0)
    seen = gain > 0.0
    deviation = measured[:, seen] / (gain * model)[:, seen] - 1.0
    return gain, float(np.sqrt(np.mean(deviation**2))) if np.any(seen) else 0.0


def exposure_change(before: Floats, after: Floats) -> float:
    """Return the log of what the exposure changed by between two maps (H, W, 3) of neighbouring frames.

    It is the least of the channels' medians; 0 where they disagree in sign, where a quarter of the picture does not go
    along, where nothing can be told, and within 2 %.
    """
    told = (np.minimum(before, after) > _DARK) & (np.maximum(before, after) < _BRIGHT)
    channels = [c for c in range(3) if told[..., c].mean() >= _ENOUGH]
    if not channels:
        return 0.0
    ratios = [np.log(after[..., c][told[..., c]] / before[..., c][told[..., c]]) for c in channels]
    sign = float(np.sign(np.median(ratios[0])))
    most, median = np.array([np.quantile(sign * ratio, (0.25, 0.5)) for ratio in ratios]).T
    real = median.min() >= _LEAST_CHANGE and np.all(most >= _AGREE * median)
    return sign * float(median.min()) if real else 0.0


def picture_change(before: Floats, after: Floats) -> float:
    """Return by how much half of the picture or more changed, as log luminance, exposure aside.

    Infinite where what neither is black nor clipped in one is so in the other.
    """
    x, y = luminance(before), luminance(after)
    told_x, told_y = ((v > _DARK) & (v < _BRIGHT) for v in (x, y))
    both = told_x & told_y
    if both.mean() < _ENOUGH:
        return np.inf if max(told_x.mean(), told_y.mean()) >= _ENOUGH else 0.0
    change = np.log(y[both] / x[both])
    return float(np.median(np.abs(change - np.median(change))))


def steady_gain(gains: ArrayLike, exposure: ArrayLike, picture: ArrayLike, frame_rate: float) -> Array:
    """Return the gain (N, 3) of every frame of a clip from what `fit_gain` says of each alone, (N, 3).

    exposure, picture: (N,) `exposure_change` and `picture_change` since the frame before; of the first, 0. Within a
    shot: a running median of the gain over the exposure, then a weighted mean, both as wide behind as ahead, times the
    exposure. A flash of one or two frames is no exposure; at its ends a shot keeps its gain.
    """
    gain, change, moved = (np.asarray(a, np.float64) for a in (gains, exposure, picture))
    cuts = np.flatnonzero(moved > max(_CUT, _CUT_MEDIANS * float(np.median(moved))))
    shots = pairwise(np.unique([0, *cuts, len(gain)]))
    return np.concatenate([_steady_shot(gain[a:b], change[a:b], frame_rate) for a, b in shots])


def _steady_shot(gain: Array, change: Array, frame_rate: float) -> Array:
    from scipy.ndimage import convolve1d

    steps = np.concatenate([[0.0], np.cumsum(change[1:])])
    exposure = np.exp(_running_median(steps[:, None], _FLASH_FRAMES))
    stays = _running_median(gain / exposure, round(_PASSING_S * frame_rate))
    ease = np.hanning(2 * round(_EASE_S * frame_rate) + 3)[1:-1]
    return np.asarray(exposure * convolve1d(stays, ease / ease.sum(), axis=0, mode="nearest"))


def _running_median(values: Array, half: int) -> Array:
    """The medians of values (n, k) over `half` frames on either side; near an end those of the last whole window."""
    from scipy.ndimage import median_filter

    count = len(values)
    half = min(half, (count - 1) // 2)
    medians = median_filter(values, size=(2 * half + 1, 1), mode="nearest")
    return np.asarray(medians[np.clip(np.arange(count), half, count - 1 - half)])
