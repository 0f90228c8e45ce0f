# SPDX-License-Identifier: Apache-2.0
"""Surroundings of a plate: the path of its camera, its medium, and the reader of its light."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.composite import read_camera_track
from mr360uw.composite.motion import Motion, ValuesOverTime
from mr360uw.errors import ParameterError
from mr360uw.ibl import LightSettings
from mr360uw.ibl.sun.split import CLEAR_SKY_DIRECT
from mr360uw.ibl.sun.track import Camera
from mr360uw.ibl.tilt import keyed_level, level_at, level_from_gpmf
from mr360uw.medium import Medium
from mr360uw.medium.medium import MediumAtDepths, MixedMedium, TableAt
from mr360uw.medium.open_water import OpenWater, open_water
from mr360uw.medium.scattered_light import around_sun, placed, typical_level
from mr360uw.medium.settings import WaterSettings
from mr360uw.render.lights import EnvironmentReader, world_view
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import WaterBetween, open_plate, pose_of_plate, scene_at, water_between, without_gain
from mr360uw.types import Array, Floats, MediumTable, Sun
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
    light: EnvironmentReader
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


def load_surroundings(scene: Scene, reads: Cache | None = None, between: WaterBetween | None = None) -> Surroundings:
    """Return the surroundings of a scene. reads: what was made before. Raises `ParameterError` or `VideoError`.

    between: waters whose tables those of the scene's water are interpolated from, where it is keyed.
    """
    reads = Cache() if reads is None else reads
    light = scene.light.model_copy(update={"exposure": 0.0})  # which is the objects' alone
    return reads.of(_surroundings, scene.only("camera", "water", light=light), between, floor_depth_m(scene), reads)


def _surroundings(scene: Scene, between: WaterBetween | None, floor_m: float | None, reads: Cache) -> Surroundings:
    camera = camera_path(scene, reads)
    plain, gain = without_gain(scene.water), scene.water.gain
    medium, depths = (
        _medium(plain, camera, floor_m, reads) if between is None else _mixed(plain, between, camera, floor_m, reads)
    )
    medium = medium if medium is None or gain == "auto" else medium.scaled(gain)
    light = EnvironmentReader(scene, medium.unit_table if medium is not None else None, camera.at)
    ground_y = None if floor_m is None else scene.camera.depth_m - floor_m
    return Surroundings(scene.light, scene.water, camera, medium, light, ground_y, depths)


def camera_path(scene: Scene, reads: Cache) -> CameraPath:
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
    reads = Cache()
    return lambda time_s: load_surroundings(scene_at(scene, time_s), reads, water_between(scene, time_s))


def _medium(
    water: WaterSettings, camera: CameraPath, floor_m: float | None, reads: Cache
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
    water: WaterSettings, between: WaterBetween, camera: CameraPath, floor_m: float | None, reads: Cache
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

    first, second, share = between
    mixed = MixedMedium(exact, tables(first), tables(second), share)
    return mixed.at(camera.depth_m), mixed if camera.sinks else None


_SHALLOWEST_M = 0.01
"""Least depth [m] of a camera in water."""
_NO_TILT_DEG = 0.05
"""Pitch and roll of a file's pose [deg] below which it is level: a third of a pixel of 2048 columns."""
_SAYS_LEVEL = ("track", "gravity", "tilt_keys", "roll_deg", "pitch_deg")
"""Settings of a camera that say how it is held, and are taken in place of the pose of the plate's file."""


def is_tilted(pitch_deg: float, roll_deg: float) -> bool:
    """Return whether the pose that a file states tilts its panorama."""
    return max(abs(pitch_deg), abs(roll_deg)) > _NO_TILT_DEG


def level_track(scene: Scene) -> Array | None:
    """Return the tilt of a plate over time, as `level_at` takes it; None if it is level.

    It is told by a GoPro's gravity, by keys, by fixed angles, or by the pose that the plate's file states.
    """
    camera = scene.camera
    if camera.gravity is not None:
        from mr360uw.video.demux import gpmf_payloads

        with open_plate(scene) as video:
            rate = float(video.frame_rate)
        payloads = gpmf_payloads(camera.gravity)
        try:
            return level_from_gpmf(payloads, rate)
        except ParameterError as error:
            raise ParameterError(f"{camera.gravity} {error}") from error
    keys = [(t, np.radians(roll), np.radians(pitch)) for t, roll, pitch in camera.tilt_keys]
    if not keys and (camera.roll_deg, camera.pitch_deg) != (0.0, 0.0):
        keys = [(0.0, np.radians(camera.roll_deg), np.radians(camera.pitch_deg))]
    if not any(name in camera.model_fields_set for name in _SAYS_LEVEL):
        _, pitch, roll = pose_of_plate(scene.plate)
        keys = [(0.0, np.radians(roll), np.radians(pitch))] * is_tilted(pitch, roll)
    return keyed_level(keys) if keys else None


