# SPDX-License-Identifier: Apache-2.0
"""The sun's track over a clip: measured frame by frame, cut into shots, made steady, interpolated where it is hidden.

The sun does not move in seconds. Where the camera's rotation is known it is one direction in the world; where only its
tilt is, one elevation at least. Otherwise the camera is taken to stand, unless the measurements wander by more than
waves move them; then their path is followed slowly (`steady`).

The track belongs to the whole clip. It is made once, kept beside the scene (`save_track`), may be edited there, and
is looked up by frame, so that any frame range renders the same.

A few frames a second are measured (`SunSeries`): waves move the sun with periods of seconds. Between two measured
frames that show the same, those in between are taken to lie on the way; where the picture changes, all of them are
measured, so that cuts are found to the frame.

A track's file is one table, JSON (columns) or CSV (a line a frame), to plot and edit. Angles are in degrees, in level
axes: azimuth 0 = centre of the frame, + = right; elevation + = up. An empty cell (null) means no sun. Editing
`azimuth_deg`, `elevation_deg` or `irradiance_*` changes what is rendered; the `raw_` columns are the measurements.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Generic, Literal, TypeVar

import numpy as np

from mr360uw.base.color import luminance
from mr360uw.base.files import check_outputs, write_whole
from mr360uw.base.input_files import json_of, read_text
from mr360uw.base.parameters import checked, exactly, numbers
from mr360uw.base.sphere import direction_from_angles
from mr360uw.errors import ParameterError
from mr360uw.ibl.sun.spots import taken_share
from mr360uw.types import Array, Environment, Floats, Sun, sample_step

_MEDIAN = 5
"""Frames on either side whose median direction a jump is judged by; shorter disturbances are no cut."""
_JUMP_RAD = np.radians(6.0)
"""Least change [rad] of the sun's direction that is a cut, where there are no pictures to compare."""
PICTURE_CHANGE = 0.25
"""Least change of the thumbnail that is a cut: mean |change of log luminance| between frames, exposure left out."""
_FORGET_FRAMES = 30.0
"""Frames without a measured sun over which the confidence falls by 1/e."""


@dataclass(frozen=True, slots=True)
class SunMeasurement:
    """Measurement of one frame: its sun or None, its exposure (log-mean luminance), and a thumbnail to find cuts by.

    thumbnail: (8, 16) log luminance less its mean, or None.
    """

    time_s: float
    sun: Sun | None
    exposure: float = 1.0
    thumbnail: Floats | None = None


@checked
def measure_sun(environment: Environment, time_s: float, world_from_camera: Floats | None = None) -> SunMeasurement:
    """Return the measurement of a frame from its environment.

    world_from_camera: rotation (3, 3) that levels the frame, so that a tilting camera does not move the sun.
    """
    sun = environment.sun
    if sun is not None and world_from_camera is not None:
        rotation = exactly("world_from_camera", world_from_camera, (3, 3))
        sun = replace(sun, direction=rotation @ sun.direction)
    value = np.log(np.maximum(luminance(environment.residual), 1e-4))
    thumbnail = value.reshape(8, 4, 16, 4).mean(axis=(1, 3))
    exposure = float(np.exp(thumbnail.mean()))
    return SunMeasurement(time_s, sun, exposure, thumbnail - thumbnail.mean())


@dataclass(frozen=True, slots=True, eq=False)
class SunTrack:
    """The sun of every frame of a clip.

    times_s: (N,). raw_direction, direction: (N, 3) unit, in level axes, measured (NaN where none) and smoothed (NaN in
    a shot that never shows the sun). raw_irradiance, irradiance: (N, 3) linear RGB on a plane facing the sun.
    half_angle_rad: (N,). raw_confidence: (N,) of each frame alone. confidence: (N,) of the smoothed sun. exposure: (N,)
    log-mean luminance. share: (N,) of the smoothed sun, see `Sun`. cuts: first frames of the shots after the first.
    """

    times_s: Array
    raw_direction: Array
    direction: Array
    raw_irradiance: Array
    irradiance: Array
    half_angle_rad: Array
    raw_confidence: Array
    confidence: Array
    exposure: Array
    share: Array
    cuts: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.times_s)

    def at(self, index: int | None = None, *, time_s: float | None = None) -> Sun | None:
        """Return the smoothed sun of frame `index`, or of the frame shown at `time_s`; None where the shot has none.

        Frames before the first and after the last take the nearest.
        """
        if (index is None) == (time_s is None):
            raise ParameterError("track - give either a frame index or time_s - one of them")
        if index is None:
            index = int(np.searchsorted(self.times_s, float(time_s or 0.0) + 1e-6, side="right")) - 1
        k = min(max(index, 0), len(self) - 1)
        if not np.isfinite(self.direction[k, 0]):
            return None
        return Sun(
            self.direction[k].copy(),
            self.irradiance[k].astype(np.float32),
            float(self.half_angle_rad[k]),
            float(self.confidence[k]),
            share=float(self.share[k]),
        )

    def since(self, first: int) -> SunTrack:
        """Return the track from frame `first` on, which becomes its frame 0."""
        arrays = {f.name: getattr(self, f.name)[first:] for f in fields(self) if f.name != "cuts"}
        return SunTrack(**arrays, cuts=tuple(cut - first for cut in self.cuts if cut > first))


