# SPDX-License-Identifier: Apache-2.0
"""Stages of one frame, from the plate to the composite, for videos, stills, library calls and previews alike."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.grading.plate_grade import PlateGrade
from mr360uw.composite.over import mean_layer, over_tile
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Shot
from mr360uw.errors import RenderError
from mr360uw.render.backends import Backend
from mr360uw.render.exposed_water import exposed_water
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight, light_key, plate_light
from mr360uw.render.plate_pattern import pattern_key, plate_pattern
from mr360uw.render.shots import instants, layer_key, seen_by, shafts_of, shot_at, with_caustics, with_snow
from mr360uw.render.stages.eye_stage import Eye, calm_of, eyes_of
from mr360uw.render.stages.match_stage import asked_look, ungraded, with_look
from mr360uw.render.stages.surface_stage import with_surface
from mr360uw.types import CausticStack, Layer, MediumTable
from mr360uw.video import VideoFrame

if TYPE_CHECKING:
    from mr360uw.composite.shafts.shaft_light import ShaftLight

T = TypeVar("T")


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


Stages = Generator[None, None, Frame]
"""Stages of a frame: each `next` runs one of the three and stops where another thread may continue."""


def frame_stages(
    loaded: Loaded,
    facts: ClipAnalysis,
    backend: Backend,
    plate: VideoFrame,
    shutter_s: float,
    *,
    variables: bool = False,
    kept: Cache | None = None,
    light: FrameLight | None = None,
) -> Stages:
    """Compute a frame from what is loaded, the clip's facts and the plate's frame alone; return it.

    shutter_s: exposure time [s], for motion blur. light: between knots of a clip (`stages.light_stage`); None measures
    it in this frame. kept: results of the same backend's frames, each under all that it
    depends on: a stage runs unless its result is there. Yields after the plate's light is measured and after the layer
    is drawn.
    """
    plan, index, time_s = loaded.plan, plate.index, plate.time_s
    now, kept = loaded.at(time_s), Cache(loaded.scene.plate.eyes) if kept is None else kept
    grain, filed = now.scene.draw.grain, plate
    plate = ungraded(now, facts.look, filed, kept)
    eyes = eyes_of(now.scene, plate)
    patterns: list[PlatePattern | None] = [None for _ in eyes]
    water = None
    drawn: list[list[Drawn]] = [[] for _ in eyes]
    if plan.environment.runs:
        if light is None:
            of_light = light_key(now, facts, plate)
            light = kept.get("light", of_light, lambda: finite("light", index, plate_light(now, facts, plate)))
        patterns = [_pattern(now, facts, eye, kept) for eye in eyes]
    yield  # from here on the thread of the backend

    if light is not None and plan.layer.runs:
        of_water = now.surroundings, light, time_s
        water = kept.get("water", of_water, lambda: finite("water", index, exposed_water(*of_water)))
        moments = instants(loaded, now, time_s, shutter_s)
        for instant_s, then in moments:
            bare = shot_at(then, light, water, instant_s, index, kept)
            for eye, pattern, layers in zip(eyes, patterns, drawn, strict=True):
                shot = seen_by(then, bare, eye, pattern, index)
                layers.append(_layer(then, backend, shot, instant_s, shutter_s / len(moments), index, variables, kept))
    yield  # from here on any thread, beside the next frame

    frames = []
    for eye, layers in zip(eyes, drawn, strict=True):
        layer = mean_layer([one.layer for one in layers]) if layers else Layer(loaded.height, loaded.width, ())
        look = asked_look(now, facts.look, filed, layer, kept)  # of the left eye for both
        frames.append(_composited(eye.plate, layers, layer, look, light, water, grain, kept))
    return frames[0] if len(frames) == 1 else both_eyes(*frames)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What an eye sees of one instant: the shot, its layer and, if asked for, the layer's output variables."""

    shot: Shot
    layer: Layer
    variables: Aovs | None


def _layer(
    loaded: Loaded,
    backend: Backend,
    bare: Shot,
    instant_s: float,
    exposure_s: float,
    index: int,
    variables: bool,
    kept: Cache,
) -> Drawn:
    """Return the layer of a shot without caustics, with all that the plan asks for."""
    shot = with_caustics(loaded, backend, bare, instant_s, kept)
    shafts = shafts_of(loaded, backend, shot, instant_s, kept)
    make = partial(_drawn, backend, shot, shafts, index, variables, kept)
    layer, found = kept.get("layer", layer_key(shot, shafts, variables), make)
    layer, found = with_surface(loaded, backend, shot, layer, found, instant_s, kept)
    return Drawn(shot, with_snow(loaded, backend, shot, layer, instant_s, exposure_s, kept), found)


def _pattern(loaded: Loaded, facts: ClipAnalysis, eye: Eye, kept: Cache) -> PlatePattern | None:
    calm = calm_of(facts.calm, eye)
    key = pattern_key(loaded, calm, eye.plate)
    return kept.get("pattern", key, lambda: plate_pattern(loaded, calm, eye.plate, kept))


def _composited(
    plate: VideoFrame,
    drawn: list[Drawn],
    layer: Layer,
    look: PlateGrade,
    light: FrameLight | None,
    water: MediumTable | None,
    grain: float,
    kept: Cache,
) -> Frame:
    """Return the frame of one eye from what it sees at every instant of the exposure; layer: the mean of that."""
    of_picture = plate, tuple(one.layer for one in drawn), grain, look
    layer = kept.get("match", of_picture, partial(with_look, layer, look, plate))
    picture = kept.get(
        "picture", of_picture, lambda: finite("composite", plate.index, plate.over(layer, over_tile, grain))
    )
    if not drawn:
        return Frame(picture, plate, layer, light, water)
    last = drawn[-1]
    return Frame(picture, plate, layer, light, water, last.shot.caustics, last.variables)


def both_eyes(left: Frame, right: Frame) -> Frame:
    """Return the frame of the left eye with that of the right one."""
    return replace(left, picture=replace(left.picture, right=right.picture), right=right)


def _drawn(
    backend: Backend, shot: Shot, shafts: ShaftLight | None, index: int, variables: bool, kept: Cache
) -> tuple[Layer, Aovs | None]:
    layer, found = backend.layer(shot, variables=variables)
    if shafts is not None:
        from mr360uw.composite.shafts.shaft_layer import with_shafts

        layer, found = with_shafts(shot, shafts, layer, found, kept)
    return finite("layer", index, layer), found


def finite(stage: str, index: int, result: T) -> T:
    """Return a stage's result; raise `RenderError` if an array of floats in it has a NaN or an infinity.

    Distances may. result: a dataclass or a tuple, which may hold others. Sums are tested first: 13 ms for a layer that
    covers all of 3840 x 1920.
    """
    if isinstance(result, tuple):
        for part in result:
            finite(stage, index, part)
        return result
    for field in fields(result) if is_dataclass(result) else ():
        values = getattr(result, field.name)
        if is_dataclass(values) or isinstance(values, tuple):
            finite(stage, index, values)
        if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or field.name == "distance_m":
            continue
        with np.errstate(all="ignore"):
            total = values.sum()
        if not np.isfinite(total) and not np.all(np.isfinite(values)):
            bad = int(np.sum(~np.isfinite(values)))
            raise RenderError(
                f"frame {index} - the {stage} has numbers that are not finite (got {bad} of {values.size} in "
                f"{field.name}) - please report it with the scene file"
            )
    return result


def finished(stages: Stages) -> Frame:
    """Run the remaining stages of a frame and return it."""
    while True:
        try:
            next(stages)
        except StopIteration as end:
            frame: Frame = end.value
            return frame