def pose_notes(scene: Scene) -> tuple[str, ...]:
    """Return a note on the pose that a plate's file states, where it tilts the panorama: whether it is used."""
    _, pitch, roll = pose_of_plate(scene.plate)
    said = [name for name in _SAYS_LEVEL if name in scene.camera.model_fields_set]
    own = (scene.camera.pitch_deg, scene.camera.roll_deg)
    if not is_tilted(pitch, roll) or np.allclose(own, (pitch, roll), atol=_NO_TILT_DEG):
        return ()
    pose = f"{scene.plate.path} - its file states a pose of pitch {pitch:g} and roll {roll:g} degrees"
    if said:
        return (f"{pose}, which is not used: camera.{said[0]} says how the camera is held - leave it out to use it",)
    return (
        f"{pose}: the camera is held so - set camera.pitch_deg and camera.roll_deg where the picture shows another",
    )


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Camera over time in the world, whose origin is `depth_m` below the mean surface.

    track: position and orientation. Without one, `tilt` rotates the camera and `sinking`, its depth [m], moves it
    vertically; without any of them it stands level at the origin.
    """

    depth_m: float
    track: Motion | None = None
    tilt: Array | None = None
    sinking: ValuesOverTime | None = None

    @classmethod
    def of(cls, scene: Scene) -> CameraPath:
        """Return the path of a scene's camera.

        Raises `ParameterError` if it leaves the water, `VideoError` if a file holds no gravity.
        """
        camera = scene.camera
        if camera.track is not None:
            path = cls(camera.depth_m, track=read_camera_track(camera.track))
        else:
            sinking = ValuesOverTime(*np.array(camera.depth_keys).T) if camera.depth_keys else None
            path = cls(camera.depth_m, tilt=level_track(scene), sinking=sinking)
        depths = path.depths
        if scene.water.type != "none" and depths.min() < _SHALLOWEST_M:
            raise ParameterError(
                f"camera - leaves the water (got depth {depths.min():.2f} m) - correct its depth, keys or track, or "
                'cut the clip there; for a plate above water set water.type = "none"'
            )
        return path

    @property
    def sinks(self) -> bool:
        """Whether the depth of the camera changes."""
        return bool(np.ptp(self.depths) > 0.0)

    @property
    def moves(self) -> bool:
        """Whether the camera moves or turns."""
        turns = self.tilt is not None and len(self.tilt) > 1
        return self.sinks or turns or (self.track is not None and self.track.moves)

    @property
    def rotation_known(self) -> Camera:
        """What is known of the camera's rotation: all of it, its tilt over time, or no more than that it may stand."""
        if self.track is not None:
            return "tracked"
        return "levelled" if self.tilt is not None and len(self.tilt) > 1 else "unknown"

    @property
    def highest_m(self) -> float:
        """Largest height [m] of the camera in the world."""
        return float(self.depth_m - self.depths.min())

    def at(self, time_s: float) -> tuple[Floats, Floats]:
        """Return the position (3,) [m] in the world and the rotation world_from_camera (3, 3) at `time_s`."""
        if self.track is not None:
            pose = self.track.at(time_s)
            return pose[:3, 3], pose[:3, :3]
        depth_m = self.depth_m if self.sinking is None else float(self.sinking.at(time_s))
        position = np.array([0.0, self.depth_m - depth_m, 0.0])
        return position, np.eye(3) if self.tilt is None else level_at(self.tilt, time_s)

    def check_times(self, first_s: float, last_s: float, frame_rate: float) -> None:
        """Raise `ParameterError` where a track of more than one row does not cover the frames of a clip.

        first_s, last_s: times of the first and last frame. A track may lack a frame at either end.
        """
        if self.track is None or len(self.track.time_s) == 1:
            return
        start, stop, slack = float(self.track.time_s[0]), float(self.track.time_s[-1]), 1.5 / frame_rate
        if first_s < start - slack or last_s > stop + slack:
            raise ParameterError(
                f"camera.track - is known from {start:.2f} to {stop:.2f} s only (got frames from {first_s:.2f} to "
                f"{last_s:.2f} s) - track the whole clip, or give --frames "
                f"{max(round(start * frame_rate), 0)}:{round(stop * frame_rate) + 1}"
            )

    def depth_at(self, time_s: float) -> float:
        """Return the depth [m] of the camera below the mean surface at `time_s`."""
        return self.depth_m - float(self.at(time_s)[0][1])

    @functools.cached_property
    def instants(self) -> Floats:
        """Times [s] of the keys of its height; time 0 without."""
        if self.track is not None:
            return self.track.time_s
        return np.zeros(1) if self.sinking is None else self.sinking.time_s

    @functools.cached_property
    def depths(self) -> Floats:
        """Return the depths [m] of all keys. Interpolation is monotone between them, so they bound all depths."""
        if self.track is not None:
            return self.depth_m - self.track.position[:, 1]
        return np.array([self.depth_m]) if self.sinking is None else self.sinking.value
