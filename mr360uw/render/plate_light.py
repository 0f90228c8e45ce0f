# SPDX-License-Identifier: Apache-2.0
"""Light of a plate's frame: environment, sun, and what its water's veil is matched to: a gain, and open water.

The frame's medium table has its veil matched to the plate and its ambient light going on from what the plate shows at
the camera (`medium.ambient`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.shot import BetweenSamples
from mr360uw.constants import MINIMUM_SUN_UP
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium import Medium
from mr360uw.medium.ambient import ambient_parts
from mr360uw.medium.fit.level import DOUBTFUL, fit_level
from mr360uw.medium.fit.open_water import beside_floor, visible_gain
from mr360uw.medium.fit.profile import row_up
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.lights import lit_as_its_ground, may_be_clipped, restored
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_map import level_view
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import Environment, Floats, MediumTable, Sun
from mr360uw.video import VideoFrame


def exposed_water(surroundings: Surroundings, light: FrameLight, time_s: float) -> MediumTable | None:
    """Return the table of the water at a time, matched to the light of a frame; None without water.

    Between two samples in time below water it is between theirs, but for the plate's own open water. Solving it anew
    takes 30 ms where the camera sinks or rises.
    """
    # Between two samples: what they have, with what this plate itself shows of its open water
    if light.between is not None:
        before, after = light.between.before.medium, light.between.after.medium
        if before is not None and after is not None and min(before.camera_depth_m, after.camera_depth_m) > 0.0:
            table = table_between(before, after, light.between.share)
            return table if light.plate_ratio is None else replace(table, plate_ratio=light.plate_ratio)
    medium = surroundings.medium_at(time_s)
    if medium is None:
        return None
    # Ambient light by what the plate shows from above and below
    up, environment = surroundings.camera.at(time_s)[1][1], light.environment
    sun = environment.sun
    upwards = environment_lookup(environment.ambient, -up)
    diffuse, floor = ambient_parts(
        medium,
        down=environment_lookup(environment.ambient, up),
        up=upwards,
        sun=np.zeros(3) if sun is None else sun.irradiance,
        sun_up=1.0 if sun is None else max(float(sun.direction @ up), MINIMUM_SUN_UP),
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
    return replace(table, diffuse=diffuse.astype(np.float32), plate_ratio=ratio)


def table_between(before: MediumTable, after: MediumTable, share: float) -> MediumTable:
    """Return a table whose numbers are interpolated linearly between those of two. share: 0 at `before`."""
    mixed = {}
    for field in fields(MediumTable):
        one, other = getattr(before, field.name), getattr(after, field.name)
        if one is not other and one is not None and other is not None:
            value = (1.0 - share) * one + share * other
            mixed[field.name] = value.astype(np.float32) if isinstance(one, np.ndarray) else value
    return replace(before, **mixed)


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


def plate_light(loaded: Loaded, analysis: ClipAnalysis, plate: VideoFrame, cache: Cache | None = None) -> FrameLight:
    """Return the light of a plate's frame. What the clip's analysis does not hold is measured in this frame.

    cache: holds the light of the last frame.
    """
    plan, of_light = loaded.plan, replace(analysis, background=None, grade=None)
    cache = Cache() if cache is None else cache
    return cache.of(_plate_light, loaded.surroundings, of_light, plate, plan.sun.runs, plan.glossy.runs)


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
