# SPDX-License-Identifier: Apache-2.0
"""Gain of the veil: fitted to a plate's exposure in each frame, then smoothed over a clip.

It is fitted to a thin band at the horizon, where rays are long and show water alone.

    g = typical over azimuths of plate/model        residual = rms of (plate/(g model) - 1)

Below the band lies the ground, above it the surface. Azimuths in which a body or a rock breaks the horizon have clearly
more red than water, or stand out of the others; both lose weight continuously, so that the gain changes no faster than
the picture.

A change of the camera's exposure multiplies the whole picture in all channels; the gain follows it at once. Changes
in a part of the picture, as of animals that pass, are followed slowly and only if they last.

Over a clip it is measured a few times a second. Between two measured frames that show the same at the same exposure,
those in between are taken to lie on the way; where exposure or picture change, all of them are measured, so that
steps and cuts are found to the frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import luminance
from mr360uw.base.parameters import checked, exactly, numbers, vectors
from mr360uw.base.texels import smoothstep
from mr360uw.medium.medium import Medium
from mr360uw.medium.open_water import LEVEL_RAD, MIDDLE, TYPICAL_RANK, PlateProfile, typical
from mr360uw.types import Array, Floats, sample_step

Frame = TypeVar("Frame")

_TINY = 1e-300
"""Least radiance that is divided by: far below the light of any depth."""
BAND_RAD = np.radians(1.0)
"""Half height [rad] of the band, one row at least. Twice as high, sand 3 m below shows in the clearest water."""
SECTORS = 64
"""Azimuths that are told apart; each is a mean over hundreds of pixels, in which noise and dither are gone."""
DOUBTFUL = 0.45
"""Residual from which the gain counts as not known: open water varies by up to 0.37 about a low sun, by a tenth without
one; rocks and walls by 0.5 and more."""
_LEAST_EXCESS, _MOST_EXCESS = 1.2, 1.6
"""Red over that azimuth's between which the weight of an azimuth falls to 0.

Dark red is coarse in a video: weights by rank alone would choose the azimuths whose codes were rounded down, and the
gain of red would be 1 to 3 % low.
"""


LevelView = tuple[Array, Floats]
"""A plate's light just above and below the horizon: y (2,) of the directions, of either sign, and the light there (2,
SECTORS, 3), means, linear, not clipped."""


def fit_level(medium: Medium, view: LevelView) -> tuple[Array, float]:
    """Return the gain (3,) that makes the model's level radiance that of the plate's water, and the residual.

    residual: rms of the luminance's relative deviation over the azimuths, whether they are taken for water or not; from
    `DOUBTFUL` on there is no open water to measure. A channel that is black has the gain 0.
    """
    seen = vectors("radiance", view[1]).astype(np.float64)
    up = exactly("up", view[0], (len(seen),)).astype(np.float64)
    model = medium.level_radiance(up)
    columns = (seen / np.maximum(model, _TINY)[:, None]).mean(axis=0)
    shown = np.maximum(seen.mean(axis=0), 0.0)
    gain = np.maximum(typical(columns, _openness(shown), MIDDLE), 0.0)
    light = luminance(gain * model.mean(axis=0))
    if light <= 0.0:
        return gain, 0.0
    return gain, float(np.sqrt(np.mean((luminance(shown) / light - 1.0) ** 2)))


def _openness(shown: Array) -> Array:
    """Return the weight (c,) of azimuths by the fraction of red in their light (c, 3): bodies have more than water."""
    red = shown[:, 0] / np.maximum(shown.sum(axis=1), _TINY)
    excess = red / max(float(np.quantile(red, TYPICAL_RANK)), _TINY)
    weight = smoothstep(excess, _MOST_EXCESS, _LEAST_EXCESS)
    return np.asarray(weight if np.any(weight > 0.0) else np.ones(len(red)))


_DARK, _BRIGHT = 1e-3, 0.9
"""Linear values between which a pixel measures the exposure: the lowest codes are coarse, the highest clip."""
_ENOUGH = 0.25
"""Least fraction of such pixels for a channel to count."""
_AGREE = 0.5
"""An exposure change moves three quarters of the pixels by at least this fraction of the median change.

