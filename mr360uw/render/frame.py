# SPDX-License-Identifier: Apache-2.0
"""Stages of one frame, from the plate to the composite, for videos, stills, library calls and previews alike."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mr360uw.cache import Cache
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.grading.settings import PlateGrade
from mr360uw.composite.over import mean_layer, over_tile
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Shot
from mr360uw.render.backends import Backend
from mr360uw.render.finite import finite, not_finite, refuse
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight, exposed_water, plate_light
from mr360uw.render.plate_pattern import plate_pattern
from mr360uw.render.shots import instants, seen_by, shafts_of, shot_at, with_caustics, with_snow
from mr360uw.render.stages.eye_stage import calm_of, eyes_of
from mr360uw.render.stages.match_stage import asked_look, ungraded, with_look
from mr360uw.render.stages.surface_stage import with_surface
from mr360uw.types import CausticStack, Layer, MediumTable
from mr360uw.video import VideoFrame

if TYPE_CHECKING:
    from mr360uw.composite.shafts.shaft_light import ShaftLight


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
            light = finite("light", index, plate_light(now, facts, plate, kept))
        patterns = [plate_pattern(now, calm_of(facts.calm, eye), eye.plate, kept) for eye in eyes]
    yield  # from here on the thread of the backend

    if light is not None and plan.layer.runs:
        water = finite("water", index, kept.of(exposed_water, now.surroundings, light, time_s))
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
    layer, found = kept.of(_drawn, backend, shot, shafts, variables, kept)
    refuse("layer", index, kept.of(not_finite, layer))
    layer, found = with_surface(loaded, backend, shot, layer, found, instant_s, kept)
    return Drawn(shot, with_snow(loaded, backend, shot, layer, instant_s, exposure_s, kept), found)


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
    picture = kept.of(_laid_over, plate, kept.of(with_look, layer, look, plate), grain)
    if not drawn:
        return Frame(picture, plate, layer, light, water)
    last = drawn[-1]
    return Frame(picture, plate, layer, light, water, last.shot.caustics, last.variables)


def both_eyes(left: Frame, right: Frame) -> Frame:
    """Return the frame of the left eye with that of the right one."""
    return replace(left, picture=replace(left.picture, right=right.picture), right=right)


def _laid_over(plate: VideoFrame, layer: Layer, grain: float) -> VideoFrame:
    return finite("composite", plate.index, plate.over(layer, over_tile, grain))


def _drawn(
    backend: Backend, shot: Shot, shafts: ShaftLight | None, variables: bool, kept: Cache
) -> tuple[Layer, Aovs | None]:
    layer, found = backend.layer(shot, variables=variables)
    if shafts is not None:
        from mr360uw.composite.shafts.shaft_layer import with_shafts

        layer, found = with_shafts(shot, shafts, layer, found, kept)
    return layer, found


def finished(stages: Stages) -> Frame:
    """Run the remaining stages of a frame and return it."""
    while True:
        try:
            next(stages)
        except StopIteration as end:
            frame: Frame = end.value
            return frame
