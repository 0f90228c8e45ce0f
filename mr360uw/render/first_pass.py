# SPDX-License-Identifier: Apache-2.0
"""The first pass over a clip: the track of its sun and the gain of its water's veil."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.cache import Parts
from mr360uw.composite.grading.settings import PlateGrade
from mr360uw.errors import DamagedFrameError, SceneError
from mr360uw.ibl import SunMeasurement, SunTrack, load_track, measure_sun, track_suns
from mr360uw.ibl.sun.track import SunSeries
from mr360uw.medium import Medium
from mr360uw.medium.exposure import GainSeries, MeasuredGain
from mr360uw.medium.open_water import DOUBTFUL, OpenWater, OpenWaterLooks, OpenWaterTrack, fit_level
from mr360uw.plot import Figure, Shown
from mr360uw.progress import Progress
from mr360uw.render.lights import level_view, may_be_clipped, plate_map, restored
from mr360uw.render.loaded import Loaded
from mr360uw.render.match_stage import clip_colour, clip_grade
from mr360uw.render.plate_pattern import FRAMES, Background, BackgroundSeries, background_series
from mr360uw.render.surroundings import Surroundings
from mr360uw.threads import one_blas_thread, prefetch
from mr360uw.types import Environment, Floats, Sun
from mr360uw.video import VideoFrame, VideoReader
from mr360uw.video.video_frame import Grade

MARGIN_S = 10.0
"""Time [s] on either side of the frames asked for that is measured too: several times what the sun and the gain are
smoothed over (2 to 4 s). Twice as large, the first pass of a short range takes twice as long."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedSun:
    """A sun that is the same in every frame; None for no sun."""

    sun: Sun | None

    def at(self, index: int) -> Sun | None:  # noqa: ARG002 - as a `SunTrack` has it
        """Return the sun."""
        return self.sun


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ClipAnalysis(Parts, Shown):
    """Measurements over a clip, or over a range of it with a margin: a frame looks the same in every run over these.

    Sun and gain that are fitted to each frame alone change from frame to frame; here they are followed over the clip.
    The gain holds for the water and the depth of the scene: after a change of these, analyse again.

    Parameters
    ----------
    sun : SunTrack or FixedSun or None
        Track of the sun, or None if it is detected frame by frame.
    gain : ndarray or None
        Gain (N, 3) of the veil, or None if it is fitted frame by frame.
    background : Background or None
        The ground without its caustics, or None if it is found frame by frame.
    notes : tuple of str
        Doubts about the measurements.
    first : int
        Frame that the track and the gain begin with.
    grade : PlateGrade or None
        Grade of the plate, or None if it is measured frame by frame.
    open_water : OpenWaterTrack or None
        Light of the open water beside the gain, or None if it is looked for frame by frame or not at all.

    See Also
    --------
    uw.analyse_clip : Makes one.
    uw.Compositor : Takes one for its frames.
    uw.plot.show : Draws the gain, or the sun's elevation, by frame.

    Examples
    --------
    >>> analysis = uw.analyse_clip("dive.mp4", scene)
    >>> analysis.gain_at(0).shape
    (3,)
    """

    sun: SunTrack | FixedSun | None = None
    gain: Floats | None = None
    background: Background | None = None
    notes: tuple[str, ...] = ()
    first: int = 0
    grade: PlateGrade | None = None
    open_water: OpenWaterTrack | None = None

    def __repr__(self) -> str:
        names = ("sun", "gain", "background", "grade", "open_water")
        found = [name for name in names if getattr(self, name) is not None]
        frames = "" if self.gain is None else f" of {len(self.gain)} frames"
        return f"<ClipAnalysis{frames} from {self.first}: {', '.join(found) or 'nothing measured'}>"

    def _figure(self) -> Figure:
        if isinstance(self.sun, SunTrack) and self.gain is None:
            elevation = np.degrees(np.arcsin(np.clip(self.sun.direction[:, 1], -1.0, 1.0)))
            return Figure("sun", self.first + np.arange(len(elevation)), {"elevation": elevation}, "frame", "deg")
        gain = np.zeros((0, 3)) if self.gain is None else np.asarray(self.gain)
        curves = dict(zip(("red", "green", "blue"), gain.T, strict=True))
        return Figure("gain of the veil", self.first + np.arange(len(gain)), curves, "frame", "gain")

    @classmethod
    def of_frame(cls, sun: Sun | Literal["scene"] | None, gain: Floats | None) -> ClipAnalysis:
        """Return the analysis of a clip of one frame: its sun in the world, None: none, "scene": the scene's own."""
        return cls(None if isinstance(sun, str) else FixedSun(sun), None if gain is None else np.asarray(gain)[None])

    def sun_at(self, index: int) -> Sun | Literal["scene"] | None:
        """Return the sun of frame `index`, None if its shot has none; "scene" if there is no track."""
        return "scene" if self.sun is None else self.sun.at(index - self.first)

    def gain_at(self, index: int) -> Floats | None:
        """Return the veil's gain (3,) of frame `index`, or None; frames outside the measured ones take the nearest."""
        return None if self.gain is None else self.gain[min(max(index - self.first, 0), len(self.gain) - 1)]


