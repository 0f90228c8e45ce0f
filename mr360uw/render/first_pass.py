# SPDX-License-Identifier: Apache-2.0
"""The first pass over a clip: the track of its sun, the gain of its water's veil, and the ground without its
caustics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, Parts
from mr360uw.base.color import LUMINANCE, luminance
from mr360uw.base.constants import CLIPPED_LIGHT
from mr360uw.base.progress import Progress, one_blas_thread, prefetch
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.composite.grading.settings import PlateGrade
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Receiver
from mr360uw.errors import DamagedFrameError, SceneError
from mr360uw.ibl import SunMeasurement, SunTrack, load_track, measure_sun, track_suns
from mr360uw.ibl.sun.track import SunSeries
from mr360uw.medium import Medium
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, unscattered_share
from mr360uw.medium.open_water import OpenWater, OpenWaterLooks, OpenWaterTrack
from mr360uw.medium.scattered_light import spread_of
from mr360uw.medium.veil_gain import DOUBTFUL, GainSeries, MeasuredGain, fit_level
from mr360uw.plot import Figure, Shown
from mr360uw.render.lights import direct_to_diffuse, level_view, may_be_clipped, plate_map, restored, small_picture
from mr360uw.render.loaded import Loaded
from mr360uw.render.match_stage import clip_colour, clip_grade
from mr360uw.render.mattes import ReceiverClip
from mr360uw.render.surroundings import Surroundings
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import without_gain
from mr360uw.types import BeamSpread, Environment, Floats, MediumTable, Rectangle, Sun
from mr360uw.video import VideoFrame, VideoReader
from mr360uw.video.reader import Grade

MARGIN_S = 10.0
"""Time [s] on either side of the frames asked for that is measured too: several times what the sun and the gain are
smoothed over (2 to 4 s). Twice as large, the first pass of a short range takes twice as long."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ClipAnalysis(Parts, Shown):
    """Measurements over a clip, or over a range of it with a margin: a frame looks the same in every run over these.

    Sun and gain that are fitted to each frame alone change from frame to frame; here they are followed over the clip.
    The gain holds for the water and the depth of the scene: after a change of these, analyse again.

    Parameters
    ----------
    sun : SunTrack or Sun or "none" or None
        Track of the sun, or one that is the same in every frame, in the world; "none" for no sun, None if it is
        detected frame by frame.
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

    sun: SunTrack | Sun | Literal["none"] | None = None
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
        fixed: Sun | Literal["none"] | None = None if isinstance(sun, str) else sun or "none"
        return cls(fixed, None if gain is None else np.asarray(gain)[None])

    def sun_at(self, index: int) -> Sun | Literal["scene"] | None:
        """Return the sun of frame `index`, None if its shot has none; "scene" if there is no track."""
        if isinstance(self.sun, SunTrack):
            return self.sun.at(index - self.first)
        return "scene" if self.sun is None else self.sun if isinstance(self.sun, Sun) else None

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


class _Series(Protocol):
    """Measurements in some of the frames of a clip."""

    def due(self, index: int) -> bool:
        """Return whether frame `index` of the clip is measured."""


_PASSED = 8
"""Frames that are kept after they were read late: those of an eighth of a second at 60 a second, which gain and sun are
measured in, one after the other."""


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
        # Frames that the pass went by are read where light changes about them, and from then on all are
        self._reads_all, self._passed = False, lru_cache(maxsize=_PASSED)(self._read_passed)
        self._onwards, self._reached = iter(tuple[VideoFrame]()), -1

    def over(self, begin: int, end: int | None, progress: Progress | None) -> ClipAnalysis:
        """Return the analysis of frames [begin, end)."""
        # Stop early where nothing is measured but what stands still
        background, rate, measures = self._background, float(self._video.frame_rate), self._measures
        if not measures and end is not None:
            end = min(end, begin + FRAMES)
        if background is not None:
            background.clear()
        # Go through the frames once, and give each to all that measure
        suns, gains, looks = SunSeries(self.sun, rate), GainSeries(self._level, rate), OpenWaterLooks(rate)
        with one_blas_thread():
            for frame in prefetch(self._frames(begin, end, (suns, gains, looks))):
                if "gain" in measures:
                    gains.add(frame, frame.index)
                    if "open_water" in measures and looks.due(frame.index):
                        looks.add(frame.index, self.open_water(self._whole(frame)))
                if "sun" in measures:
                    suns.add(frame, frame.index, frame.time_s)
                if background is not None and background.due(frame.index):
                    background.add(self._whole(frame))
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

    def _frames(self, begin: int, end: int | None, series: tuple[_Series, ...]) -> Iterator[VideoFrame]:
        """Yield frames [begin, end), of which those that are not due in any of the series may lack their codes."""
        if end is None:
            yield from (one.graded_by(self._grade) for one in self._video.frames(begin))
            return
        series = series if self._background is None else (*series, self._background)
        # The first frame is measured, and each of those after the last that is due
        last = max((index for index in range(begin, end) if series[0].due(index)), default=begin)

        def chosen(index: int) -> bool:
            return not begin < index <= last or self._reads_all or any(one.due(index) for one in series)

        yield from (one.graded_by(self._grade) for one in self._video.sampled(begin, end, chosen))

    def _whole(self, frame: VideoFrame) -> VideoFrame:
        """Return a frame with its codes."""
        return frame if frame.is_read else self._passed(frame.index)

    def _read_passed(self, index: int) -> VideoFrame:
        """Return a frame that the pass went by, read with those that follow it."""
        self._reads_all = True
        if index != self._reached:
            self._onwards = self._video.frames(index, self._video.frame_count)
        self._reached = index + 1
        return next(self._onwards).graded_by(self._grade)

    def open_water(self, frame: VideoFrame) -> OpenWater:
        """Return the open water of a frame whose gain is fitted."""
        now, sun = self._now(frame.time_s), self._light(frame).sun
        return now.open_water(frame, self._water(frame), self._level(frame).gain, sun)

    def sun(self, frame: VideoFrame) -> SunMeasurement:
        """Return the sun of a frame, with the light that its water lets be known."""
        frame, now = self._whole(frame), self._now(frame.time_s)
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
        return self._now(frame.time_s).light.of(self._whole(frame).pixels, time_s=frame.time_s)

    def _fit(self, frame: VideoFrame) -> MeasuredGain:
        medium, up, pixels = self._water(frame), self._camera.at(frame.time_s)[1][1], self._whole(frame).pixels
        gain, residual = fit_level(medium, level_view(pixels, up))
        return MeasuredGain(gain, residual, plate_map(pixels, up))

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


# --- The ground without its caustics --------------------------------------------------------------------------------

# The plate's own caustics in a frame, as shadows on the receiver take them away.
#
# Where the camera stands, the clip's mean is the plate without caustics. Where it moves, or of a single picture, detail
# of the size of caustics is smoothed, by the fraction of its variance that the scene's own sea explains.


FRAMES = 240
"""Frames that the mean of a clip is taken over, from the first that is read on: ten seconds, many periods of waves."""
_EVERY = 4
"""Frames between those that are read: a sixth of a second, in which caustics move by their own width."""
_LEAST_FRAMES = 8
"""Frames below which a mean still shows the caustics themselves; if the camera moves in them, none is taken."""
_MEASURED = 3
"""Frames whose detail is measured: its variance is that of thousands of filaments in each."""
_COLUMNS = 512
_ROWS = 32
_SHIFT = 2
_GROUPS = 4
"""Successive groups of frames; where the camera stands, the mean of each lies best on the mean of the others without a
shift. By chance that happens once in 25^4. Means show a fainter ground under stronger caustics than single frames."""
_DETAIL_ROWS = (0.6, 0.9)
"""Part of the frame's height over which the detail of the ground is measured: 18 to 72 degrees below the horizon."""


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The ground of a clip in the mean light of its waves.

    mean: (rows, W, 3) float16 of the plate's last rows, those that can show the ground; None where the camera moves or
    there is one picture. strength: fraction of the variance of the ground's detail that is caustics, for smoothing
    instead; 1 where no picture is smoothed.
    """

    mean: Floats | None
    strength: float


class BackgroundSeries:
    """Collects the first frames of a clip, or of a range.

    height_m: of the camera above the ground. contrast: standard deviation over mean of the light on the ground that the
    scene's sea makes. sky: fraction of a frame's rows, from the top, that cannot show the ground.
    """

    def __init__(self, height_m: float, contrast: float, sky: float = 0.0) -> None:
        self._height_m, self._contrast, self._sky = height_m, contrast, sky
        self.clear()

    def clear(self) -> None:
        """Forget all frames; the next one is the first."""
        self._first: int | None = None
        self._sum: NDArray[np.float32] | None = None
        self._held: list[VideoFrame] = []
        self._small: list[Floats] = []
        self._measured: list[VideoFrame] = []

    def due(self, index: int) -> bool:
        """Return whether frame `index` of the clip counts, which is so of the first."""
        place = 0 if self._first is None else index - self._first
        return place < FRAMES and place % _EVERY == 0

    def add(self, frame: VideoFrame) -> None:
        """Take a frame in, where it is one of those that count."""
        if not self.due(frame.index):
            return
        self._first = frame.index if self._first is None else self._first
        if len(self._measured) < _MEASURED:
            self._measured.append(replace(frame))  # without what was worked out from its codes
        if len(self._small) >= _LEAST_FRAMES and self._sum is None:
            return  # the camera moves, and no mean is of use
        self._small.append(_without_its_blur(frame))
        self._held.append(replace(frame))
        if len(self._small) == _LEAST_FRAMES and stands(self._small):
            height, width = frame.shape
            self._sum = np.zeros((height - int(self._sky * height), width, 3), np.float32)
        if self._sum is not None:
            for held in self._held:
                _add_light(held, self._sum)
        if len(self._small) >= _LEAST_FRAMES:
            self._held = []

    def result(self) -> Background:
        """Return what the frames show; without any, that nothing is caustics."""
        if not self._measured:
            return Background(None, 0.0)
        mean, strength = None, 1.0
        if self._sum is not None and stands(self._small):
            mean = (self._sum / np.float32(len(self._small))).astype(np.float16)
        if mean is None or self._measured[0].right is not None:  # the mean is of the left eye's pictures
            variance = float(np.mean([self._detail(frame) for frame in self._measured]))
            strength = min(1.0, self._contrast**2 / max(variance, 1e-9))
        return Background(mean, strength)

    def _detail(self, frame: VideoFrame) -> float:
        """Return the variance of the ground's detail over its smooth light."""
        import cv2

        height, width = frame.shape
        first, last = (int(part * height) for part in _DETAIL_ROWS)
        last = max(last, first + 1)
        light = PlatePattern(frame, None, self._height_m, 1.0).light(Rectangle(0, first, width, last - first))
        shown, background = (cv2.transform(one, LUMINANCE[None]) for one in light)
        return float(np.var(shown / np.maximum(background, 1e-3), dtype=np.float64))


