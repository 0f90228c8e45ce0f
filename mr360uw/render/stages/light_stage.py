# SPDX-License-Identifier: Apache-2.0
"""Light of a clip's frames: measured at samples in time, and interpolated between two that show the same.

A sun that is followed over the clip keeps its own values in every frame. Frames whose light is not between that of the
samples, as about a flash, a step of the exposure or a cut, are measured too: the irradiance of the six faces of a cube
shows it, summed over some of the rows of the plate. Frame k is the same in every run, since samples are numbered from
the start of the clip: a range reads the sample before its first frame and that after its last one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.cache import Cache
from mr360uw.color import code_range, decode_signal
from mr360uw.composite.shot import BetweenSamples, LightSample
from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.errors import DamagedFrameError
from mr360uw.ibl import SunTrack
from mr360uw.ibl.lighting import light_between, sun_between, turned
from mr360uw.medium.fit.exposure import UNCHANGED, picture_change
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import finite
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight, exposed_water, plate_light, plate_ratio
from mr360uw.render.stages.match_stage import ungraded
from mr360uw.scene.keyed_water import scene_at
from mr360uw.sphere import directions, row_solid_angle
from mr360uw.types import Floats, Sun
from mr360uw.types.frames import sample_step
from mr360uw.video import VideoFrame, VideoReader

_WAITING = 1 << 26
"""Pixels of frames that may wait for the next sample, 100 MB of 8-bit 4:2:0: samples are closer in larger plates."""
_DEVIATION, _DARK = 0.01, 0.1
"""Deviation of a face's irradiance from that between the samples up to which light is interpolated, relative to it, or
to a tenth of the brightest face's: one 8-bit code value of a body at most. Twice as large: two of them."""
_SAMPLED_ROWS = 128
"""Rows of a plate that are summed, at least."""
_NORMALS = np.concatenate([np.eye(3), -np.eye(3)])
_SETTINGS = "light", "water", "camera", "match"
"""Tables of a scene that the light of a frame depends on."""
LitFrame = tuple[VideoFrame, FrameLight | None]
"""A plate's frame, and its light; None where it is to be measured in that frame alone."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """A frame whose light was measured. faces: see `_faces`. lit: the light as bodies are lit by it."""

    plate: VideoFrame
    faces: Floats
    light: FrameLight
    lit: LightSample


class LightSamples:
    """Finds the light of the frames of a clip. read: decodes its frames [a, b)."""

    def __init__(
        self,
        loaded: Loaded,
        analysis: ClipAnalysis,
        video: VideoReader,
        read: Callable[[int, int], Iterator[VideoFrame]],
    ) -> None:
        self._loaded, self._analysis, self._read = loaded, analysis, read
        self._end = video.intact_frames or 0
        most = _WAITING // (video.width * video.height * (1 if loaded.scene.plate.eye != "both" else 2))
        self._step = min(sample_step(float(video.frame_rate)), max(most, 1)) if self._tracked(video) else 1

    def frames(self, start: int, stop: int) -> Iterator[LitFrame]:
        """Yield frames start <= index < stop, each with its light. Raises what `read` raises, but in other frames."""
        if self._step == 1:
            yield from ((plate, None) for plate in self._read(start, stop))
            return
        before: _Sampled | None = None
        waiting: list[VideoFrame] = []
        try:
            for plate in self._around(start, stop):
                if not self._is_sample(plate.index):
                    waiting.append(plate)
                    continue
                after = self._measured(plate)
                yield from self._between(before, [one for one in waiting if start <= one.index < stop], after)
                if start <= plate.index < stop:
                    yield plate, self._at(after, after, plate)
                before, waiting = after, []
        except DamagedFrameError:
            yield from ((plate, None) for plate in waiting if start <= plate.index)
            raise
        yield from ((plate, None) for plate in waiting if start <= plate.index < stop)

    def _tracked(self, video: VideoReader) -> bool:
        """Return whether a clip's analysis holds what single frames would be measured for but the environment."""
        loaded, analysis, scene = self._loaded, self._analysis, self._loaded.scene
        if video.is_still or video.intact_frames is None or not loaded.plan.environment.runs:
            return False
        sun = analysis.sun is not None or not loaded.plan.sun.runs or scene.light.sun != "detect"
        return sun and (analysis.gain is not None or not scene.water.fits_gain or loaded.surroundings.medium is None)

    def _is_sample(self, index: int) -> bool:
        return index % self._step == 0 and index < self._end

    def _around(self, start: int, stop: int) -> Iterator[VideoFrame]:
        """Yield the frames of a range, from the sample before it to that after it as far as they can be decoded."""
        step = self._step
        begin, after = start // step * step, -(-(stop - 1) // step) * step
        end = after + 1 if self._is_sample(after) else stop
        while True:
            try:
                yield from self._read(begin, end)
            except DamagedFrameError as error:
                if start <= error.index < stop:
                    raise
                if error.index < start:
                    begin = error.index + 1
                    continue
            return

    def _measured(self, plate: VideoFrame) -> _Sampled:
        now, time_s = self._loaded.at(plate.time_s), plate.time_s
        light: FrameLight = finite("light", plate.index, plate_light(now, self._analysis, self._ungraded(plate)))
        view = now.view(time_s)
        objects = tuple(o.at(time_s, plate.index, view.position, view.world_from_camera) for o in now.objects)
        of_world = turned(light.environment, view.world_from_camera)
        suns = () if of_world.sun is None else (of_world.sun,)
        water = exposed_water(now.surroundings, light, time_s)
        return _Sampled(plate, _faces(plate), light, LightSample(objects, of_world, suns, water, view.position))

    def _ungraded(self, plate: VideoFrame) -> VideoFrame:
        """Return a frame as its light is read."""
        return ungraded(self._loaded.at(plate.time_s), self._analysis.grade, plate, Cache())

    def _between(self, before: _Sampled | None, waiting: list[VideoFrame], after: _Sampled) -> Iterator[LitFrame]:
        """Yield the frames between two samples."""
        if before is None or not self._alike(before, after):
            yield from ((plate, None) for plate in waiting)
            return
        for plate in waiting:
            share = _share(before, after, plate)
            expected = (1.0 - share) * before.faces + share * after.faces
            allowed = _DEVIATION * np.maximum(expected, _DARK * expected.max())
            there = np.all(np.abs(_faces(plate) - expected) <= allowed) and self._settings_alike(before, plate)
            yield plate, self._at(before, after, plate) if there else None

    def _alike(self, before: _Sampled, after: _Sampled) -> bool:
        """Return whether two samples are of one shot, with the same settings and a sun in both or in neither."""
        analysis, (first, last) = self._analysis, (before.plate.index, after.plate.index)
        a, b = before.light.environment, after.light.environment
        if (a.sun is None) != (b.sun is None) or picture_change(a.residual, b.residual) > UNCHANGED:
            return False
        if analysis.sun is not None and any(
            (analysis.sun_at(k) is None) != (a.sun is None) for k in range(first, last + 1)
        ):
            return False
        if isinstance(analysis.sun, SunTrack) and any(
            first < analysis.first + cut <= last for cut in analysis.sun.cuts
        ):
            return False
        return self._settings_alike(before, after.plate)

    def _settings_alike(self, sample: _Sampled, plate: VideoFrame) -> bool:
        """Return whether keys leave the settings that light depends on in a frame what they are in a sample."""
        if not self._loaded.scene.keys:
            return True
        one, other = (scene_at(self._loaded.scene, time_s) for time_s in (sample.plate.time_s, plate.time_s))
        return all(getattr(one, name) == getattr(other, name) for name in _SETTINGS)

    def _at(self, before: _Sampled, after: _Sampled, plate: VideoFrame) -> FrameLight:
        """Return the light of a frame between two samples, or at one that is both."""
        light, share = before.light, _share(before, after, plate)
        between = BetweenSamples(before.lit, after.lit, share) if not self._loaded.scene.keys else None
        if before is after:
            return replace(light, between=between)
        rotation = self._loaded.at(plate.time_s).surroundings.camera.at(plate.time_s)[1]
        sun = self._sun(before, after, plate, share, rotation)
        environment = light_between(light.environment, after.light.environment, share, sun)
        gain = None if light.gain is None else self._analysis.gain_at(plate.index)
        ratio = plate_ratio(
            self._loaded.surroundings_at(plate.time_s), self._analysis, self._ungraded(plate), gain, sun
        )
        return FrameLight(environment, gain, ratio, between)

    def _sun(self, before: _Sampled, after: _Sampled, plate: VideoFrame, share: float, rotation: Floats) -> Sun | None:
        """Return the sun of a frame in its own axes: that of the clip's track, or between those of two samples.

        rotation: (3, 3) of the camera.
        """
        known = self._analysis.sun_at(plate.index)
        a, b = before.light.environment.sun, after.light.environment.sun
        if a is None or b is None:
            return None
        if isinstance(known, Sun):
            return replace(known, direction=known.direction @ rotation)
        return sun_between(a, b, share)


