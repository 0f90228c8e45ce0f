# SPDX-License-Identifier: Apache-2.0
"""Light of the frames of a plate: environment, sun, and what its water's veil is matched to: a gain, and open water.

Over a clip it is measured at samples in time (`LightSamples`), and interpolated between two that show the same. A sun
that is followed over the clip keeps its own values in every frame. Frames whose light is not between that of the
samples, as about a flash, a step of the exposure or a cut, are measured too: the irradiance of the six faces of a cube
shows it, summed over some of the rows of the plate. Frame k is the same in every run, since samples are numbered from
the start of the clip: a range reads the sample before its first frame and that after its last one.

The frame's medium table has its veil matched to the plate and its ambient light going on from what the plate shows at
the camera (`medium.ambient`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.color import code_range, decode_signal
from mr360uw.base.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, MINIMUM_SUN_UP
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.composite.shot import BetweenSamples, Shot
from mr360uw.errors import DamagedFrameError
from mr360uw.ibl import SunTrack
from mr360uw.ibl.lighting import light_between, sun_between, turned
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium import Medium
from mr360uw.medium.open_water import beside_floor, row_up, visible_gain
from mr360uw.medium.scattered_light import ambient_parts
from mr360uw.medium.veil_gain import DOUBTFUL, UNCHANGED, fit_level, picture_change
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.lights import level_view, lit_as_its_ground, may_be_clipped, restored
from mr360uw.render.loaded import Loaded
from mr360uw.render.match_stage import ungraded
from mr360uw.render.surroundings import Surroundings
from mr360uw.scene.resolved import scene_at
from mr360uw.types import Environment, Floats, MediumTable, Sun, sample_step
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


@dataclass(frozen=True, slots=True, eq=False)
class FrameLight:
    """The light of one frame.

    environment: in camera axes. gain: (3,) of the veil, from a clip's track or from this frame; None where it is not
    fitted. plate_ratio: of the veil to the plate's open water, see `MediumTable`; None where it is not asked for.
    between: in world axes, see `Shot`; None where the frame's own light is measured and no other.
    """

    environment: Environment
    gain: Floats | None = None
    plate_ratio: Floats | None = None
    between: BetweenSamples | None = None


LitFrame = tuple[VideoFrame, FrameLight | None]
"""A plate's frame, and its light; None where it is to be measured in that frame alone."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """A frame whose light was measured. faces: see `_faces`. lit: the light as bodies are lit by it."""

    plate: VideoFrame
    faces: Floats
    light: FrameLight
    lit: Shot


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
        """Return whether a frame's light is measured: of every so many, and of the last one of the clip."""
        return index < self._end and (index % self._step == 0 or index == self._end - 1)

    def _around(self, start: int, stop: int) -> Iterator[VideoFrame]:
        """Yield the frames of a range, from the sample before it to that after it as far as they can be decoded."""
        step = self._step
        begin, after = start // step * step, min(-(-(stop - 1) // step) * step, max(self._end, stop) - 1)
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
        light, view = plate_light(now, self._analysis, self._ungraded(plate)), now.view(time_s)
        objects = tuple(o.at(time_s, plate.index, view.position, view.world_from_camera) for o in now.objects)
        of_world = turned(light.environment, view.world_from_camera)
        suns = () if of_world.sun is None else (of_world.sun,)
        water = exposed_water(now.surroundings, light, time_s)
        return _Sampled(plate, _faces(plate), light, Shot(view, objects, of_world, suns, water))

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
        # The sun of the clip's track, or between those of the samples, in the frame's own axes
        now, known, sun = self._loaded.surroundings_at(plate.time_s), self._analysis.sun_at(plate.index), None
        a, b = light.environment.sun, after.light.environment.sun
        if a is not None and b is not None:
            sun = sun_between(a, b, share)
            if isinstance(known, Sun):
                sun = replace(known, direction=known.direction @ now.camera.at(plate.time_s)[1])
        environment = light_between(light.environment, after.light.environment, share, sun)
        gain = None if light.gain is None else self._analysis.gain_at(plate.index)
        ratio = plate_ratio(now, self._analysis, self._ungraded(plate), gain, sun)
        return FrameLight(environment, gain, ratio, between)


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