def _without_its_blur(frame: VideoFrame) -> Floats:
    """Return the luminance (h, w) of a small picture of a frame below the horizon, less its own blur."""
    import cv2

    size = (_COLUMNS, _COLUMNS // 2)
    small = cv2.resize(small_picture(frame.pixels), size, interpolation=cv2.INTER_AREA)
    below = luminance(small[_COLUMNS // 4 :]).astype(np.float32)
    return np.asarray(below - cv2.GaussianBlur(below, (0, 0), 4.0))


def _add_light(frame: VideoFrame, total: NDArray[np.float32]) -> None:
    """Add the linear light of a frame's last rows to a sum (rows, W, 3), some at a time, which stay in the cache."""
    height, width = frame.shape
    first = height - len(total)
    for row in range(first, height, _ROWS):
        part = Rectangle(0, row, width, min(_ROWS, height - row))
        total[row - first : row - first + part.height] += frame.linear(part)


def stands(pictures: list[Floats]) -> bool:
    """Return whether small pictures (h, w), less their own blur, show one scene from one place.

    The mean of each group of them is laid over the mean of the others at shifts of up to two pixels; where it fits best
    without one, nothing has moved.
    """
    groups = [
        np.sum(pictures[k * len(pictures) // _GROUPS : (k + 1) * len(pictures) // _GROUPS], axis=0)
        for k in range(_GROUPS)
    ]
    total = np.sum(groups, axis=0)
    shifts = [(j, i) for j in range(-_SHIFT, _SHIFT + 1) for i in range(-_SHIFT, _SHIFT + 1)]
    inside = slice(_SHIFT, -_SHIFT)
    for group in groups:
        others = total - group
        fits = [float(np.vdot(np.roll(group, shift, (0, 1))[inside], others[inside])) for shift in shifts]
        if shifts[int(np.argmax(fits))] != (0, 0):
            return False
    return True


_TYPICAL_HEIGHT_M = 2.0
"""Height of the camera above ground that a distance map gives."""
_LEAST_HEIGHT_M = 0.2
_TYPICAL_SUN = (0.5, math.sqrt(0.75), 0.0)
"""Direction of a sun 60 degrees high in the air, for the contrast of the caustics that a sea makes: at 35 degrees it is
larger by 5 to 25 % between 4 and 8 m of depth."""


def background_series(loaded: Loaded) -> BackgroundSeries | None:
    """Return what collects a clip's ground without caustics; None where the plan leaves its caustics alone."""
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    # A level camera sees a level floor, which lies below it, in the lower half of its frames
    camera, settings = loaded.surroundings.camera, loaded.scene.receiver
    level = camera.track is None and camera.tilt is None and loaded.plate_depth is None
    sky = 0.5 if level and settings is not None and settings.kind == "plane" else 0.0
    return BackgroundSeries(*_on_ground(loaded, loaded.receiver, Cache()), sky)


def _on_ground(loaded: Loaded, receiver: ReceiverClip, cache: Cache) -> tuple[float, float]:
    """Return the camera's height [m] above the ground, and the contrast of the light that the scene's sea makes there.

    cache: holds the contrast.
    """
    scene, medium, height_m = loaded.scene, loaded.surroundings.medium, _height_above(receiver.at(0), loaded)
    assert medium is not None
    contrast = cache.of(
        _expected_contrast, scene.sea, _resolution(scene), scene.water.refractive_index, medium.unit_table,
        spread_of(medium), scene.camera.depth_m + height_m,
    )  # fmt: skip
    return height_m, contrast


def plate_pattern(
    loaded: Loaded, background: Background | None, plate: VideoFrame, cache: Cache
) -> PlatePattern | None:
    """Return the pattern of a plate's frame on the receiver; None where the plan has none.

    background: of the clip; None finds it in this frame alone. cache: keeps the contrast of the scene's own caustics,
    which is the same for all frames.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    if background is None:
        background = cache.of(_background_of_frame, *_on_ground(loaded, loaded.receiver, cache), plate)
    height_m = _height_above(loaded.receiver.at(plate.index), loaded)
    coded = not plate.spec.is_wide and (plate.rgb is None or plate.rgb.dtype.kind == "u")
    white = CLIPPED_LIGHT if coded else np.inf
    return cache.of(PlatePattern, plate, background.mean, height_m, background.strength, white)


def _background_of_frame(height_m: float, contrast: float, plate: VideoFrame) -> Background:
    """Return the ground without caustics of a frame by itself."""
    series = BackgroundSeries(height_m, contrast)
    series.add(plate)
    return series.result()


def waves_of(scene: Scene) -> tuple[object, ...]:
    """Return the settings that the contrast of the caustics on the ground depends on."""
    return scene.sea, scene.camera.depth_m, without_gain(scene.water), _resolution(scene)


def _resolution(scene: Scene) -> CausticSettings:
    """Return the settings of the map that the contrast is taken from: the default ones, coarser where the scene's are.

    A map of 256 x 256 from a grid of 96 has a contrast lower by 0.6 % than one of 512 x 512 from 256.
    """
    settings = CausticSettings()
    return settings.model_copy(update={"size": min(settings.size, scene.caustics.size), "grid": scene.caustics.grid})


def _height_above(receiver: Receiver, loaded: Loaded) -> float:
    """Return about how high [m] the camera is above a receiver at the start of the clip."""
    camera_y = float(loaded.view(0.0).position[1])
    if receiver.plane_y is not None:
        below = camera_y - receiver.plane_y
    elif receiver.mesh is not None:
        below = camera_y - float(receiver.mesh[..., 1].mean())
    else:
        below = _TYPICAL_HEIGHT_M
    return max(abs(below), _LEAST_HEIGHT_M)


def _expected_contrast(
    sea: Sea, settings: CausticSettings, index: float, table: MediumTable, spread: BeamSpread | None, depth_m: float
) -> float:
    """Return the standard deviation over mean of the light that a sea throws on the ground at a depth."""
    at = np.array([depth_m])
    stack = caustic_stack(sea, _TYPICAL_SUN, at, 0.0, settings, index, spread)
    up = float(stack.sun_direction[1])
    direct = direct_to_diffuse(table) * beam_ratio(table, at, up) / ambient_ratio(table, at)
    sharp = float(luminance(unscattered_share(table, at, up))[0])
    pattern = sharp * stack.ratio[0, ..., 1] + (0.0 if stack.soft is None else (1.0 - sharp) * stack.soft[0, ..., 0])
    return float(pattern.std() * luminance(direct / (1.0 + direct))[0])