def measured_range(video: VideoReader, start: int, stop: int) -> tuple[int, int]:
    """Return the frames [a, b) that the first pass reads for frames [start, stop): these and a margin on either side.

    The margin ends where the clip ends or, in a file that is cut short, its data.
    """
    margin = math.ceil(MARGIN_S * float(video.frame_rate))
    end = stop if video.intact_frames is None else min(video.intact_frames, stop + margin)
    return max(0, start - margin), max(stop, end)


def clip_analysis(
    loaded: Loaded, video: VideoReader, progress: Progress | None = None, *, frames: tuple[int, int] | None = None
) -> ClipAnalysis:
    """Return what the plan of a scene asks to be measured over its clip, or over frames [a, b); see `first_pass`."""
    plan, background = loaded.plan, None if video.is_still else background_series(loaded)
    gain = plan.track_gain.runs
    wanted = {"sun": plan.track_sun.runs, "gain": gain, "open_water": gain and loaded.scene.water.fits_ratio}
    measures = [name for name, runs in wanted.items() if runs]
    keyed = loaded.surroundings_at if loaded.scene.keys else None
    # A colour that the patches tell is needed before; for all else, frames may have been read by then
    grade = clip_grade(loaded, video) if loaded.scene.match.open_keys else None
    analysis = first_pass(
        loaded.surroundings, video, progress, measures, background=background, frames=frames, keyed=keyed,
        grade=clip_colour(loaded, grade),
    )  # fmt: skip
    return replace(analysis, grade=grade or clip_grade(loaded, video))


def first_pass(
    surroundings: Surroundings,
    video: VideoReader,
    progress: Progress | None = None,
    measures: Collection[str] = ("sun", "gain"),
    *,
    background: BackgroundSeries | None = None,
    frames: tuple[int, int] | None = None,
    keyed: Callable[[float], Surroundings] | None = None,
    grade: Grade | None = None,
) -> ClipAnalysis:
    """Return the analysis of a clip, or of its frames [a, b).

    measures: of "sun", "gain" and, beside a gain, "open_water". background: collects the ground without caustics.
    frames: are read with a margin on either side (`measured_range`), which ends at a frame that cannot be decoded;
    default: the whole clip. keyed: the surroundings at a time [s], where the scene has keys. grade: that the plate's
    light is read without.

    The sun is the scene's stored track or measured; the gain is fitted in the same pass. With nothing to measure there
    is no pass. Raises `SceneError` if the stored track belongs to another clip, `VideoError`.
    """
    stored = surroundings.settings.track
    track = _stored_track(stored, video) if "sun" in measures and stored is not None else None
    wanted = set(measures) - ({"sun"} if track is not None else set())
    wanted -= {"gain", "open_water"} if surroundings.medium is None else set()
    if not wanted and background is None:
        return ClipAnalysis(track)
    measured = _Pass(surroundings, video, wanted, background, keyed, grade)
    begin, end = (0, video.frame_count) if frames is None else measured_range(video, *frames)
    while True:
        try:
            analysis = measured.over(begin, end, progress)
        except DamagedFrameError as error:
            if frames is None or frames[0] <= error.index < frames[1]:
                raise
            begin, end = (error.index + 1, end) if error.index < frames[0] else (begin, error.index)
            continue
        return analysis if track is None else replace(analysis, sun=track.since(begin))


