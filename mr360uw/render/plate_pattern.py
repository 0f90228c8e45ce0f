# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics in a frame, as shadows on the receiver take them away.

Where the camera stands, the clip's mean is the plate without caustics. Where it moves, or of a single picture, detail
of the size of caustics is smoothed, by the fraction of its variance that the scene's own sea explains.
"""

from __future__ import annotations

import math

import numpy as np

from mr360uw.cache import Cache
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.color import luminance
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Receiver
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, unscattered_share
from mr360uw.medium.small_angles import spread_of
from mr360uw.render.background import Background, BackgroundSeries
from mr360uw.render.lights import direct_to_diffuse
from mr360uw.render.loaded import Loaded
from mr360uw.render.mattes import ReceiverClip
from mr360uw.scene.keyed_water import without_gain
from mr360uw.scene.model import Scene
from mr360uw.types import BeamSpread, MediumTable
from mr360uw.video import VideoFrame

_TYPICAL_HEIGHT_M = 2.0
"""Height of the camera above ground that a distance map gives."""
_LEAST_HEIGHT_M = 0.2
_TYPICAL_SUN = (0.5, math.sqrt(0.75), 0.0)
"""Direction of a sun 60 degrees high in the air, for the contrast of the caustics that a sea makes: at 35 degrees it is
larger by 5 to 25 % between 4 and 8 m of depth."""


def background_series(loaded: Loaded, cache: Cache | None = None) -> BackgroundSeries | None:
    """Return what collects a clip's ground without caustics; None where the plan leaves its caustics alone.

    cache: keeps the contrast of the scene's own caustics, which is the same for all frames.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    return BackgroundSeries(*_on_ground(loaded, loaded.receiver, Cache() if cache is None else cache))


def _on_ground(loaded: Loaded, receiver: ReceiverClip, cache: Cache) -> tuple[float, float]:
    """Return the camera's height [m] above the ground, and the contrast of the light that the scene's sea makes there.

    cache: holds the contrast.
    """
    scene, medium, height_m = loaded.scene, loaded.surroundings.medium, _height_above(receiver.at(0), loaded)
    assert medium is not None
    contrast = cache.of(
        _expected_contrast, scene.sea, _resolution(scene), scene.water.refractive_index, medium.unit_table,
        spread_of(medium), scene.camera.depth_m + height_m,
    )  # fmt: skip
    return height_m, contrast


def plate_pattern(
    loaded: Loaded, background: Background | None, plate: VideoFrame, cache: Cache | None = None
) -> PlatePattern | None:
    """Return the pattern of a plate's frame on the receiver; None where the plan has none.

    background: of the clip; None finds it in this frame alone. cache: see `background_series`.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    cache = Cache() if cache is None else cache
    if background is None:
        background = cache.of(_background_of_frame, *_on_ground(loaded, loaded.receiver, cache), plate)
    height_m = _height_above(loaded.receiver.at(plate.index), loaded)
    return cache.of(PlatePattern, plate, background.mean, height_m, background.strength)


def _background_of_frame(height_m: float, contrast: float, plate: VideoFrame) -> Background:
    """Return the ground without caustics of a frame by itself."""
    series = BackgroundSeries(height_m, contrast)
    series.add(plate)
    return series.result()


def waves_of(scene: Scene) -> tuple[object, ...]:
    """Return the settings that the contrast of the caustics on the ground depends on."""
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


def _expected_contrast(
    sea: Sea, settings: CausticSettings, index: float, table: MediumTable, spread: BeamSpread | None, depth_m: float
) -> float:
    """Return the standard deviation over mean of the light that a sea throws on the ground at a depth."""
    at = np.array([depth_m])
    stack = caustic_stack(sea, _TYPICAL_SUN, at, 0.0, settings, index, spread)
    up = float(stack.sun_direction[1])
    direct = direct_to_diffuse(table) * beam_ratio(table, at, up) / ambient_ratio(table, at)
    sharp = float(luminance(unscattered_share(table, at, up))[0])
    pattern = sharp * stack.ratio[0, ..., 1] + (0.0 if stack.soft is None else (1.0 - sharp) * stack.soft[0, ..., 0])
    return float(pattern.std() * luminance(direct / (1.0 + direct))[0])
