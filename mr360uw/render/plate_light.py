# SPDX-License-Identifier: Apache-2.0
"""Light of a plate's frame: environment, sun, and the small map or gain that its water's veil is matched to."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

from mr360uw.cache import Same
from mr360uw.composite.shot import BetweenKnots
from mr360uw.medium import Medium
from mr360uw.medium.fit.level import DOUBTFUL, fit_level
from mr360uw.render.first_pass import ClipFacts
from mr360uw.render.lights import may_be_clipped, restored
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_map import level_view, plate_map
from mr360uw.types import Environment, Floats
from mr360uw.video import VideoFrame


@dataclass(frozen=True, slots=True, eq=False)
class FrameLight:
    """The light of one frame.

    environment: in camera axes. plate_map: (32, 64, 3) means of the plate, not expanded, levelled, or None if the water
    does not need it. gain: (3,) of the veil, from a clip's track or from this frame; None where it is not fitted.
    knots: in world axes, see `Shot`; None where the frame's own light is measured and no other.
    """

    environment: Environment
    plate_map: Floats | None = None
    gain: Floats | None = None
    knots: BetweenKnots | None = None


def plate_light(loaded: Loaded, facts: ClipFacts, plate: VideoFrame) -> FrameLight:
    """Return the light of a plate's frame. Quantities that the clip's facts do not hold are measured in this frame."""
    surroundings, plan, water = loaded.surroundings, loaded.plan, loaded.scene.water
    sun = facts.sun_at(plate.index) if plan.sun.runs else None
    found = surroundings.light.of(plate.pixels, sun, time_s=plate.time_s, glossy=plan.glossy.runs)
    world_from_camera = surroundings.camera.at(plate.time_s)[1]
    medium, shown, gain = surroundings.medium_at(plate.time_s), None, None
    if medium is not None and water.mode == "plate":
        shown = plate_map(plate.pixels, world_from_camera[1])
    elif medium is not None:
        up = world_from_camera[1]
        gain, known = _gain(facts, plate, medium, up) if water.fits_gain else (None, True)
        if known and may_be_clipped(plate.pixels, surroundings.settings):
            scaled = medium if gain is None else medium.scaled(gain)
            found = restored(found, scaled, up, keep_sun=not isinstance(sun, str))
    return FrameLight(found, shown, gain)


def _gain(facts: ClipFacts, plate: VideoFrame, medium: Medium, up: Floats) -> tuple[Floats, bool]:
    """Return the gain (3,) of a frame's veil and whether open water shows it."""
    gain = facts.gain_at(plate.index)
    if gain is not None:
        return gain, not facts.notes
    fitted, residual = fit_level(medium, level_view(plate.pixels, up))
    return fitted, residual < DOUBTFUL


def light_key(loaded: Loaded, facts: ClipFacts, plate: VideoFrame) -> Hashable:
    """Return the key of `plate_light`: all that the light depends on."""
    plan, measured = loaded.plan, (Same(facts.sun), Same(facts.gain), facts.notes, facts.first)
    return plate, loaded.surroundings, measured, plan.sun.runs, plan.glossy.runs
