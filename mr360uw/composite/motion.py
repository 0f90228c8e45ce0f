# SPDX-License-Identifier: Apache-2.0
"""Keyed motion: position, rotation and scale over time, and tracks of the camera.

Rotations are (yaw, pitch, roll): roll first (right side down), then pitch (nose up), then yaw (nose to the right),
for a body that looks along -z with +y up. Between keys rotations take the shortest arc (slerp, Shoemake 1985);
positions and the logarithm of the scale are interpolated linearly or by a monotone cubic (Fritsch & Carlson 1980).
Before the first and after the last key everything is at rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.caustics.settings import Sea
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.settings import Front, Interpolation, LampSettings, ObjectSettings
from mr360uw.errors import ParameterError
from mr360uw.ibl.tilt import level_matrix, roll_pitch
from mr360uw.medium.spectra import read_table
from mr360uw.parameters import LATEST_S
from mr360uw.shapes import checked
from mr360uw.sphere import yaw_matrix
from mr360uw.types import Floats

_TO_NOSE: dict[Front, float] = {"-z": 0.0, "+z": 180.0, "+x": -90.0, "-x": 90.0}
"""Yaw [deg] that turns the front of a mesh to where noses are, -z."""
_QUATERNION_LENGTH = 0.01
"""Largest deviation of a quaternion's length from 1: files with three digits pass, exchanged columns do not."""


def rotation_matrix(yaw_pitch_roll_deg: Sequence[float]) -> Floats:
    """Return the (3, 3) rotation of angles [deg] as the module defines them."""
    yaw, pitch, roll = np.radians(yaw_pitch_roll_deg)
    return yaw_matrix(yaw) @ level_matrix(roll, pitch)


def yaw_pitch_roll_deg(rotation: Floats) -> tuple[float, float, float]:
    """Return the angles [deg] of a rotation (3, 3): the inverse of `rotation_matrix`."""
    roll, pitch = (float(angle) for angle in roll_pitch(rotation[1]))
    x, _, z = -(rotation @ level_matrix(roll, pitch).T)[:, 2]
    return math.degrees(math.atan2(x, -z)), math.degrees(pitch), math.degrees(roll)


