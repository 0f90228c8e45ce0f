# SPDX-License-Identifier: Apache-2.0
"""The first pass over a clip: the track of its sun and the gain of its water's veil."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.errors import SceneError
from mr360uw.ibl import SunMeasurement, SunTrack, load_track, measure_sun, track_suns
from mr360uw.medium import Medium, exposure_change, picture_change, steady_gain
from mr360uw.medium.fit.level import DOUBTFUL, LevelView, fit_level
from mr360uw.progress import Progress
from mr360uw.render.calm import FRAMES, CalmPlate, CalmSeries
from mr360uw.render.plate_map import level_view, plate_map
from mr360uw.render.surroundings import Surroundings
from mr360uw.threads import one_blas_thread, prefetch
from mr360uw.types import Floats, Sun
from mr360uw.video import VideoReader


@dataclass(frozen=True, slots=True, eq=False)
class FixedSun:
    """A sun that is the same in every frame; None for no sun."""

    sun: Sun | None

    def at(self, index: int) -> Sun | None:  # noqa: ARG002 - as a `SunTrack` has it
        """Return the sun."""
        return self.sun


@dataclass(frozen=True, slots=True, eq=False)
class ClipFacts:
    """Measurements over a whole clip, which make a frame look the same whatever range is rendered.

    sun: its track, or None if the sun is detected frame by frame. gain: (N, 3) of the veil, or None if it is fitted
    frame by frame. calm: the ground without its caustics, or None if it is found frame by frame. notes: doubts about
    them.
    """

    sun: SunTrack | FixedSun | None = None
    gain: Floats | None = None
    calm: CalmPlate | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def of_frame(cls, sun: Sun | Literal["scene"] | None, gain: Floats | None) -> ClipFacts:
        """Return the facts of a clip of one frame: its sun in the world, None for none, "scene" for the scene's own."""
        return cls(None if isinstance(sun, str) else FixedSun(sun), None if gain is None else np.asarray(gain)[None])

    def sun_at(self, index: int) -> Sun | Literal["scene"] | None:
        """Return the sun of frame `index`, None if its shot has none; "scene" if there is no track."""
        return "scene" if self.sun is None else self.sun.at(index)

    def gain_at(self, index: int) -> Floats | None:
        """Return the veil's gain (3,) of frame `index`, or None; frames after the last take the last."""
        return None if self.gain is None else self.gain[min(index, len(self.gain) - 1)]


def first_pass(
    surroundings: Surroundings,
    video: VideoReader,
    progress: Progress | None = None,
    *,
    sun: bool = True,
    gain: bool = True,
    calm: CalmSeries | None = None,
) -> ClipFacts:
    """Return the facts of a clip. sun, gain: whether each is measured. calm: collects the ground without caustics.

    The sun is the scene's stored track or measured in a pass over the whole clip, whatever range is rendered; the gain
    is fitted in the same pass. With nothing to measure there is no pass. Raises `SceneError` if the stored track
    belongs to another clip.
    """
    stored = surroundings.scene.light.track
    track = _stored_track(stored, video) if sun and stored is not None else None
    camera, medium = surroundings.camera, surroundings.medium if gain else None
    reads_sun = sun and track is None
    if not reads_sun and medium is None and calm is None:
        return ClipFacts(track)
    whole = reads_sun or medium is not None or video.frame_count is None
    suns: list[SunMeasurement] = []
    maps = _MapSeries()
    with one_blas_thread():
        for frame in prefetch(video.frames(0, None if whole else min(video.frame_count or FRAMES, FRAMES))):
            world_from_camera = camera.at(frame.time_s)[1]
            if reads_sun:
                light = surroundings.light.of(frame.pixels, time_s=frame.time_s)
                suns.append(measure_sun(light, frame.time_s, world_from_camera))
            if medium is not None:
                here = medium.at_depth(camera.depth_at(frame.time_s)) if camera.sinks else medium
                up = world_from_camera[1]
                maps.add(here, level_view(frame.pixels, up), plate_map(frame.pixels, up))
            if calm is not None:
                calm.add(frame)
            if progress is not None:
                progress(frame.index + 1, video.frame_count)
    confidence = surroundings.scene.light.minimum_confidence
    return ClipFacts(
        track_suns(suns, minimum_confidence=confidence, camera=camera.rotation_known) if suns else track,
        maps.gain(float(video.frame_rate)) if medium is not None else None,
        calm.result() if calm is not None else None,
        tuple(filter(None, [maps.doubt()])) if medium is not None else (),
    )


def _stored_track(path: Path, video: VideoReader) -> SunTrack:
    track = load_track(path)
    if len(track) != video.frame_count:
        problem = f"belongs to another clip (got {len(track)} frames for {video.frame_count}) - run mr360uw analyse"
        raise SceneError(str(path), [f"light.track - {problem}"])
    return track


class _MapSeries:
    """Accumulates the gain, exposure change and picture change of successive small maps, which are not kept."""

    def __init__(self) -> None:
        self._gains: list[Floats] = []
        self._residuals: list[float] = []
        self._exposure: list[float] = []
        self._picture: list[float] = []
        self._last: Floats | None = None

    def add(self, medium: Medium, level: LevelView, shown: Floats) -> None:
        before = shown if self._last is None else self._last
        gain, residual = fit_level(medium, level)
        self._gains.append(gain)
        self._residuals.append(residual)
        self._exposure.append(exposure_change(before, shown))
        self._picture.append(picture_change(before, shown))
        self._last = shown

    def gain(self, frame_rate: float) -> Floats:
        """Return the gain (N, 3) of every frame."""
        return steady_gain(self._gains, self._exposure, self._picture, frame_rate)

    def doubt(self) -> str:
        """Return a note if most frames show no open water at the horizon, else ""."""
        residual = float(np.median(self._residuals))
        if residual < DOUBTFUL:
            return ""
        return (
            f"water - its gain is not known: the horizon shows little open water (got a residual of {residual:.2f}) - "
            "set water.gain to three numbers, or check camera.roll_deg and pitch_deg"
        )
