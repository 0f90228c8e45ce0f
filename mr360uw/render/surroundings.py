# SPDX-License-Identifier: Apache-2.0
"""Surroundings of a plate: its camera path, its medium, and the reader of its light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mr360uw.ibl import LightSettings
from mr360uw.ibl.sun.closure import CLEAR_SKY_DIRECT
from mr360uw.medium import Medium
from mr360uw.medium.around_sun import around_sun, placed, typical_level
from mr360uw.medium.depths import MediumAtDepths, MixedMedium, TableAt
from mr360uw.medium.fit.open_water import OpenWater, open_water
from mr360uw.medium.settings import WaterSettings
from mr360uw.reading.cached_reads import CachedReads
from mr360uw.render.camera import CameraPath
from mr360uw.render.lights import LightReader
from mr360uw.render.plate_map import world_view
from mr360uw.scene.keyed_water import WaterBetween, scene_at, water_between, without_gain
from mr360uw.scene.model import Scene
from mr360uw.types import Floats, MediumTable, Sun
from mr360uw.video import VideoFrame

_SUN_STEP = 0.02
"""Interval of the sine of the sun's elevation in the water at which the light about it is solved."""
_WATERS = 16
"""Waters that are kept, a few MB each, for keys that come back to where they were."""
_TABLES = 128
"""Tables on the way of keyed water that are kept, 0.25 MB each: the first pass makes them, the frames read them."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Camera path, medium and light reader of a scene. medium: for a camera at `camera.depth_m`; None without water.

    settings, water: its `[light]` and `[water]` tables. ground_y: height [m] of the scene's level floor in the world,
    None without one.
    """

    settings: LightSettings
    water: WaterSettings
    camera: CameraPath
    medium: Medium | None
    light: LightReader
    ground_y: float | None
    _depths: MediumAtDepths | MixedMedium | None

    def medium_at(self, time_s: float) -> Medium | None:
        """Return the medium for the camera's depth at a time."""
        if self._depths is None or self.medium is None:
            return self.medium
        return self._depths.at(self.camera.depth_at(time_s)).scaled(self.medium.gain)

    def open_water(self, frame: VideoFrame, medium: Medium, gain: Floats, sun: Sun | None) -> OpenWater:
        """Return the open water of a plate's frame. medium: at the camera's depth. gain: (3,) of its veil.

        sun: the plate's, in camera axes: a medium of a uniform sky gets one of a clear sky there.
        """
        position, rotation = self.camera.at(frame.time_s)
        above = None if self.ground_y is None else float(position[1]) - self.ground_y
        lit = medium
        if sun is not None and medium.sky == "uniform":
            sun_up = max(round(float(sun.direction @ rotation[1]) / _SUN_STEP), 1) * _SUN_STEP
            lit = medium.under(("sun", min(sun_up, 1.0), CLEAR_SKY_DIRECT))
        around = self.around_sun(frame.time_s, lit, sun, fitted=True)
        return open_water(medium, gain, world_view(frame.pixels, rotation), above, around)

    def around_sun(self, time_s: float, medium: Medium, sun: Sun | None, *, fitted: bool) -> Floats | None:
        """Return the map (ROWS, COLUMNS, 3) by which a medium's veil varies about a sun in camera axes.

        fitted: whether its gain is, to what is typical at the horizon. None without a sun, or where the medium is
        solved for none.
        """
        ratio = None if sun is None else around_sun(medium)
        if ratio is None or sun is None:
            return None
        around = placed(ratio, self.camera.at(time_s)[1] @ sun.direction)
        return (around / typical_level(around) if fitted else around).astype(np.float32)


def load_surroundings(
    scene: Scene, reads: CachedReads | None = None, between: WaterBetween | None = None
) -> Surroundings:
    """Return the surroundings of a scene. reads: what was made before. Raises `ParameterError` or `VideoError`.

    between: waters whose tables those of the scene's water are interpolated from, where it is keyed.
    """
    reads = CachedReads() if reads is None else reads
    light = scene.light.model_copy(update={"exposure": 0.0})  # which is the objects' alone
    return reads.of(_surroundings, scene.only("camera", "water", light=light), between, floor_depth_m(scene), reads)


def _surroundings(
    scene: Scene, between: WaterBetween | None, floor_m: float | None, reads: CachedReads
) -> Surroundings:
    camera = camera_path(scene, reads)
    plain, gain = without_gain(scene.water), scene.water.gain
    medium, depths = (
        _medium(plain, camera, floor_m, reads) if between is None else _mixed(plain, between, camera, floor_m, reads)
    )
    medium = medium if medium is None or gain == "auto" else medium.scaled(gain)
    light = LightReader(scene, medium.unit_table if medium is not None else None, camera)
    ground_y = None if floor_m is None else scene.camera.depth_m - floor_m
    return Surroundings(scene.light, scene.water, camera, medium, light, ground_y, depths)


def camera_path(scene: Scene, reads: CachedReads) -> CameraPath:
    """Return the path of a scene's camera. Raises `ParameterError` or `VideoError`."""
    dry = WaterSettings(type="none")
    return reads.of(CameraPath.of, scene.only("camera", water=dry if scene.water.type == "none" else WaterSettings()))


def floor_depth_m(scene: Scene) -> float | None:
    """Return the depth [m] of a scene's level floor; None without, or where it does not lie below the camera."""
    receiver = scene.receiver
    if receiver is None or receiver.kind != "plane" or receiver.height_m >= 0.0:
        return None
    return scene.camera.depth_m - receiver.height_m


def surroundings_over_time(scene: Scene) -> Callable[[float], Surroundings]:
    """Return the function of time [s] that gives a scene's surroundings."""
    reads = CachedReads()
    return lambda time_s: load_surroundings(scene_at(scene, time_s), reads, water_between(scene, time_s))


def _medium(
    water: WaterSettings, camera: CameraPath, floor_m: float | None, reads: CachedReads
) -> tuple[Medium | None, MediumAtDepths | None]:
    """Return the medium of a water at the scene's depth, and at all depths where the camera rises or sinks."""
    return reads.of(_solved, water, camera.depth_m, camera.sinks, floor_m, keep=_WATERS)


def _solved(
    water: WaterSettings, depth_m: float, sinks: bool, floor_m: float | None
) -> tuple[Medium | None, MediumAtDepths | None]:
    medium = water.medium(depth_m, floor_m=floor_m)
    if medium is not None:
        _ = medium.unit_table  # for all that are scaled from it
    return medium, MediumAtDepths(medium) if medium is not None and sinks else None


def _table(water: WaterSettings, depth_m: float, floor_m: float | None) -> MediumTable:
    medium = water.medium(depth_m, floor_m=floor_m)
    assert medium is not None
    return medium.unit_table


def _mixed(
    water: WaterSettings, between: WaterBetween, camera: CameraPath, floor_m: float | None, reads: CachedReads
) -> tuple[Medium | None, MixedMedium | None]:
    """Return the same of a water between two others."""
    exact = water.medium(camera.depth_m, floor_m=floor_m)
    if exact is None:
        return None, None

    def tables(water: WaterSettings) -> TableAt:
        if camera.sinks:
            depths = _medium(water, camera, floor_m, reads)[1]
            assert depths is not None
            return lambda depth_m: depths.at(depth_m).unit_table
        table = reads.of(_table, water, camera.depth_m, floor_m, keep=_TABLES)
        return lambda _: table

    mixed = MixedMedium(exact, tables(between.first), tables(between.second), between.share)
    return mixed.at(camera.depth_m), mixed if camera.sinks else None