def rigid(position: ArrayLike, rotation: Floats, scale: float = 1.0) -> Floats:
    """Return the (4, 4) transform that scales, then rotates, then translates."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * rotation, position
    return matrix


@dataclass(frozen=True, eq=False)
class Motion:
    """Keys over time (n,), ascending: position (n, 3) [m], rotation (n, 3, 3), scale (n,)."""

    time_s: Floats
    position: Floats
    rotation: Floats
    scale: Floats
    interpolation: Interpolation = "smooth"

    @property
    def moves(self) -> bool:
        """Whether position, rotation or scale differ between keys."""
        return any(np.ptp(a, axis=0).any() for a in (self.position, self.rotation, self.scale))

    def at(self, time_s: float) -> Floats:
        """Return the (4, 4) transform at a time; between equal keys turn and scale are theirs to the last bit."""
        if len(self.time_s) == 1:
            return rigid(self.position[0], self.rotation[0], float(self.scale[0]))
        t = float(np.clip(time_s, self.time_s[0], self.time_s[-1]))
        position, log_scale, turn = self._curves
        k = max(int(np.searchsorted(self.time_s, t)), 1)
        turns, grows = np.any(self.rotation[k] != self.rotation[k - 1]), self.scale[k] != self.scale[k - 1]
        rotation = turn(t).as_matrix() if turns else self.rotation[k]
        return rigid(position(t), rotation, float(np.exp(log_scale(t)) if grows else self.scale[k]))

    @cached_property
    def _curves(self) -> tuple[Any, Any, Any]:
        """Interpolators over time of position, logarithm of the scale, and rotation."""
        from scipy.spatial.transform import Rotation, Slerp

        smooth, turn = self.interpolation == "smooth", Slerp(self.time_s, Rotation.from_matrix(self.rotation))
        position, scale = (curve_through(self.time_s, a, smooth=smooth) for a in (self.position, np.log(self.scale)))
        return position, scale, turn


def lamp_motion(settings: LampSettings) -> Motion:
    """Return the motion of a lamp."""
    rows = [(key.time_s, key.position_m, key.rotation_deg) for key in settings.key] or [(0.0, None, None)]
    return Motion(
        np.array([time_s for time_s, _, _ in rows]),
        np.array([position or settings.position_m for _, position, _ in rows]),
        np.stack([rotation_matrix(rotation or settings.rotation_deg) for _, _, rotation in rows]),
        np.ones(len(rows)),
        settings.interpolation,
    )


def object_motion(settings: ObjectSettings, mesh: Mesh) -> Motion:
    """Return the motion of an object; mesh: its own, at rest. One that stands is at the height of its setting yet."""
    keys = settings.key
    poses = [_pose(settings.at_key(key), mesh) for key in keys] or [_pose(settings, mesh)]
    times = np.array([key.time_s for key in keys] or [0.0])
    position, rotation, scale = (np.array(values) for values in zip(*poses, strict=True))
    return Motion(times, position, rotation, scale, settings.interpolation)


def _pose(settings: ObjectSettings, mesh: Mesh) -> tuple[Floats, Floats, float]:
    """Return the position (3,), rotation (3, 3) and scale of an object of these settings."""
    place, scale = np.array(settings.place_m), settings.scale
    if settings.size_m is not None:
        scale = settings.size_m / float(np.max(mesh.extent_m))
    rotation = rotation_matrix(settings.rotation_deg)
    if settings.face is not None:
        azimuth = math.degrees(math.atan2(-place[0], place[2])) if settings.face == "camera" else settings.face
        rotation = (
            rotation_matrix((azimuth, 0.0, 0.0)) @ rotation @ rotation_matrix((_TO_NOSE[settings.front], 0.0, 0.0))
        )
    return place - scale * rotation @ mesh.center_m if settings.polar else place, rotation, scale


@checked
def read_camera_track(path: str | Path) -> Motion:
    """Return the camera's motion of a CSV file: time [s], x, y, z [m], and the quaternion qx, qy, qz, qw.

    The quaternion rotates the camera's axes (right, up, back) to the world's. The header names the columns
    time_s, x, y, z, qx, qy, qz, qw, in any order. Raises `ParameterError`.
    """
    from scipy.spatial.transform import Rotation

    path = Path(path)
    names = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw")
    table = read_table(path)
    missing = [name for name in names if name not in table]
    if missing:
        raise ParameterError(f"{path} - columns are missing (got no {', '.join(missing)}) - give {', '.join(names)}")
    columns = np.stack([table[name] for name in names], axis=-1)
    if not np.all(np.isfinite(columns)):
        raise ParameterError(f"{path} - has entries that are no numbers - correct the rows")
    if np.any(late := np.abs(columns[:, 0]) > LATEST_S):
        got = f"got {columns[late, 0][0]:g} s, at most {LATEST_S:g}"
        raise ParameterError(f"{path} time_s - is no time of a clip ({got}) - count from the clip's start")
    check_unit_quaternions(columns[:, 4:], str(path))
    times = columns[:, 0]
    if np.any(np.diff(times) <= 0.0):
        at = int(np.argmax(np.diff(times) <= 0.0))
        got = f"got {times[at]:g} then {times[at + 1]:g}"
        raise ParameterError(f"{path} time_s - must ascend ({got}) - sort the keys")
    rotation = Rotation.from_quat(columns[:, 4:]).as_matrix()
    return Motion(columns[:, 0], columns[:, 1:4], rotation, np.ones(len(columns)), "linear")


def check_unit_quaternions(quaternion: Floats, where: str) -> None:
    """Raise `ParameterError` unless quaternions (n, 4) have the length 1."""
    length = np.linalg.norm(quaternion, axis=-1)
    wrong = np.flatnonzero(~(np.abs(length - 1.0) < _QUATERNION_LENGTH))
    if len(wrong):
        raise ParameterError(
            f"{where} - quaternions must have the length 1 (got {length[wrong[0]]:.4g} in row {wrong[0] + 1}) - check "
            "that the columns are in their places, or export it again"
        )


_POINTS = 13
"""Points along each side of the footprint: waves of a sixth of its length are still averaged, not aliased."""
_LEAST_M = 0.05
"""Least length [m] of a footprint's side."""


