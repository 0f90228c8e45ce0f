# SPDX-License-Identifier: Apache-2.0
"""One frame, from the plate to the composite: the one way for videos, stills, library calls and previews."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

from mr360uw.composite.aovs import Aovs
from mr360uw.composite.over import mean_layer, over_tile
from mr360uw.render.backends import Backend
from mr360uw.render.exposed_water import exposed_water
from mr360uw.render.first_pass import ClipFacts
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight, plate_light
from mr360uw.render.shots import shot_at, shutter_times, with_caustics
from mr360uw.types import Layer, MediumTable
from mr360uw.video import VideoFrame


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One composited frame and everything it was made from; what the scene does not need is None.

    picture: the plate with the layer over it. caustics: of the last instant, in the backend's own form. variables: the
    layer's output variables, which have no motion blur, where they were asked for.
    """

    picture: VideoFrame
    plate: VideoFrame
    layer: Layer
    light: FrameLight | None = None
    medium: MediumTable | None = None
    caustics: Any = None
    variables: Aovs | None = None


Stages = Generator[None, None, Frame]
"""A frame in the making: `next` takes it to where another thread may go on, the last one ends it."""


def frame_stages(
    loaded: Loaded, facts: ClipFacts, backend: Backend, plate: VideoFrame, shutter_s: float, *, variables: bool = False
) -> Stages:
    """Make a frame, a function of what is loaded, the clip's facts and the plate's frame alone.

    shutter_s: how long the shutter is open [s]. Pauses once the plate's light is read, and once the layer is drawn.
    """
    plan, water, found, layers = loaded.plan, None, None, []
    light = plate_light(loaded, facts, plate) if plan.environment.runs else None
    shot = None
    yield  # what follows belongs to the thread of the backend

    if light is not None and plan.layer.runs:
        water = exposed_water(loaded.surroundings, light, plate.time_s)
        for time_s in shutter_times(loaded, plate.time_s, shutter_s):
            shot = with_caustics(loaded, backend, shot_at(loaded, light, water, time_s, plate.index), time_s)
            layer, found = backend.layer(shot, variables=variables)
            layers.append(layer)
    layer = mean_layer(layers) if layers else Layer(loaded.height, loaded.width, ())
    yield  # what follows may go on beside the next frame

    picture = plate.over(layer, over_tile, loaded.scene.draw.grain)
    return Frame(picture, plate, layer, light, water, None if shot is None else shot.caustics, found)


def finished(stages: Stages) -> Frame:
    """Run a frame's stages to their end and return it."""
    while True:
        try:
            next(stages)
        except StopIteration as end:
            frame: Frame = end.value
            return frame