@checked
def track_suns(
    measurements: Sequence[SunMeasurement | Sun | None],
    times_s: Sequence[float] | None = None,
    *,
    camera: Camera = "unknown",
) -> SunTrack:
    """Return the track of a whole clip from one measurement per frame, in order.

    camera: what is known of its rotation, from which the measurements come in world axes: "tracked", all of it, in
    one take without cuts; "levelled", its tilt but not its heading; "unknown", nothing.
    Suns or None may stand in for measurements; then `times_s` are their times (default: 30 frames a second) and cuts
    show only in the sun's direction. Frames count by the share of their sun that is taken; those of none are
    bridged.
    """
    # Take suns as measurements, at ascending times
    frames = [m if isinstance(m, SunMeasurement) else SunMeasurement(k / 30.0, m) for k, m in enumerate(measurements)]
    if not frames:
        raise ParameterError("track - needs at least one frame (got none) - measure some frames first")
    count = len(frames)
    times = numbers("times_s", [f.time_s for f in frames] if times_s is None else times_s).astype(np.float64)
    if times.shape != (count,) or not np.all(np.diff(times) > 0.0):
        raise ParameterError(f"times_s - one for every frame, ascending (got shape {times.shape}) - sort the frames")
    # Line up what frames tell; those without a sun are left NaN and weigh nothing
    direction, irradiance = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    half_angle, confidence, share = np.full(count, np.nan), np.zeros(count), np.ones(count)
    for k, frame in enumerate(frames):
        if frame.sun is not None:
            direction[k], irradiance[k] = frame.sun.direction, frame.sun.irradiance
            half_angle[k], confidence[k] = frame.sun.half_angle_rad, frame.sun.confidence
            share[k] = frame.sun.share
    weight = confidence * [taken_share(c) for c in confidence]
    # Smooth each shot by itself
    cuts = () if camera == "tracked" else find_cuts(direction, weight, [f.thumbnail for f in frames])
    smoothed = [
        _steady_shot(times[a:b], direction[a:b], irradiance[a:b], half_angle[a:b], share[a:b], weight[a:b], camera)
        for a, b in zip((0, *cuts), (*cuts, count), strict=True)
    ]
    steady, light, angle, taken, trust = (np.concatenate([part[k] for part in smoothed]) for k in range(5))
    # Return what was measured beside what was made of it
    exposure = np.array([f.exposure for f in frames])
    return SunTrack(times, direction, steady, irradiance, light, angle, confidence, trust, exposure, taken, cuts)


def _steady_shot(
    times: Array, direction: Array, irradiance: Array, half_angle: Array, share: Array, weight: Array, camera: Camera
) -> tuple[Array, ...]:
    seen = weight > 0.0
    steady = steady_directions(times, direction, weight, camera)
    log_light = np.log(np.maximum(np.where(seen[:, None], irradiance, 1.0), 1e-9))
    step = float(np.median(np.diff(times))) if len(times) > 1 else WAVE_PERIOD_S
    light, part = (
        np.exp(smooth(log, weight, strength_of_period(WAVE_PERIOD_S / step)))
        for log in (log_light, np.log(share)[:, None])
    )
    angle = np.full(len(weight), np.median(half_angle[seen]) if seen.any() else np.nan)
    frame = np.arange(len(weight))
    gap = np.abs(frame[:, None] - frame[seen]).min(axis=1) if seen.any() else np.full(len(weight), np.inf)
    level = float(np.average(weight[seen], weights=weight[seen])) if seen.any() else 0.0
    return steady, light, angle, np.minimum(part[:, 0], 1.0), level * np.exp(-gap / _FORGET_FRAMES)