def floating(sea: Sea, surface_y_m: float, calm: Floats, mesh: Mesh, time_s: float) -> Floats:
    """Return the transform (4, 4) at a time [s] of an object that has the transform `calm` on a level sea.

    The plane h + s.(x, z) that fits the surface best over the object's own length and width gives its heave h and tilt:
    waves that are shorter than the object do not move it. There is no inertia and no drift. surface_y_m: height of the
    mean surface in the world.
    """
    middle = calm[:3, :3] @ mesh.center_m + calm[:3, 3]
    sides = [_level(mesh.extent_m[axis] * calm[:3, axis], axis) for axis in (0, 2)]
    heave, slope = plane_of_waves(sea, middle[[0, 2]], np.array(sides), time_s)
    foot = np.array([middle[0], surface_y_m, middle[2]])
    turn = _upright_to(np.array([-slope[0], 1.0, -slope[1]]) / np.sqrt(1.0 + slope @ slope))
    pose = np.array(calm)
    pose[:3, :3] = turn @ calm[:3, :3]
    pose[:3, 3] = foot + [0.0, heave, 0.0] + turn @ (calm[:3, 3] - foot)
    return pose


def plane_of_waves(sea: Sea, middle: Floats, sides: Floats, time_s: float) -> tuple[float, Floats]:
    """Return the height [m] over the mean surface and the slopes (2,) over (x, z) of the plane that fits the waves.

    middle: (2,) of a parallelogram on the mean surface, where the height is taken; sides: (2, 2), [m] over (x, z).
    """
    place = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
    u, v = (k.ravel() for k in np.meshgrid(place, place))
    rest = middle + u[:, None] * sides[0] + v[:, None] * sides[1]
    point = sea.surface(rest[:, 0], rest[:, 1], time_s).position
    columns = np.stack([np.ones(len(u)), point[:, 0] - middle[0], point[:, 2] - middle[1]], axis=-1)
    height, *slope = np.linalg.lstsq(columns, point[:, 1], rcond=None)[0]
    return float(height), np.array(slope)


def _level(side: Floats, axis: int) -> Floats:
    """Return the horizontal part (2,) of a side of a body, lengthened to the least one."""
    flat = side[[0, 2]]
    length = float(np.linalg.norm(flat))
    if length >= _LEAST_M:
        return np.asarray(flat)
    return _LEAST_M * (flat / length if length > 0.0 else np.array([1.0, 0.0] if axis == 0 else [0.0, 1.0]))


def _upright_to(normal: Floats) -> Floats:
    """Return the least rotation (3, 3) that turns up, (0, 1, 0), to a unit normal with y > 0."""
    x, y, z = normal
    k = 1.0 / (1.0 + y)
    return np.array([[1.0 - k * x * x, x, -k * x * z], [-x, y, -z], [-k * x * z, z, 1.0 - k * z * z]])


def curve_through(places: ArrayLike, values: Floats, *, smooth: bool) -> Callable[[float], Floats]:
    """Return the function of a place that has values (n, ...) at ascending places (n,), two or more, and is straight
    between them or, if it is to be smooth, a monotone cubic (Fritsch & Carlson 1980).
    """
    from scipy.interpolate import PchipInterpolator, make_interp_spline

    x = np.asarray(places, np.float64)
    return PchipInterpolator(x, values, axis=0) if smooth else make_interp_spline(x, values, k=1)