def exposed_water(surroundings: Surroundings, light: FrameLight, time_s: float) -> MediumTable | None:
    """Return the table of the water at a time, matched to the light of a frame; None without water.

    Between two samples in time below water it is between theirs, but for the plate's own open water. Solving it anew
    takes 30 ms where the camera sinks or rises.
    """
    # Between two samples: what they have, with what this plate itself shows of its open water
    if light.between is not None:
        before, after = light.between.before.medium, light.between.after.medium
        if before is not None and after is not None and min(before.camera_depth_m, after.camera_depth_m) > 0.0:
            mixed: dict[str, Any] = {} if light.plate_ratio is None else {"plate_ratio": light.plate_ratio}
            for field in fields(MediumTable):
                one, other, share = getattr(before, field.name), getattr(after, field.name), light.between.share
                if field.name not in mixed and one is not other and one is not None and other is not None:
                    value = (1.0 - share) * one + share * other
                    mixed[field.name] = value.astype(np.float32) if isinstance(one, np.ndarray) else value
            return replace(before, **mixed)
    medium = surroundings.medium_at(time_s)
    if medium is None:
        return None
    # Ambient light by what the plate shows from above and below
    up, environment = surroundings.camera.at(time_s)[1][1], light.environment
    sun = environment.sun
    upwards = environment_lookup(environment.ambient, -up)
    sun_up = 1.0 if sun is None else max(float(sun.direction @ up), MINIMUM_SUN_UP)
    diffuse, floor = ambient_parts(
        medium,
        down=environment_lookup(environment.ambient, up),
        up=upwards,
        sun=np.zeros(3) if sun is None else sun.irradiance,
        sun_up=sun_up,
    )
    # The veil as strong as the plate's, over the floor that it was fitted with
    if light.gain is not None:
        medium = medium.scaled(light.gain if light.plate_ratio is None else visible_gain(medium, light.gain))
    if light.plate_ratio is not None:  # which was found over this floor
        floor = medium.floor_seen(medium.gain, upwards)
    table, ratio = medium.lit_by_floor(floor).table, light.plate_ratio
    if ratio is None:
        ratio = surroundings.around_sun(time_s, medium, sun, fitted=light.gain is not None)
        if ratio is not None:
            of_floor = medium.far_light(row_up(len(ratio)), medium.gain, floor)[1]
            ratio = beside_floor(ratio, of_floor).astype(np.float32)
    table = replace(table, diffuse=diffuse.astype(np.float32), plate_ratio=ratio)
    return table if sun is None else medium.along_sun(table, sun_up)


def plate_light(loaded: Loaded, analysis: ClipAnalysis, plate: VideoFrame, cache: Cache | None = None) -> FrameLight:
    """Return the light of a plate's frame. What the clip's analysis does not hold is measured in this frame.

    cache: holds the light of the last frame.
    """
    plan, of_light = loaded.plan, replace(analysis, background=None, grade=None)
    cache = Cache() if cache is None else cache
    return cache.of(_plate_light, loaded.surroundings, of_light, plate, plan.sun.runs, plan.glossy.runs)


def held_light(light: FrameLight, surroundings: Surroundings, analysis: ClipAnalysis, plate: VideoFrame) -> FrameLight:
    """Return the light of a plate's frame that was found in other water, with the veil's gain alone found again."""
    medium, gain = surroundings.medium_at(plate.time_s), None
    if medium is not None and surroundings.water.fits_gain:
        gain, _ = _gain(analysis, plate, medium, surroundings.camera.at(plate.time_s)[1][1])
    return replace(light, gain=gain, plate_ratio=None if gain is None else light.plate_ratio)


def _plate_light(
    surroundings: Surroundings, analysis: ClipAnalysis, plate: VideoFrame, has_sun: bool, glossy: bool
) -> FrameLight:
    sun = analysis.sun_at(plate.index) if has_sun else None
    found = surroundings.light.of(plate.pixels, sun, time_s=plate.time_s, glossy=glossy)
    world_from_camera = surroundings.camera.at(plate.time_s)[1]
    medium, gain = surroundings.medium_at(plate.time_s), None
    clipped = may_be_clipped(plate.pixels, surroundings.settings)
    if medium is not None:
        up = world_from_camera[1]
        gain, known = _gain(analysis, plate, medium, up) if surroundings.water.fits_gain else (None, True)
        if known and clipped:
            scaled = medium if gain is None else medium.scaled(gain)
            found = restored(found, scaled, up, keep_sun=not isinstance(sun, str))
    if clipped:
        found = lit_as_its_ground(found, world_from_camera[1])
    return FrameLight(found, gain, plate_ratio(surroundings, analysis, plate, gain, found.sun))


def plate_ratio(
    surroundings: Surroundings, analysis: ClipAnalysis, plate: VideoFrame, gain: Floats | None, sun: Sun | None
) -> Floats | None:
    """Return the ratio of a plate's open water to a veil of a gain, from the clip's track or from this frame.

    None where the scene does not ask for it. sun: of the frame, in camera axes.
    """
    medium = surroundings.medium_at(plate.time_s)
    if medium is None or gain is None or not surroundings.water.fits_ratio:
        return None
    tracked = None if analysis.open_water is None else analysis.open_water.ratio_at(plate.index)
    if tracked is not None:
        return tracked
    return surroundings.open_water(plate, medium, gain, sun).ratio(gain)


def _gain(analysis: ClipAnalysis, plate: VideoFrame, medium: Medium, up: Floats) -> tuple[Floats, bool]:
    """Return the gain (3,) of a frame's veil and whether open water shows it."""
    gain = analysis.gain_at(plate.index)
    if gain is not None:
        return gain, not analysis.notes
    fitted, residual = fit_level(medium, level_view(plate.pixels, up))
    return fitted, residual < DOUBTFUL