def _share(before: _Sampled, after: _Sampled, plate: VideoFrame) -> float:
    """Return how far a frame is from one sample, 0, to another, 1."""
    step_s = after.plate.time_s - before.plate.time_s
    return (plate.time_s - before.plate.time_s) / step_s if step_s > 0.0 else 0.0


def _faces(plate: VideoFrame) -> Floats:
    """Return the irradiance (6,) of the faces of a cube, of a plate's luma or green, in the light of a small map."""
    import cv2

    if plate.yuv is not None:
        codes = plate.yuv.y
    else:
        assert plate.rgb is not None
        codes = plate.rgb[..., 1]
    skipped = max(len(codes) // _SAMPLED_ROWS, 1)
    rows = np.ascontiguousarray(codes[skipped // 2 :: skipped], np.float32)
    small = np.asarray(cv2.resize(rows, (ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS), interpolation=cv2.INTER_AREA))
    if codes.dtype.kind != "f":
        low, span, _, _ = code_range(plate.spec)
        small = decode_signal((small - low) / span, plate.spec)
    return np.asarray(_face_weights() @ small.ravel())


@functools.cache
def _face_weights() -> Floats:
    """Return the weights (6, pixels) of a map's radiance in the irradiance of a cube's faces."""
    looks = directions(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)
    solid = row_solid_angle(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)[:, None, None]
    return (np.maximum(looks @ _NORMALS.T, 0.0) * solid).reshape(-1, 6).T