A body that enters the picture does not. At 1 nothing would count, as only half of the pixels reach the median.
"""
_LEAST_CHANGE = 0.02
"""Least log change of exposure from frame to frame: moving water alone changes the picture as much."""
CUT, _CUT_MEDIANS = 0.25, 6.0
"""A cut changes the log luminance by at least this much, and by this many medians of the clip's changes."""
UNCHANGED = 0.5 * CUT
"""Change of the picture up to which two samples in time show the same: half of that of a cut."""
_FLASH_FRAMES = 2
"""Half window [frames] of the median filter of the exposure: shorter changes are ignored as flashes."""
_PASSING_S = 1.0
"""Half window [s] of the median filter of the gain: deviations shorter than this are ignored."""
_EASE_S = 1.0
"""Half window [s] of the weighted mean after it; twice as large, the gain takes twice as long to follow."""


@checked
def fit_gain(medium: Medium, radiance_map: Floats) -> tuple[Array, float]:
    """Return the gain that makes the model's level radiance that of the plate, and the residual of the fit.

    Rows within 12 degrees of the horizon count, each by its typical colour over the azimuth.

    Parameters
    ----------
    medium : Medium
        The model.
    radiance_map : array_like
        Linear radiance (32, 64, 3) of the plate, as `Environment.residual`.

    Returns
    -------
    gain : ndarray
        Gain (3,): of a channel the median ratio of plate to model over these rows. A channel that is black about the
        horizon, as red is in deep water, has the gain 0 and no residual.
    residual : float
        Root mean square of the relative deviation left, over rows and channels; 0: the model has the plate's colour at
        every elevation.

    Raises
    ------
    ParameterError
        If the map cannot be used.

    See Also
    --------
    uw.medium.Medium.scaled : Takes the gain.
    uw.ibl.environment : Makes the map.
    uw.medium.fit_water : Finds the type of water.

    Examples
    --------
    >>> medium = uw.medium.Medium(uw.medium.Water.jerlov("IB"), mode="kd", camera_depth_m=4.0)
    >>> gain, residual = uw.medium.fit_gain(medium, uw.ibl.environment(plate, underwater=True).residual)
    >>> gain.shape
    (3,)
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
    """Return the log of the exposure ratio between linear maps (H, W, 3) of two neighbouring frames, after over before.

    It is the least of the channels' median log ratios. It is 0 where the channels disagree in sign, where more than a
    quarter of the pixels change by less than half of the median, where too few pixels can be used, and below 2 %.
    """
    exactly("after", after, vectors("before", before).shape)
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
    """Return the median absolute change of log luminance between two maps (H, W, 3), without a common factor.

    Infinite where too few pixels are usable (neither black nor clipped) in both maps but enough are in one of them.
    """
    exactly("after", after, vectors("before", before).shape)
    x, y = luminance(before), luminance(after)
    told_x, told_y = ((v > _DARK) & (v < _BRIGHT) for v in (x, y))
    both = told_x & told_y
    if both.mean() < _ENOUGH:
        return np.inf if max(told_x.mean(), told_y.mean()) >= _ENOUGH else 0.0
    change = np.log(y[both] / x[both])
    return float(np.median(np.abs(change - np.median(change))))


def steady_gain(gains: ArrayLike, exposure: ArrayLike, picture: ArrayLike, frame_rate: float) -> Array:
    """Return the smoothed gain (N, 3) of every frame of a clip from the gains (N, 3) that `fit_gain` finds in each.

    exposure, picture: (N,) `exposure_change` and `picture_change` from the frame before; 0 for the first. Cuts divide
    the clip into shots. In a shot the gain over the exposure passes a running median and a weighted mean, both centred,
    and is multiplied with the exposure again. Flashes of one or two frames are left out of the exposure.
    """
    gain = vectors("gains", gains).astype(np.float64)
    picture = np.minimum(numbers("picture", picture, infinite=True), np.finfo(np.float64).max)  # cuts from black
    change, moved = (
        exactly(name, values, (len(gain),)).astype(np.float64)
        for name, values in (("exposure", exposure), ("picture", picture))
    )
    shots = pairwise(np.unique([0, *_shot_starts(moved), len(gain)]))
    return np.concatenate([_steady_shot(gain[a:b], change[a:b], frame_rate) for a, b in shots])


def _shot_starts(picture: ArrayLike) -> NDArray[np.int64]:
    """Return the frames that begin a shot, from the `picture_change` (N,) of every frame from the one before."""
    moved = np.asarray(picture, np.float64)
    return np.flatnonzero(moved > max(CUT, _CUT_MEDIANS * float(np.median(moved))))


def _steady_shot(gain: Array, change: Array, frame_rate: float) -> Array:
    steps = np.concatenate([[0.0], np.cumsum(change[1:])])
    exposure = np.exp(_running_median(steps[:, None], _FLASH_FRAMES))
    stays = _running_median(gain / exposure, round(_PASSING_S * frame_rate))
    ease = np.hanning(2 * round(_EASE_S * frame_rate) + 3)[1:-1]
    wide = np.pad(stays, ((len(ease) // 2,) * 2, (0, 0)), mode="edge")
    eased = [np.convolve(channel, ease / ease.sum(), mode="valid") for channel in wide.T]
    return np.asarray(exposure * np.stack(eased, axis=-1))


def _running_median(values: Array, half: int) -> Array:
    """Return medians of values (n, k) over `half` frames on either side; near an end that of the last whole window."""
    half = min(half, (len(values) - 1) // 2)
    whole = np.median(np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1, axis=0), axis=-1)
    return np.asarray(whole[np.clip(np.arange(len(values)) - half, 0, len(whole) - 1)])


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredGain:
    """The gain (3,) of a frame and the residual of its fit (`open_water.fit_level`). shown: small map (h, w, 3)."""

    gain: Floats
    residual: float
    shown: Floats


class GainSeries(Generic[Frame]):
    """Gains of successive frames. measure: measures one."""

    def __init__(self, measure: Callable[[Frame], MeasuredGain], frame_rate: float) -> None:
        self._measure, self._rate, self._step = measure, frame_rate, sample_step(frame_rate)
        self._last: MeasuredGain | None = None
        self._waiting: list[Frame] = []
        self._gains: list[Floats] = []
        self.residuals: list[float] = []
        """Residual of each frame, after `steady`."""
        self._changes: list[tuple[float, float]] = []
        """Changes of exposure and picture from the frame before."""

    def due(self, index: int) -> bool:
        """Return whether frame `index` of the clip is measured; that depends on the index alone."""
        return index % self._step == 0

    def add(self, frame: Frame, index: int) -> None:
        """Add the next frame, of an index in the clip.

        Measured are the first, those that are due, and all where the picture changes.
        """
        if self._last is not None and not self.due(index):
            self._waiting.append(frame)
            return
        here = self._measure(frame)
        if self._waiting and self._last is not None:
            last, count = self._last, len(self._waiting) + 1
            moved = picture_change(last.shown, here.shown)
            if moved <= UNCHANGED and exposure_change(last.shown, here.shown) == 0.0:
                for share in np.arange(1, count) / count:
                    gain = (1.0 - share) * last.gain + share * here.gain
                    self._append(gain, (1.0 - share) * last.residual + share * here.residual, (0.0, moved / count))
                self._append(here.gain, here.residual, (0.0, moved / count))
                self._last, self._waiting = here, []
                return
            self._measure_waiting()
        self._append_measured(here)

    def steady(self) -> Floats:
        """Return the smoothed gain (N, 3) of every frame; see `steady_gain`."""
        self._measure_waiting()
        exposure, picture = zip(*self._changes, strict=True)
        return steady_gain(self._gains, exposure, picture, self._rate)

    def cuts(self) -> NDArray[np.int64]:
        """Return the frames that begin a shot, counted from the first one; after `steady`."""
        return _shot_starts([picture for _, picture in self._changes])

    def _measure_waiting(self) -> None:
        for frame in self._waiting:
            self._append_measured(self._measure(frame))
        self._waiting = []

    def _append_measured(self, here: MeasuredGain) -> None:
        before = here if self._last is None else self._last
        changes = exposure_change(before.shown, here.shown), picture_change(before.shown, here.shown)
        self._append(here.gain, here.residual, changes)
        self._last = here

    def _append(self, gain: Floats, residual: float, changes: tuple[float, float]) -> None:
        self._gains.append(gain)
        self.residuals.append(residual)
        self._changes.append(changes)