class _Pass:
    """A pass over a clip, and what it measures in single frames; see `first_pass`."""

    def __init__(
        self,
        surroundings: Surroundings,
        video: VideoReader,
        measures: Collection[str],
        background: BackgroundSeries | None,
        keyed: Callable[[float], Surroundings] | None,
        grade: Grade | None,
    ) -> None:
        self._camera, self._now = surroundings.camera, keyed or (lambda _: surroundings)
        self._video, self._measures, self._background, self._grade = video, measures, background, grade
        self._level, self._light = lru_cache(maxsize=1)(self._fit), lru_cache(maxsize=1)(self._read)

    def over(self, begin: int, end: int | None, progress: Progress | None) -> ClipAnalysis:
        """Return the analysis of frames [begin, end)."""
        # Stop early where nothing is measured but what stands still
        background, rate, measures = self._background, float(self._video.frame_rate), self._measures
        if not measures and end is not None:
            end = min(end, begin + FRAMES)
        if background is not None:
            background.clear()
        # Go through the frames once, and give each to all that measure
        suns, gains, looks = SunSeries(self.sun, rate), GainSeries(self.gain, rate), OpenWaterLooks(rate)
        with one_blas_thread():
            for frame in prefetch(one.graded_by(self._grade) for one in self._video.frames(begin, end)):
                if "gain" in measures:
                    gains.add(frame, frame.index)
                    if "open_water" in measures and looks.due(frame.index):
                        looks.add(frame.index, self.open_water(frame))
                if "sun" in measures:
                    suns.add(frame, frame.index, frame.time_s)
                if background is not None:
                    background.add(frame)
                if progress is not None:
                    progress(frame.index + 1 - begin, None if end is None else end - begin)
        # Smooth over the clip what was measured frame by frame
        steady = gains.steady() if "gain" in measures else None
        return ClipAnalysis(
            track_suns(suns.every(), camera=self._camera.rotation_known) if "sun" in measures else None,
            steady,
            background.result() if background is not None else None,
            tuple(filter(None, [_doubt(gains.residuals)])) if "gain" in measures else (),
            begin,
            open_water=None if steady is None else looks.track(steady, begin, gains.cuts()),
        )

    def gain(self, frame: VideoFrame) -> MeasuredGain:
        """Return the gain of a frame's water, which there is."""
        return self._level(frame)

    def open_water(self, frame: VideoFrame) -> OpenWater:
        """Return the open water of a frame whose gain is fitted."""
        now, sun = self._now(frame.time_s), self._light(frame).sun
        return now.open_water(frame, self._water(frame), self._level(frame).gain, sun)

    def sun(self, frame: VideoFrame) -> SunMeasurement:
        """Return the sun of a frame, with the light that its water lets be known."""
        now = self._now(frame.time_s)
        world_from_camera = self._camera.at(frame.time_s)[1]
        light = self._light(frame)
        if now.medium is not None and may_be_clipped(frame.pixels, now.settings):
            medium, known = now.medium_at(frame.time_s), True  # whose tables the frames are drawn with
            assert medium is not None
            if "gain" in self._measures:
                level = self._level(frame)
                medium, known = medium.scaled(level.gain), level.residual < DOUBTFUL
            if known:
                light = restored(light, medium, world_from_camera[1], keep_sun=False)
        return measure_sun(light, frame.time_s, world_from_camera)

    def _read(self, frame: VideoFrame) -> Environment:
        """Return the light of a frame as the plate shows it."""
        return self._now(frame.time_s).light.of(frame.pixels, time_s=frame.time_s)

    def _fit(self, frame: VideoFrame) -> MeasuredGain:
        medium, up = self._water(frame), self._camera.at(frame.time_s)[1][1]
        gain, residual = fit_level(medium, level_view(frame.pixels, up))
        return MeasuredGain(gain, residual, plate_map(frame.pixels, up))

    def _water(self, frame: VideoFrame) -> Medium:
        """Return the water at the camera's depth in a frame, with the gain of the scene; there is some."""
        medium = self._now(frame.time_s).medium
        assert medium is not None
        return medium.at_depth(self._camera.depth_at(frame.time_s)) if self._camera.sinks else medium


def _stored_track(path: Path, video: VideoReader) -> SunTrack:
    track = load_track(path)
    if len(track) != video.frame_count:
        problem = f"belongs to another clip (got {len(track)} frames for {video.frame_count}) - run mr360uw analyse"
        raise SceneError(str(path), [f"light.track - {problem}"])
    return track


def _doubt(residuals: list[float]) -> str:
    """Return a note if most frames show no open water at the horizon, else ""."""
    residual = float(np.median(residuals))
    if residual < DOUBTFUL:
        return ""
    return (
        f"water - its gain is not known: the horizon shows little open water (got a residual of {residual:.2f}) - "
        "set water.gain to three numbers, or check camera.roll_deg and pitch_deg"
    )
