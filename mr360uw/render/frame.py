# SPDX-License-Identifier: Apache-2.0
"""Stages of one frame, from the plate to the composite, for videos, stills, library calls and previews alike.

Each stage takes all that it needs. `composite_frame` runs them one after the other; over a clip (`runs.job`) each of
the three runs on a thread of its own, ahead of the next stage: what measures a plate and says what is to be drawn, what
draws, and what blends and writes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.over import mean_layer, over_tile
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.errors import RenderError
from mr360uw.render.backends import Backend
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight, exposed_water, plate_light
from mr360uw.render.plate_pattern import Background, plate_pattern
from mr360uw.render.shots import (
    Eye,
    eyes_of,
    instants,
    seen_by,
    shafts_of,
    shot_at,
    with_caustics,
    with_snow,
    with_surface,
)
from mr360uw.render.stages.match_stage import asked_grade, ungraded, with_grade
from mr360uw.types import CausticStack, Floats, Layer, MediumTable, Tile
from mr360uw.video import VideoFrame

if TYPE_CHECKING:
    from mr360uw.composite.receiver.blocks import Prepared
    from mr360uw.composite.shafts import ShaftLight

T = TypeVar("T")


def finite(stage: str, index: int, result: T) -> T:
    """Return a stage's result; raise `RenderError` if `not_finite` finds anything in it."""
    refuse(stage, index, not_finite(result))
    return result


def refuse(stage: str, index: int, found: str) -> None:
    """Raise `RenderError` for the result of a frame in which `not_finite` found something."""
    if found:
        raise RenderError(
            f"frame {index} - the {stage} has numbers that are not finite (got {found}) - please report it with the "
            "scene file"
        )


def not_finite(result: object) -> str:
    """Return where an array of floats in a result has a NaN or an infinity; "" where none has. Distances may.

    result: a dataclass or a tuple, which may hold others. Sums are tested first.
    """
    if isinstance(result, tuple):
        return next(filter(None, map(not_finite, result)), "")
    for field in fields(result) if is_dataclass(result) else ():
        values = getattr(result, field.name)
        if (is_dataclass(values) or isinstance(values, tuple)) and (inner := not_finite(values)):
            return inner
        if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or field.name == "distance_m":
            continue
        with np.errstate(all="ignore"):
            total = values.sum()
        if not np.isfinite(total) and not np.all(np.isfinite(values)):
            return f"{np.sum(~np.isfinite(values))} of {values.size} in {field.name}"
    return ""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One composited frame and its intermediate results; stages that the scene does not need are None.

    picture: the plate with the layer over it. plate: its light is read without its grade. caustics: of the last
    instant. variables: the layer's output variables if they were asked for; they have no motion blur. right: of a
    stereo plate, whose left eye this is, the frame of the right one; `picture` has the right eye's picture too.
    """

    picture: VideoFrame
    plate: VideoFrame
    layer: Layer
    light: FrameLight | None = None
    medium: MediumTable | None = None
    caustics: CausticStack | None = None
    variables: Aovs | None = None
    right: Frame | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlate:
    """What a frame's plate shows.

    now: the scene at the frame's time. filed: the plate with its grade. eyes: its pictures without it. light: None
    where nothing is lit. receivers: in each eye's picture. patterns: the plate's own caustics there, None where there
    is no shadow.
    """

    now: Loaded
    filed: VideoFrame
    eyes: tuple[Eye, ...]
    light: FrameLight | None
    receivers: tuple[Receiver | None, ...]
    patterns: tuple[PlatePattern | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """What an eye sees at one instant of a frame's exposure: the shot, and its shafts, None where there are none.

    time_s: of the instant [s]. now: the scene then. exposure_s: that it stands for. prepared: of `Backend.prepare`.
    """

    time_s: float
    now: Loaded
    shot: Shot
    shafts: ShaftLight | None
    exposure_s: float
    prepared: Prepared | None


@dataclass(frozen=True, slots=True, eq=False)
class FrameShots:
    """What is to be drawn for a frame. water: None without any. by_eye: for each eye the instants of the exposure."""

    measured: MeasuredPlate
    water: MediumTable | None
    by_eye: tuple[tuple[Instant, ...], ...]


Drawn = tuple[Shot, Layer, Aovs | None]
"""What an eye sees of one instant: the shot, its layer and, if asked for, the layer's output variables."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnFrame:
    """What is drawn for a frame. by_eye: for each eye what it sees of every instant of the exposure."""

    measured: MeasuredPlate
    water: MediumTable | None
    by_eye: tuple[tuple[Drawn, ...], ...]


def composite_frame(
    loaded: Loaded,
    analysis: ClipAnalysis,
    backend: Backend,
    plate: VideoFrame,
    shutter_s: float,
    *,
    variables: bool = False,
    cache: Cache | None = None,
    light: FrameLight | None = None,
) -> Frame:
    """Return a frame, a function of what is loaded, the clip's analysis and the plate's frame alone.

    shutter_s: exposure time [s], for motion blur. variables: whether the layer's output variables are asked for.
    light: between light samples of a clip (`stages.light_stage`); None measures it in this frame. cache: results of the
    same backend's frames: a stage runs unless its result is there.
    """
    cache = Cache(loaded.scene.plate.eyes) if cache is None else cache
    measured = measure_plate(loaded, analysis, plate, cache, light)
    shots = frame_shots(loaded, backend, measured, shutter_s, cache)
    drawn = draw_frame(backend, shots, cache, variables=variables)
    return blend_frame(loaded, analysis, drawn, cache)


