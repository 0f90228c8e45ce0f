# SPDX-License-Identifier: Apache-2.0
"""Stages of one frame, from the plate to the composite, for videos, stills, library calls and previews alike."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from mr360uw.composite.aovs import Aovs
from mr360uw.composite.over import mean_layer, over_tile
from mr360uw.errors import RenderError
from mr360uw.render.backends import Backend
from mr360uw.render.exposed_water import exposed_water
from mr360uw.render.first_pass import ClipFacts
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight, plate_light
from mr360uw.render.shots import instants, shot_at, with_caustics
from mr360uw.types import Layer, MediumTable
from mr360uw.video import VideoFrame


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One composited frame and its intermediate results; stages that the scene does not need are None.

    picture: the plate with the layer over it. caustics: of the last instant, in the backend's own form. variables: the
    layer's output variables if they were asked for; they have no motion blur.
    """

    picture: VideoFrame
    plate: VideoFrame
    layer: Layer
    light: FrameLight | None = None
    medium: MediumTable | None = None
    caustics: Any = None
    variables: Aovs | None = None


Stages = Generator[None, None, Frame]
"""Stages of a frame: each `next` runs one of the three and stops where another thread may continue."""


def frame_stages(
    loaded: Loaded, facts: ClipFacts, backend: Backend, plate: VideoFrame, shutter_s: float, *, variables: bool = False
) -> Stages:
    """Compute a frame from what is loaded, the clip's facts and the plate's frame alone; return it.

    shutter_s: exposure time [s], for motion blur. Yields after the plate's light is measured and after the layer is
    drawn.
    """
    plan, water, found, layers = loaded.plan, None, None, []
    now = loaded.at(plate.time_s)
    light = plate_light(now, facts, plate) if plan.environment.runs else None
    check_finite("light of the plate", plate.index, light and light.environment)
    shot = None
    yield  # from here on the thread of the backend

    if light is not None and plan.layer.runs:
        water = exposed_water(now.surroundings, light, plate.time_s)
        check_finite("water", plate.index, water)
        for time_s, then in instants(loaded, now, plate.time_s, shutter_s):
            shot = with_caustics(then, backend, shot_at(then, light, water, time_s, plate.index), time_s)
            layer, found = backend.layer(shot, variables=variables)
            check_finite("layer", plate.index, *layer.tiles)
            layers.append(layer)
    layer = mean_layer(layers) if layers else Layer(loaded.height, loaded.width, ())
    yield  # from here on any thread, beside the next frame

    picture = plate.over(layer, over_tile, now.scene.draw.grain)
    check_finite("composite", plate.index, picture)
    return Frame(picture, plate, layer, light, water, None if shot is None else shot.caustics, found)


def check_finite(stage: str, index: int, *results: Any) -> None:
    """Raise `RenderError` if an array of floats in a stage's results has a NaN or an infinity; distances may.

    results: dataclasses, which may hold others, or None. Sums are tested first: 13 ms for a layer that covers all of
    3840 x 1920.
    """
    for result in filter(is_dataclass, results):
        for field in fields(result):
            values = getattr(result, field.name)
            if is_dataclass(values):
                check_finite(stage, index, values)
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


def finished(stages: Stages) -> Frame:
    """Run the remaining stages of a frame and return it."""
    while True:
        try:
            next(stages)
        except StopIteration as end:
            frame: Frame = end.value
            return frame
