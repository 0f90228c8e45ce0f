# SPDX-License-Identifier: Apache-2.0
"""Camera path of a scene: position, rotation and depth over time."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mr360uw.composite import read_camera_track
from mr360uw.composite.motion import Motion
from mr360uw.errors import ParameterError
from mr360uw.ibl.level.tilt import LevelTrack, keyed_level, level_from_gpmf
from mr360uw.ibl.sun.steady import Camera
from mr360uw.scene.inputs import open_plate, pose_of_plate
from mr360uw.scene.model import Scene
from mr360uw.types import Floats

_SHALLOWEST_M = 0.01
"""Least depth [m] of a camera in water."""
_NO_TILT_DEG = 0.05
"""Pitch and roll of a file's pose [deg] below which it is level: a third of a pixel of 2048 columns."""
_SAYS_LEVEL = ("track", "gravity", "tilt_keys", "roll_deg", "pitch_deg")
"""Settings of a camera that say how it is held, and are taken in place of the pose of the plate's file."""


def is_tilted(pitch_deg: float, roll_deg: float) -> bool:
    """Return whether the pose that a file states tilts its panorama."""
    return max(abs(pitch_deg), abs(roll_deg)) > _NO_TILT_DEG


def level_track(scene: Scene) -> LevelTrack | None:
    """Return the tilt of a plate over time; None if it is level.

    It is told by a GoPro's gravity, by keys, by fixed angles, or by the pose that the plate's file states.
    """
    camera = scene.camera
    if camera.gravity is not None:
        from mr360uw.video.read.probe import gpmf_payloads

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

    track: position and orientation. Without one, `tilt` rotates the camera and `depth_keys` (n, 2), time [s] and depth
    [m], move it vertically; without any of them it stands level at the origin.
    """

    depth_m: float
    track: Motion | None = None
    tilt: LevelTrack | None = None
    depth_keys: Floats | None = None

    @classmethod
    def of(cls, scene: Scene) -> CameraPath:
        """Return the path of a scene's camera.

        Raises `ParameterError` if it leaves the water, `VideoError` if a file holds no gravity.
        """
        camera = scene.camera
        if camera.track is not None:
            path = cls(camera.depth_m, track=read_camera_track(camera.track))
        else:
            keys = np.array(camera.depth_keys) if camera.depth_keys else None
            path = cls(camera.depth_m, tilt=level_track(scene), depth_keys=keys)
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
        turns = self.tilt is not None and len(self.tilt.time_s) > 1
        return self.sinks or turns or (self.track is not None and self.track.moves)

    @property
    def rotation_known(self) -> Camera:
        """What is known of the camera's rotation: all of it, its tilt over time, or no more than that it may stand."""
        if self.track is not None:
            return "tracked"
        return "levelled" if self.tilt is not None and len(self.tilt.time_s) > 1 else "unknown"

    @property
    def highest_m(self) -> float:
        """Largest height [m] of the camera in the world."""
        return float(self.depth_m - self.depths.min())

    def at(self, time_s: float) -> tuple[Floats, Floats]:
        """Return the position (3,) [m] in the world and the rotation world_from_camera (3, 3) at `time_s`."""
        if self.track is not None:
            pose = self.track.at(time_s)
            return pose[:3, 3], pose[:3, :3]
        depth_m = self.depths[0]
        if self._depth_over_time is not None:  # constant before the first key and after the last
            depth_m = self._depth_over_time(np.clip(time_s, self.instants[0], self.instants[-1]))
        position = np.array([0.0, self.depth_m - float(depth_m), 0.0])
        return position, np.eye(3) if self.tilt is None else self.tilt.at(time_s)

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
        return np.zeros(1) if self.depth_keys is None else self.depth_keys[:, 0]

    @functools.cached_property
    def depths(self) -> Floats:
        """Return the depths [m] of all keys. Interpolation is monotone between them, so they bound all depths."""
        if self.track is not None:
            return self.depth_m - self.track.position[:, 1]
        return np.array([self.depth_m]) if self.depth_keys is None else self.depth_keys[:, 1]

    @functools.cached_property
    def _depth_over_time(self) -> Callable[[float], Any] | None:
        """Depth [m] between keys; None where there is only one."""
        if self.depth_keys is None or len(self.depth_keys) == 1:
            return None
        from scipy.interpolate import PchipInterpolator

        depth: Callable[[float], Any] = PchipInterpolator(*self.depth_keys.T)
        return depth