def find_cuts(direction: Array, weight: Array, thumbnails: Sequence[Floats | None]) -> tuple[int, ...]:
    """Return the first frames of new shots: where the picture changes at once, or else where the sun jumps.

    direction: (N, 3), used where weight (N,) > 0. thumbnails: of every frame, or None.
    """
    count = len(weight)
    if count > 1 and all(t is not None for t in thumbnails):
        change = np.abs(np.diff(np.stack([np.asarray(t) for t in thumbnails]), axis=0)).mean(axis=(1, 2))
        limit = max(PICTURE_CHANGE, 6.0 * float(np.median(change)))
        return tuple(int(k) + 1 for k in np.flatnonzero(change > limit))
    seen = np.flatnonzero(weight > 0.0)
    if len(seen) < 2 * _MEDIAN:
        return ()
    d = direction[seen]
    jump = np.zeros(len(seen))
    for k in range(3, len(seen) - 2):
        before, after = _middle(d[max(k - _MEDIAN, 0) : k]), _middle(d[k : k + _MEDIAN])
        jump[k] = np.arccos(np.clip(before @ after, -1.0, 1.0))
    limit = max(_JUMP_RAD, 4.0 * float(np.median(jump[jump > 0.0])))
    cuts = []
    while jump.max() > limit:
        top = int(jump.argmax())
        low, high = max(top - _MEDIAN, 1), min(top + _MEDIAN + 1, len(seen))
        cuts.append(int(seen[_split(d, low, high)]))
        jump[max(top - 2 * _MEDIAN, 0) : top + 2 * _MEDIAN] = 0.0
    return tuple(sorted(set(cuts)))


def _middle(d: Array) -> Array:
    """Return the unit vector of the component-wise median of directions (n, 3)."""
    m = np.median(d, axis=0)
    return m / max(float(np.linalg.norm(m)), 1e-12)


def _split(d: Array, low: int, high: int) -> int:
    """Return the index in [low, high) that best splits directions (n, 3) into two groups about their medians."""

    def cost(k: int) -> float:
        before, after = d[max(k - 2 * _MEDIAN, 0) : k], d[k : k + 2 * _MEDIAN]
        return float((1.0 - before @ _middle(before)).mean() + (1.0 - after @ _middle(after)).mean())

    return min(range(low, high), key=cost)


Frame = TypeVar("Frame")

_UNCHANGED = 0.5 * PICTURE_CHANGE
"""Change of the thumbnail up to which two measured frames show the same: half of that of a cut."""


class SunSeries(Generic[Frame]):
    """Measurements of successive frames. measure: measures one."""

    def __init__(self, measure: Callable[[Frame], SunMeasurement], frame_rate: float) -> None:
        self._measure, self._step = measure, sample_step(frame_rate)
        self._found: list[SunMeasurement] = []
        self._waiting: list[tuple[Frame, float]] = []

    def due(self, index: int) -> bool:
        """Return whether frame `index` of the clip is measured; that depends on the index alone."""
        return index % self._step == 0

    def add(self, frame: Frame, index: int, time_s: float) -> None:
        """Add the next frame, of an index in the clip, shown at a time [s].

        Measured are the first, those that are due, and all where the picture changes.
        """
        if self._found and not self.due(index):
            self._waiting.append((frame, time_s))
            return
        here = self._measure(frame)
        if self._waiting:
            change = np.abs(np.asarray(here.thumbnail) - np.asarray(self._found[-1].thumbnail))
            if float(np.mean(change)) > _UNCHANGED:
                self._measure_waiting()
        before = self._found[-1] if self._found else here
        self._found += [_between(before, here, passed_s) for _, passed_s in self._waiting]
        self._found.append(here)
        self._waiting = []

    def every(self) -> list[SunMeasurement]:
        """Return one measurement for each frame; those on the way between two have no sun of their own."""
        self._measure_waiting()
        return self._found

    def _measure_waiting(self) -> None:
        self._found += [self._measure(frame) for frame, _ in self._waiting]
        self._waiting = []


def _between(a: SunMeasurement, b: SunMeasurement, time_s: float) -> SunMeasurement:
    """Return what a frame between two measured ones would show, without its sun."""
    share = (time_s - a.time_s) / (b.time_s - a.time_s)
    exposure = a.exposure ** (1.0 - share) * b.exposure**share
    thumbnail = (1.0 - share) * np.asarray(a.thumbnail) + share * np.asarray(b.thumbnail)
    return SunMeasurement(time_s, None, exposure, thumbnail)


_FORMAT = "mr360uw sun track 1"
_LIGHT = ("red", "green", "blue")
COLUMNS = (
    "frame", "shot", "time_s", "azimuth_deg", "elevation_deg", *(f"irradiance_{c}" for c in _LIGHT), "half_angle_deg",
    "confidence", "raw_azimuth_deg", "raw_elevation_deg", *(f"raw_irradiance_{c}" for c in _LIGHT), "raw_confidence",
    "exposure", "share",
)  # fmt: skip


def angles_deg(direction: Array) -> tuple[Array, Array]:
    """Return azimuths and elevations (n,) [deg] of directions (n, 3)."""
    azimuth = np.degrees(np.arctan2(direction[:, 0], -direction[:, 2]))
    elevation = np.degrees(np.arctan2(direction[:, 1], np.hypot(direction[:, 0], direction[:, 2])))
    return azimuth, elevation