def measure_plate(
    loaded: Loaded, analysis: ClipAnalysis, filed: VideoFrame, cache: Cache, light: FrameLight | None = None
) -> MeasuredPlate:
    """Return the light and the pattern of a plate's frame, on any thread."""
    now = loaded.at(filed.time_s)
    plate = ungraded(now, analysis.grade, filed, cache)
    eyes = eyes_of(now.scene, plate)
    if not loaded.plan.environment.runs:
        nothing = tuple(None for _ in eyes)
        return MeasuredPlate(now, filed, eyes, light, nothing, nothing)
    if light is None:
        light = finite("light", plate.index, plate_light(now, analysis, plate, cache))
    receivers, patterns = [], []
    for eye in eyes:
        receivers.append(now.receiver_at(plate.index, plate.time_s, eye.number, eye.eye_m))
        background = analysis.background
        if background is not None and eye.eye_m:  # the mean is of the left eye's pictures
            background = Background(None, background.strength)
        patterns.append(plate_pattern(now, background, eye.plate, cache))
    return MeasuredPlate(now, filed, eyes, light, tuple(receivers), tuple(patterns))


def frame_shots(
    loaded: Loaded, backend: Backend, measured: MeasuredPlate, shutter_s: float, cache: Cache
) -> FrameShots:
    """Return what is to be drawn for a frame, with its water, caustics and shafts, on any thread."""
    now, light = measured.now, measured.light
    index, time_s = measured.filed.index, measured.filed.time_s
    if light is None or not loaded.plan.layer.runs:
        return FrameShots(measured, None, tuple(() for _ in measured.eyes))
    water = finite("water", index, cache.of(exposed_water, now.surroundings, light, time_s))
    moments = instants(loaded, now, time_s, shutter_s)
    by_eye: list[list[Instant]] = [[] for _ in measured.eyes]
    for instant_s, then in moments:
        bare = shot_at(then, light, water, instant_s, index, cache)
        of_eyes = zip(measured.eyes, measured.receivers, measured.patterns, by_eye, strict=True)
        for eye, receiver, pattern, seen in of_eyes:
            shot = seen_by(then, bare, eye, receiver, pattern, index)
            shot = with_caustics(then, backend, shot, instant_s, cache)
            shafts = shafts_of(then, backend, shot, instant_s, cache)
            prepared = cache.of(backend.prepare, shot, cache, keep=2)
            seen.append(Instant(instant_s, then, shot, shafts, shutter_s / len(moments), prepared))
    return FrameShots(measured, water, tuple(map(tuple, by_eye)))


def draw_frame(backend: Backend, shots: FrameShots, cache: Cache, *, variables: bool = False) -> DrawnFrame:
    """Return the layers of a frame, on the thread of its backend."""
    by_eye = []
    for instants_seen in shots.by_eye:
        drawn = []
        for at in instants_seen:
            layer, found = cache.of(draw_layer, backend, at.shot, at.prepared, at.shafts, variables, cache)
            layer, found = with_surface(at.now, backend, at.shot, layer, found, at.time_s, cache)
            layer, found = with_snow(at.now, backend, at.shot, layer, found, at.time_s, at.exposure_s, cache)
            drawn.append((at.shot, layer, found))
        by_eye.append(tuple(drawn))
    return DrawnFrame(shots.measured, shots.water, tuple(by_eye))


def blend_frame(loaded: Loaded, analysis: ClipAnalysis, drawn: DrawnFrame, cache: Cache) -> Frame:
    """Return the composite of what was drawn and the plate, on any thread, beside the next frame."""
    measured, frames = drawn.measured, []
    for eye, instants_drawn in zip(measured.eyes, drawn.by_eye, strict=True):
        layers = [layer for _, layer, _ in instants_drawn]
        layer = mean_layer(layers) if layers else Layer(loaded.height, loaded.width, ())
        look = asked_grade(measured.now, analysis.grade, measured.filed, layer, cache)  # of the left eye for both
        layer = cache.of(with_grade, layer, look, eye.plate)
        picture = cache.of(lay_over, eye.plate, layer, measured.now.scene.draw.grain)
        frame = Frame(picture, eye.plate, layer, measured.light, drawn.water)
        if instants_drawn:
            shot, _, variables = instants_drawn[-1]
            frame = replace(frame, caustics=shot.caustics, variables=variables)
        frames.append(frame)
    if len(frames) == 1:
        return frames[0]
    left, right = frames
    return replace(left, picture=replace(left.picture, right=right.picture), right=right)


def draw_layer(
    backend: Backend, shot: Shot, prepared: Prepared | None, shafts: ShaftLight | None, variables: bool, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return the layer of a shot, with its shafts, and its output variables if asked for."""
    layer, found = backend.layer(shot, prepared, variables=variables)
    if shafts is not None:
        from mr360uw.composite.shafts import with_shafts

        layer, found = with_shafts(shot, shafts, layer, found, cache)
    return layer, found


def lay_over(plate: VideoFrame, layer: Layer, grain: float) -> VideoFrame:
    """Return a plate with a layer over it. grain: of the plate, as a fraction, that bodies are given."""
    return plate.over(layer, partial(_finite_over, plate.index), grain)


def _finite_over(index: int, plate_linear: Floats, tile: Tile) -> Floats:
    """Return `over_tile`; raise `RenderError` where a number is not finite."""
    image = over_tile(plate_linear, tile)
    with np.errstate(all="ignore"):
        total = image.sum()
    if not np.isfinite(total) and not np.all(np.isfinite(image)):
        refuse("layer", index, not_finite(tile))
        refuse("composite", index, f"{np.sum(~np.isfinite(image))} of {image.size} in a tile")
    return image
