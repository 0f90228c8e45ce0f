# SPDX-License-Identifier: Apache-2.0
"""Estimates the Jerlov type of a plate from the colour of its water over elevation, and the gain of its veil.

A plate shows how the water's radiance changes with direction, not with depth, so attenuation cannot be measured
directly. Instead the solved light field of every Jerlov type at the camera's depth is compared with the plate's profile
about the horizon. The exposure is free; a white balance is allowed at a cost in likelihood. Kd is that of the type that
is found.

How far a fit changes with the frames that it is made of is told by the bootstrap (Efron 1979).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import encode, luminance
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.parameters import checked, exactly, number, numbers, vectors, whole
from mr360uw.errors import ParameterError
from mr360uw.medium.medium import Medium
from mr360uw.medium.open_water import LEVEL_RAD, PlateProfile
from mr360uw.medium.spectra import Sensor
from mr360uw.medium.water import JERLOV_TYPES, JerlovType, Water
from mr360uw.types import Array, Floats, sample_step

Name = TypeVar("Name", bound=str)

_REACH_RAD = np.radians(30.0)
"""Greatest elevation [rad] of the rows that are compared: above lies the surface.

Rows as far below the horizon count too where they show water; the ground shows through 60 m of clear water."""
CONFIDENT = 0.6
"""Confidence from which a type is named: in dives over sand in all types, all that are named are right."""
_LIKELY = 0.1
"""Least likelihood of the types that are listed where none is named."""
_ROW_SIGMA = 0.30
"""Expected relative deviation of a row from the model: marine snow, shafts of light, ground."""
_BALANCE_SIGMA = 0.30
"""Expected relative deviation of a channel due to the camera's white balance."""
_INDEPENDENT_ROWS = 3.0
"""Number of independent measurements in all rows together, because neighbouring rows deviate alike."""
_MISFIT_SCALE = 0.2
"""Rms residual at which the confidence has fallen by a factor of exp(-1/2).

The four figures are calibrated together: the confidence is then the rate at which the type is found again in waters of
both sources of coefficients under a sun, with a white balance that is off by 20 %.
"""
_BAND_COUNT = 31
"""Wavelengths of the light field: 10 nm apart, far finer than the types differ."""


@dataclass(frozen=True, slots=True)
class WaterFit:
    """The Jerlov type whose light field is nearest to a plate.

    water_type: nearest of all. confidence: 0 to 1, its likelihood among the types times how well it fits.
    residual: {type: rms of the logarithm of plate over model}, 0.1 = 10 %. kd: (3,) attenuation [1/m] of the
    downwelling light at the camera's depth, of that type. gain: (3,) plate over model.
    up: (r,) y of the rows' directions; measured, fitted: (r, 3) radiance in the plate's exposure.
    """

    water_type: JerlovType
    confidence: float
    residual: dict[JerlovType, float]
    likelihood: dict[JerlovType, float]
    kd: Array
    gain: Array
    camera_depth_m: float
    up: Array
    measured: Array
    fitted: Array

    @property
    def named(self) -> JerlovType | None:
        """The type of the water if it can be told from the others, else None."""
        return self.water_type if self.confidence >= CONFIDENT else None

    def html(self) -> str:
        """Return a fragment of HTML that shows the fit: verdict, profile and the other types."""
        # Name the type, or the likely ones; then the table of all
        likely = sorted((n for n in self.likelihood if self.likelihood[n] >= _LIKELY), key=JERLOV_TYPES.index)
        verdict = (
            f"Jerlov type: <b>{escape(self.water_type)}</b> (confidence {self.confidence:.2f})"
            if self.named
            else f"No single Jerlov type can be told; likely ones: {escape(', '.join(likely))}; "
            f"nearest <b>{escape(self.water_type)}</b> (confidence {self.confidence:.2f})"
        )
        kd = ", ".join(f"{channel} {value:.3f}" for channel, value in zip("RGB", self.kd, strict=True))
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{100 * self.residual[name]:.0f} %</td>"
            f"<td><meter max='1' value='{share:.3f}'></meter> {100 * share:.0f} %</td></tr>"
            for name, share in sorted(self.likelihood.items(), key=lambda item: -item[1])
        )
        return (
            "<section class='water'><h2>Water</h2>"
            f"<p>{verdict}; rms deviation {100 * self.residual[self.water_type]:.0f} %. "
            f"Attenuation of daylight at {self.camera_depth_m:g} m: {kd} per metre, as the nearest type has it. "
            "One camera position shows how the water's colour changes with direction, not with depth: the type rests "
            "on colour and profile about the horizon, and a white balance in the camera moves it.</p>"
            f"{self._plot()}"
            f"<table><tr><th>type</th><th>deviation</th><th>likelihood</th></tr>{rows}</table></section>"
        )

    def _plot(self) -> str:
        """Return the profile over elevation as inline SVG: dots measured, lines fitted."""
        # Scale to the brightest value
        width, height = 360, 160
        top = 1.05 * float(max(self.measured.max(), self.fitted.max()))
        elevation = np.degrees(np.arcsin(self.up))
        x = (elevation - elevation.min()) / np.ptp(elevation) * (width - 20) + 10
        parts = [f"<svg viewBox='0 0 {width} {height + 20}' width='{width}' role='img'><title>profile</title>"]
        # Draw fitted lines and measured dots, then the colours along the profile
        for channel, colour in enumerate(("#c33", "#3a3", "#36c")):
            line = " ".join(
                f"{a:.1f},{height * (1 - v / top):.1f}" for a, v in zip(x, self.fitted[:, channel], strict=True)
            )
            parts.append(f"<polyline points='{line}' fill='none' stroke='{colour}'/>")
            parts += [
                f"<circle cx='{a:.1f}' cy='{height * (1 - v / top):.1f}' r='2.5' fill='{colour}'/>"
                for a, v in zip(x, self.measured[:, channel], strict=True)
            ]
        for a, row in zip(x, self.measured, strict=True):
            code = np.clip(255 * encode(row / top, "srgb"), 0, 255).astype(int)
            parts.append(
                f"<rect x='{a - 8:.1f}' y='{height + 4}' width='16' height='12' fill='rgb{tuple(code.tolist())}'/>"
            )
        return "".join(parts) + "</svg>"