def track_table(track: SunTrack) -> dict[str, list[float | None]]:
    """Return the columns of a track, rounded to 1e-6, None where there is no sun."""
    frame = np.arange(len(track))
    shot = np.searchsorted(np.asarray(track.cuts), frame, side="right")
    columns = (
        frame, shot, track.times_s, *angles_deg(track.direction),
        *track.irradiance.T, np.degrees(track.half_angle_rad), track.confidence, *angles_deg(track.raw_direction),
        *track.raw_irradiance.T, track.raw_confidence, track.exposure, track.share,
    )  # fmt: skip
    return {
        name: [round(float(v), 6) if math.isfinite(v) else None for v in column]
        for name, column in zip(COLUMNS, columns, strict=True)
    }


@checked
def save_track(track: SunTrack, path: str | Path) -> None:
    """Write a track to a file whose name ends in .json or .csv."""
    path = Path(path)
    table = track_table(track)
    if path.suffix == ".json":
        text = json.dumps({"format": _FORMAT, "columns": table}, indent=1)
    elif path.suffix == ".csv":
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(zip(*table.values(), strict=True))
        text = out.getvalue()
    else:
        raise ParameterError(f"{path} - not a name for a track (got {path.suffix!r}) - end it in .json or .csv")
    check_outputs([path], overwrite=True)
    write_whole(path, text + "\n" if path.suffix == ".json" else text)


@checked
def load_track(path: str | Path) -> SunTrack:
    """Return a track from a .json or .csv file that `save_track` wrote, edited or not."""
    path = Path(path)
    text = read_text(path, ParameterError)
    try:
        if path.suffix == ".csv":
            rows = list(csv.DictReader(io.StringIO(text)))
            table = {name: [row[name] for row in rows] for name in (rows[0] if rows else COLUMNS)}
        else:
            table = json_of(text)["columns"]
        whole = {"share": [1.0] * len(table["frame"])}  # earlier files have none
        data = {n: np.array([np.nan if v in (None, "") else float(v) for v in (whole | table)[n]]) for n in COLUMNS}
    except (KeyError, TypeError, ValueError, OverflowError, csv.Error) as error:
        raise ParameterError(
            f"{path} - not a readable sun track (got: {error!s:.120}) - write it with save_track"
        ) from error
    if not len(data["frame"]) or any(len(column) != len(data["frame"]) for column in data.values()):
        raise ParameterError(f"{path} - columns of unequal length or empty - write it with save_track")

    suns: dict[str, Array] = {}
    for of in ("", "raw_"):
        pairs = zip(np.radians(data[f"{of}azimuth_deg"]), np.radians(data[f"{of}elevation_deg"]), strict=True)
        suns[f"{of}direction"] = np.stack([direction_from_angles(azimuth, elevation) for azimuth, elevation in pairs])
        suns[f"{of}irradiance"] = np.stack([data[f"{of}irradiance_{c}"] for c in _LIGHT], axis=1)
        suns[f"{of}confidence"] = np.nan_to_num(data[f"{of}confidence"])
    cuts = tuple(int(k) + 1 for k in np.flatnonzero(np.diff(data["shot"]) > 0))
    half_angle_rad, share = np.radians(data["half_angle_deg"]), np.nan_to_num(data["share"], nan=1.0)
    return SunTrack(
        times_s=data["time_s"], half_angle_rad=half_angle_rad, exposure=data["exposure"], share=share, cuts=cuts, **suns
    )


# --- One direction for a shot ---------------------------------------------------------------------------------------

# One direction of the sun for a shot, or a slow path where the camera turns.
#
# Waves move what is measured by a degree or two with periods of seconds; the sun stands still. The direction of a shot
# is the middle of its measurements, with outliers weighed down (Student's t). A camera of unknown rotation is taken to
# stand unless the measurements say otherwise: averaged over longer than waves last they leave that middle, the path
# through them is further from it than waves reach, or they drift by more than chance lets waves do. The path is
# smoothed over a wave's period at least.
#
# `smooth` takes a random walk in acceleration plus white noise for its model:
#
#     minimise  sum w_t |x_t - z_t|^2 + lambda sum |third difference of x|^2
#
# (Whittaker 1923). Its solution is that of a Kalman filter run forward and a smoother run backward (Rauch 1965)
# for that random walk; here one banded Cholesky factorisation eliminates forward and
# substitutes backward. Lambda maximises the restricted likelihood, so a still camera is averaged over the whole shot
# and a turning one is followed. Samples of weight 0 are bridged; outliers lose their weight by iteration (Student's t).
# Before the first sample of some weight and after the last the signal stays what it is there: a third-order model would
# leave them along a parabola.


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
