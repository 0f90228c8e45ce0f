# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics in a frame, as shadows on the receiver take them away.

Where the camera stands, the clip's mean is the plate in calm light. Where it moves, or of a single picture, detail of
the size of caustics is smoothed, by the fraction of its variance that the scene's own sea explains.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np

from mr360uw.cache import Cache, Same
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.color import luminance
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Receiver
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, unscattered_share
from mr360uw.medium.small_angles import spread_of
from mr360uw.render.calm import CalmPlate, CalmSeries
from mr360uw.render.lights import direct_to_diffuse
from mr360uw.render.loaded import Loaded
from mr360uw.scene.keyed_water import without_gain
from mr360uw.scene.model import Scene
from mr360uw.video import VideoFrame

_TYPICAL_HEIGHT_M = 2.0
"""Height of the camera above ground that a distance map gives."""
_LEAST_HEIGHT_M = 0.2
_TYPICAL_SUN = (0.5, math.sqrt(0.75), 0.0)
"""Direction of a sun 60 degrees high in the air, for the contrast of the caustics that a sea makes: at 35 degrees it is
larger by 5 to 25 % between 4 and 8 m of depth."""


def calm_series(loaded: Loaded, kept: Cache | None = None) -> CalmSeries | None:
    """Return what collects a clip's calm ground; None where the plan leaves its caustics alone.

    kept: keeps the contrast of the scene's own caustics, which is the same for all frames.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    height_m = _height_above(loaded.receiver.at(0), loaded)
    depth_m, kept = loaded.scene.camera.depth_m + height_m, Cache() if kept is None else kept
    key = waves_key(loaded.scene), depth_m
    return CalmSeries(height_m, kept.get("contrast", key, lambda: _expected_contrast(loaded, depth_m)))


def plate_pattern(
    loaded: Loaded, calm: CalmPlate | None, plate: VideoFrame, kept: Cache | None = None
) -> PlatePattern | None:
    """Return the pattern of a plate's frame on the receiver; None where the plan has none.

    calm: of the clip; None finds it in this frame alone. kept: see `calm_series`.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    if calm is None:
        series = calm_series(loaded, kept)
        assert series is not None
        series.add(plate)
        calm = series.result()
    return PlatePattern(plate, calm.mean, _height_above(loaded.receiver.at(plate.index), loaded), calm.strength)


def pattern_key(loaded: Loaded, calm: CalmPlate | None, plate: VideoFrame) -> Hashable:
    """Return the key of `plate_pattern`: all that the pattern depends on.

    The waves count where the frame itself shows how strong its caustics are.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    seen = plate, loaded.receiver, loaded.receiver.at(plate.index), loaded.surroundings.camera, Same(calm)
    return seen, waves_key(loaded.scene) if calm is None else ()


def waves_key(scene: Scene) -> Hashable:
    """Return the key of the contrast of the caustics that a scene's sea makes on the ground."""
    return scene.sea, scene.camera.depth_m, without_gain(scene.water), _resolution(scene)


def _resolution(scene: Scene) -> CausticSettings:
    """Return the settings of the map that the contrast is taken from: the default ones, coarser where the scene's are.

    A map of 256 x 256 from a grid of 96 has a contrast lower by 0.6 % than one of 512 x 512 from 256.
    """
    settings = CausticSettings()
    return settings.model_copy(update={"size": min(settings.size, scene.caustics.size), "grid": scene.caustics.grid})


def _height_above(receiver: Receiver, loaded: Loaded) -> float:
    """Return about how high [m] the camera is above a receiver at the start of the clip."""
    camera_y = float(loaded.view(0.0).position[1])
    if receiver.plane_y is not None:
        below = camera_y - receiver.plane_y
    elif receiver.mesh is not None:
        below = camera_y - float(receiver.mesh[..., 1].mean())
    else:
        below = _TYPICAL_HEIGHT_M
    return max(abs(below), _LEAST_HEIGHT_M)


def _expected_contrast(loaded: Loaded, depth_m: float) -> float:
    """Return the standard deviation over mean of the light that the scene's sea throws on the ground."""
    scene, medium = loaded.scene, loaded.surroundings.medium
    assert medium is not None
    index, table, at = scene.water.refractive_index, medium.unit_table, np.array([depth_m])
    spread = spread_of(medium)
    stack = caustic_stack(scene.sea, _TYPICAL_SUN, at, 0.0, _resolution(scene), index, spread)
    up = float(stack.sun_direction[1])
    direct = direct_to_diffuse(table) * beam_ratio(table, at, up) / ambient_ratio(table, at)
    sharp = float(luminance(unscattered_share(table, at, up))[0])
    pattern = sharp * stack.ratio[0, ..., 1] + (0.0 if stack.soft is None else (1.0 - sharp) * stack.soft[0, ..., 0])
    return float(pattern.std() * luminance(direct / (1.0 + direct))[0])