@checked
def fit_water(
    radiance_map: Floats,
    camera_depth_m: float,
    sensor: Sensor | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> WaterFit:
    """Return the nearest Jerlov type of a plate.

    Elevations near the horizon are compared with the solved light of all ten types. A white balance moves colours more
    than types I to 3C differ: look at `confidence`, and at `named`, which is None below 0.6.

    Parameters
    ----------
    radiance_map : array_like
        Linear radiance (32, 64, 3) of the plate, as `Environment.residual`.
    camera_depth_m : float
        Depth [m] of the camera.
    sensor : Sensor, optional
        Of the camera, the default one unless given.
    refractive_index : float
        Index of the water relative to air.

    Returns
    -------
    WaterFit
        The type, how certain it is, and the fit of all types.

    Raises
    ------
    ParameterError
        If the plate is black about the horizon.

    See Also
    --------
    uw.ibl.environment : Makes the map.
    uw.medium.Water.jerlov : The water of a type.
    uw.medium.fit_gain : The exposure of a known water.

    Examples
    --------
    >>> light = uw.ibl.environment(plate, underwater=True)
    >>> uw.medium.fit_water(light.residual, camera_depth_m=4.0).water_type in uw.medium.JERLOV_TYPES
    True
    """
    number("camera_depth_m", camera_depth_m)
    profile = PlateProfile.from_map(radiance_map)
    up = profile.up[np.abs(np.arcsin(profile.up)) <= _REACH_RAD]
    both = (_fit(profile, rows, camera_depth_m, sensor, refractive_index) for rows in (up, up[up > 0.0]))
    return max(both, key=lambda fit: fit.confidence)


def _fit(
    profile: PlateProfile, up: Array, camera_depth_m: float, sensor: Sensor | None, refractive_index: float
) -> WaterFit:
    # Compare the profile with the level light of every type
    measured = profile(up)
    if np.any(measured.max(axis=0) <= 0.0):
        raise ParameterError(
            f"water - the plate is black about the horizon (got {measured.max(axis=0).tolist()}) - brighten it"
        )
    models = {name: _level_light(name, up, camera_depth_m, sensor, refractive_index) for name in JERLOV_TYPES}
    found = compare_waters(measured, {name: light for name, (light, _) in models.items()})
    light, kd = models[found.nearest]
    return WaterFit(
        water_type=found.nearest,
        confidence=found.confidence,
        residual=found.residual,
        likelihood=found.likelihood,
        kd=kd,
        gain=found.gain,
        camera_depth_m=float(camera_depth_m),
        up=up,
        measured=measured,
        fitted=found.gain * light,
    )


@dataclass(frozen=True, slots=True)
class WaterComparison(Generic[Name]):
    """Waters against a profile; see `WaterFit` for the fields."""

    nearest: Name
    confidence: float
    residual: dict[Name, float]
    likelihood: dict[Name, float]
    gain: Array


def compare_waters(measured: Array, lights: Mapping[Name, Array]) -> WaterComparison[Name]:
    """Return how waters of radiances (r, 3) compare with a measured profile (r, 3), each up to exposure and balance."""
    log_measured = np.log(np.maximum(measured, 1e-4 * measured.max()))
    results = {name: _compare(log_measured - np.log(light)) for name, light in lights.items()}
    misfit = {name: result[0] for name, result in results.items()}
    lowest = min(misfit.values())
    weight = {name: float(np.exp(-0.5 * (value - lowest))) for name, value in misfit.items()}
    likelihood = {name: value / sum(weight.values()) for name, value in weight.items()}
    best = max(lights, key=lambda name: likelihood[name])
    residual = {name: result[2] for name, result in results.items()}
    confidence = float(likelihood[best] * np.exp(-0.5 * (residual[best] / _MISFIT_SCALE) ** 2))
    return WaterComparison(best, confidence, residual, likelihood, np.exp(results[best][1]))


def _level_light(
    name: JerlovType, up: Array, depth_m: float, sensor: Sensor | None, refractive_index: float
) -> tuple[Array, Array]:
    """Return a type's radiance (r, 3) and the attenuation (3,) [1/m] of its downwelling irradiance at a depth."""
    medium = Medium(
        Water.jerlov(name), sensor, "table", depth_m, band_count=_BAND_COUNT, refractive_index=refractive_index
    )
    light = medium.light.display(medium.model.radiance(depth_m, up))
    log = medium.light.ambient_log(np.array([0.95, 1.05]) * depth_m)
    return light, (log[0] - log[1]) / (0.1 * depth_m)


def _compare(difference: Array) -> tuple[float, Array, float]:
    """Return misfit (twice the negative log likelihood), log gain (3,) and rms of a logarithmic difference (r, 3).

    The mean over channels is the exposure, which is free. The deviation of a channel from it is the white balance,
    which adds to the misfit.
    """
    rows = len(difference)
    share = _INDEPENDENT_ROWS / rows / _ROW_SIGMA**2
    mean = difference.mean(axis=0)
    exposure = mean.mean()
    balance = (mean - exposure) * (rows * share) / (rows * share + 1.0 / _BALANCE_SIGMA**2)
    left = difference - exposure - balance
    misfit = share * np.sum(left**2) + np.sum(balance**2) / _BALANCE_SIGMA**2
    return float(misfit), exposure + balance, float(np.sqrt(np.mean(left**2)))


Frame = TypeVar("Frame")
Fitted = TypeVar("Fitted")


def resampled(fit: Callable[[list[Frame]], Fitted], frames: Sequence[Frame], draws: int, seed: int) -> list[Fitted]:
    """Return what a fit gives of so many draws of as many frames, with replacement: the bootstrap (Efron 1979).

    Raises `ParameterError` without frames.
    """
    whole("draws", draws, 2, 1_000_000)
    if not len(frames):
        raise ParameterError("frames - must hold one or more (got none) - give the frames of a clip")
    drawn = np.random.default_rng([seed, 0xB007]).integers(0, len(frames), (draws, len(frames)))
    return [fit([frames[k] for k in row]) for row in drawn]


# --- The gain of the veil -------------------------------------------------------------------------------------------

# Gain of the veil: fitted to a plate's exposure in each frame, then smoothed over a clip.
#
# A change of the camera's exposure multiplies the whole picture in all channels; the gain follows it at once. Changes
# in a part of the picture, as of animals that pass, are followed slowly and only if they last.
#
# Over a clip it is measured a few times a second. Between two measured frames that show the same at the same exposure,
# those in between are taken to lie on the way; where exposure or picture change, all of them are measured, so that
# steps and cuts are found to the frame.


_TINY = 1e-300
"""Least radiance that is divided by: far below the light of any depth."""
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

    def add(self, frame: Frame, index: int) -> None:
        """Add the next frame, of an index in the clip; that alone says which frames are measured, after the first."""
        if self._last is not None and index % self._step:
            self._waiting.append(frame)
            return
        here = self._measure(frame)
        if self._waiting and self._last is not None:
            last, count = self._last, len(self._waiting) + 1
            moved = picture_change(last.shown, here.shown)
            if moved > UNCHANGED or exposure_change(last.shown, here.shown) != 0.0:
                self._measure_waiting()
            else:
                for share in np.arange(1, count) / count:
                    gain = (1.0 - share) * last.gain + share * here.gain
                    self._append(gain, (1.0 - share) * last.residual + share * here.residual, (0.0, moved / count))
                self._append(here.gain, here.residual, (0.0, moved / count))
                self._last, self._waiting = here, []
                return
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
