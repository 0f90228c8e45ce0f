# SPDX-License-Identifier: Apache-2.0
"""Roll and pitch of the camera: conversions, and tracks over time from keys or a GoPro gravity track.

    pitch  + = the centre of the frame looks up        roll  + = clockwise about the view, the right side down
    world = R camera,  R = Rx(pitch) Rz(-roll);  up in camera axes = (-sin r cos p, cos r cos p, -sin p)

Yaw is not corrected: the heading of a plate is arbitrary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError
from mr360uw.ibl.level.gravity import streams
from mr360uw.sphere import unit

Array = NDArray[np.float64]


def level_matrix(roll_rad: float, pitch_rad: float) -> Array:
    """Return the (3, 3) rotation from camera axes to level axes of the same heading."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return tilt @ np.array([[cr, sr, 0.0], [-sr, cr, 0.0], [0.0, 0.0, 1.0]])


def roll_pitch(up: ArrayLike) -> tuple[Array, Array]:
    """Return (roll, pitch) [rad] of cameras that see the world's up in directions (..., 3)."""
    u = unit(up)
    return np.arctan2(-u[..., 0], u[..., 1]), -np.arcsin(np.clip(u[..., 2], -1.0, 1.0))


@dataclass(frozen=True, slots=True)
class LevelTrack:
    """Roll and pitch over time, (N,) each, linear between keys and constant beyond; one key is a fixed camera."""

    time_s: Array
    roll_rad: Array
    pitch_rad: Array

    def at(self, time_s: float) -> Array:
        """Return the (3, 3) rotation from camera axes to level axes at `time_s`."""
        roll = np.interp(time_s, self.time_s, np.unwrap(self.roll_rad))
        return level_matrix(float(roll), float(np.interp(time_s, self.time_s, self.pitch_rad)))


def keyed_level(keys: Sequence[tuple[float, float, float]]) -> LevelTrack:
    """Return the track of keys (time_s, roll_rad, pitch_rad), in ascending time."""
    table = np.asarray(keys, np.float64).reshape(-1, 3)
    if not len(table) or not np.all(np.isfinite(table)) or np.any(np.diff(table[:, 0]) <= 0.0):
        raise ParameterError("level - keys must be (time, roll, pitch) in ascending time - sort them")
    return LevelTrack(*table.T)


def level_from_gpmf(data: bytes, frame_rate: float) -> LevelTrack:
    """Return the track of a GoPro clip's gravity vectors (GRAV, one for each frame) in its GPMF payloads.

    The stored vector points down, in axes right, down, forward of the lens that the frame is centred on: at rest
    (0, 1, 0). It agrees with the accelerometer of the same clips, whose reading points up, in axes left, back, up.
    """
    found = streams(data, "GRAV")
    if not found:
        raise ParameterError("GPMF - has no gravity track (GRAV) - use a HERO8, MAX or later, or give roll and pitch")
    if any(samples.shape[1] != 3 for samples in found):
        raise ParameterError(f"GPMF GRAV - needs three numbers a sample (got {found[0].shape[1]}) - copy it again")
    gravity = unit(np.concatenate(found))
    if not len(gravity):
        raise ParameterError("GPMF GRAV - is empty (got no samples) - give roll and pitch")
    up = np.stack([-gravity[:, 0], gravity[:, 1], gravity[:, 2]], axis=1)
    return LevelTrack(np.arange(len(up)) / frame_rate, *roll_pitch(up))
