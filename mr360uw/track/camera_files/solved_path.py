# SPDX-License-Identifier: Apache-2.0
"""A camera's path as another program has solved it, and as a track in this toolkit's world.

Every reader returns camera axes right, up, back, and a world whose +y is up, or one of unknown up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.sphere import unit
from mr360uw.track.camera_track import CameraTrack
from mr360uw.track.world_axes import rotation_to_world
from mr360uw.types import Floats

Y_UP_FROM_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From a world with +z up and +y ahead, as Blender's, to one with +y up and -z ahead."""
FLIPPED = np.diag([1.0, -1.0, -1.0])
"""From camera axes right, down, forward to right, up, back."""
_FARTHEST_M = 1e9
"""Largest distance of a camera from the origin [m]."""
_LEAST_RATE = 1e-4
"""Least frames a second of a clip, and the inverse of the most."""
_LARGEST_SKEW = 1e-3
"""Largest deviation of a rotation matrix from an orthonormal one."""


@dataclass(frozen=True, slots=True, eq=False)
class SolvedPath:
    """Positions (n, 3) and rotations (n, 3, 3) from camera axes to the world, of frames (n,) or times (n,) [s].

    format: in words. up: (3,) in that world if known, else the cameras' own up on average is. frame_rate: if known.
    """

    format: str
    position: Floats
    rotation: Floats
    frame: Floats | None = None
    time_s: Floats | None = None
    up: Floats | None = None
    frame_rate: float | None = None


def checked_rotations(matrices: Floats, where: str) -> Floats:
    """Return matrices (n, 3, 3) without their common scale; raise `ParameterError` where they are no rotations."""
    finite = bool(np.all(np.isfinite(matrices)))
    determinant = np.linalg.det(matrices if finite else np.zeros_like(matrices))
    if not finite or np.any(determinant <= 0.0):
        raise ParameterError(f"{where} - has a matrix that is no rotation (mirrored, or of zeros) - export it again")
    turned: Floats = matrices / np.cbrt(determinant)[:, None, None]
    skew = np.abs(turned @ np.swapaxes(turned, 1, 2) - np.eye(3)).max()
    if skew > _LARGEST_SKEW:
        raise ParameterError(f"{where} - has a matrix that is no rotation (skewed by {skew:.2g}) - export it again")
    return turned


def track_of(path: SolvedPath, where: str, frame_rate: float | None, scale: float = 1.0) -> CameraTrack:
    """Return a path as a track: its first camera at the origin, heading towards -z, +y up, in metres.

    frame_rate: of the clip, for files that count frames, whose first is time 0. scale: metres per unit of the file.
    Raises `ParameterError` for too few cameras and for frames without a rate.
    """
    if not len(path.position):
        raise ParameterError(f"{where} - holds no solved camera (got {path.format}) - export the cameras of all frames")
    if not 0.0 < scale <= _FARTHEST_M:
        raise ParameterError(f"--scale - must be more than 0 (got {scale:g}) - give the metres of the file's unit")
    if not np.all(np.abs(path.position) * scale <= _FARTHEST_M):
        raise ParameterError(f"{where} - has positions that are no numbers, or too far away - correct it")
    times, order = _times(path, where, frame_rate)
    position, rotation = path.position[order], checked_rotations(path.rotation[order], where)
    up = unit(rotation[:, :, 1].mean(axis=0)) if path.up is None else path.up
    turned = rotation_to_world(up, rotation[0])
    count = len(times)
    said = "the cameras' own up on average" if path.up is None else f"the world of the file ({path.format})"
    moves = bool(np.ptp(position, axis=0).any())
    return CameraTrack(
        "moving" if moves else "turning" if np.ptp(rotation, axis=0).any() else "still", times,
        scale * (position - position[0]) @ turned.T, turned @ rotation, np.full(count, np.nan), np.full(count, np.nan),
        np.arange(count), np.zeros((0, 3)), np.zeros(0), 0.0, 0, None, said,
        f"{scale:g} m per unit of the file" + (", a guess: give --scale" if scale == 1.0 and path.up is None else ""),
    )  # fmt: skip


def _times(path: SolvedPath, where: str, frame_rate: float | None) -> tuple[Floats, np.ndarray]:
    """Return ascending times [s] of cameras, and their order in the file."""
    if path.time_s is not None:
        times = path.time_s
    else:
        rate = path.frame_rate if frame_rate is None else frame_rate
        if rate is None or path.frame is None:
            raise ParameterError(
                f"{where} - counts frames (got {path.format}) - give the clip too, or --fps with its frames a second"
            )
        if not _LEAST_RATE <= rate <= 1.0 / _LEAST_RATE:
            raise ParameterError(f"--fps - must be more than 0 (got {rate}) - give frames a second")
        times = (path.frame - path.frame.min()) / rate
    if not np.all(np.isfinite(times)):
        raise ParameterError(f"{where} - has frames or times that are no numbers - correct it")
    order = np.argsort(times, kind="stable")
    twice = np.flatnonzero(np.diff(times[order]) <= 0.0)
    if len(twice):
        raise ParameterError(f"{where} - has a frame twice (at {times[order][twice[0]]:g} s) - leave one out")
    return times[order], order
