# SPDX-License-Identifier: Apache-2.0
"""Roll and pitch of the camera: conversions, and tracks over time from keys or a GoPro gravity track.

    pitch  + = the centre of the frame looks up        roll  + = clockwise about the view, the right side down
    world = R camera,  R = Rx(pitch) Rz(-roll);  up in camera axes = (-sin r cos p, cos r cos p, -sin p)

Yaw is not corrected: the heading of a plate is arbitrary. `up` is the direction (3,) of the world's up in the frame's
axes, the second row of `world_from_camera`. In a level frame it is +y; then elevation is a matter of the row alone.

GoPro metadata (GPMF) are nested key-length-value records. A record is FourCC, type character, sample size (u8), repeat
(u16), data padded to 4 bytes, big-endian; type 0 holds records. A stream (STRM) states a divisor (SCAL) before its
samples (GoPro, gpmf-parser).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.errors import ParameterError
from mr360uw.shapes import exactly
from mr360uw.sphere import Array, unit
from mr360uw.types import Floats

LEVEL: Array = np.array([0.0, 1.0, 0.0])
_LEVEL_RAD = 1e-9
"""Tilt [rad] taken as none: the rounding of a rotation matrix, a millionth of a pixel of any frame."""


def upward(up: ArrayLike | None) -> Array:
    """Return `up` as a unit vector (3,): +y where it is None or within 1e-9 rad of +y; raise on anything else."""
    if up is None:
        return LEVEL
    direction = unit(exactly("up", up, (3,)))
    return LEVEL if direction[1] > 0.0 and np.hypot(direction[0], direction[2]) < _LEVEL_RAD else direction


def is_level(up: Array) -> bool:
    """Return whether a frame of this `up` is level."""
    return bool(np.array_equal(up, LEVEL))


def elevation_sine(direction: Floats, up: Array) -> Floats:
    """Return the sine (...,) of the elevation of directions (..., 3) in the frame's axes."""
    return direction[..., 1] if is_level(up) else direction @ up.astype(direction.dtype)


def frame_sines(width: int, height: int, up: Array) -> Array:
    """Return the sine of the elevation of every pixel of a frame, (H, W), or (H, 1) of one that is level."""
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    if is_level(up):
        return np.sin(latitude)[:, None]
    longitude = 2.0 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    around = up[0] * np.sin(longitude) - up[2] * np.cos(longitude)
    sine: Array = up[1] * np.sin(latitude)[:, None] + np.cos(latitude)[:, None] * around
    return sine


_NUMBERS = {
    "b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8", "j": ">i8",
    "J": ">u8",
}  # fmt: skip

_DEEPEST = 16
"""Most records within each other; cameras write three."""


def streams(data: bytes, key: str) -> list[Array]:
    """Return the scaled samples (n, k) of stream `key` in GPMF payloads, one array for each payload that has it.

    Raises `ParameterError` where a record runs past the end, or holds no numbers that its scale fits.
    """
    return list(_samples(data, key, "GPMF"))


def _samples(data: bytes, key: str, where: str, depth: int = 0) -> Iterator[Array]:
    if depth > _DEEPEST:
        raise ParameterError(f"GPMF - has records within records (got more than {_DEEPEST}) - copy it again")
    scale, offset = np.ones(1), 0
    while offset + 8 <= len(data):
        code, kind, size, repeat = struct.unpack_from(">4scBH", data, offset)
        if code == b"\0\0\0\0":  # padding at the end of a payload; others may follow
            offset += 4
            continue
        name, length = code.decode("latin-1"), size * repeat
        body = data[offset + 8 : offset + 8 + length]
        if len(body) < length:
            raise ParameterError(
                f"{where} - record {name!r} is cut off (got {len(body)} of {length} bytes) - copy it again"
            )
        if kind == b"\0":
            yield from _samples(body, key, f"{where}/{name}", depth + 1)
        elif name == "SCAL":
            scale = _numbers(name, kind.decode("latin-1"), size, body).ravel()
        elif name == key:
            samples = _numbers(name, kind.decode("latin-1"), size, body)
            if scale.size not in (1, samples.shape[1]) or not np.all(scale):
                raise ParameterError(
                    f"GPMF {key} - its scale does not fit (got {scale.tolist()!r:.40}) - copy it again"
                )
            yield samples / scale
        offset += 8 + (length + 3) // 4 * 4


def _numbers(key: str, kind: str, size: int, data: bytes) -> Array:
    """Return the samples (n, values in each) of a record, each of `size` bytes; raise for text and compound types."""
    dtype = _NUMBERS.get(kind)
    if dtype is None or not size or size % np.dtype(dtype).itemsize:
        raise ParameterError(f"GPMF {key} - holds no plain numbers (got type {kind!r}) - take another key")
    values = np.frombuffer(data, dtype)
    return values.reshape(-1, size // values.itemsize).astype(np.float64)


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
