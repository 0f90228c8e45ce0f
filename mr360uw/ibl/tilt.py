# SPDX-License-Identifier: Apache-2.0
"""Roll and pitch of the camera: conversions, tracks over time from keys or a GoPro gravity track, and the tilt that a
radiance map shows.

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

from mr360uw.base.color import luminance
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import snell_elevation
from mr360uw.base.parameters import exactly
from mr360uw.base.sphere import Array, directions, row_solid_angle, unit
from mr360uw.errors import ParameterError
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


def streams(data: bytes, key: str, where: str = "GPMF", depth: int = 0) -> Iterator[Array]:
    """Yield the scaled samples (n, k) of stream `key` in GPMF payloads, one array for each payload that has it.

    where, depth: of the payloads, records within others. Raises `ParameterError` where a record runs past the end, or
    holds no numbers that its scale fits.
    """
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
            yield from streams(body, key, f"{where}/{name}", depth + 1)
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


def level_at(track: Array, time_s: float) -> Array:
    """Return the (3, 3) rotation from camera axes to level axes at a time.

    track: rows of time [s], roll and pitch [rad], (n, 3), ascending; linear between them and constant beyond.
    """
    times, roll, pitch = track.T
    return level_matrix(float(np.interp(time_s, times, np.unwrap(roll))), float(np.interp(time_s, times, pitch)))


def keyed_level(keys: Sequence[tuple[float, float, float]]) -> Array:
    """Return the track of keys (time_s, roll_rad, pitch_rad), in ascending time; see `level_at`."""
    table = np.asarray(keys, np.float64).reshape(-1, 3)
    if not len(table) or not np.all(np.isfinite(table)) or np.any(np.diff(table[:, 0]) <= 0.0):
        raise ParameterError("level - keys must be (time, roll, pitch) in ascending time - sort them")
    return table


def level_from_gpmf(data: bytes, frame_rate: float) -> Array:
    """Return the track, see `level_at`, of a GoPro clip's gravity vectors (GRAV, one for each frame) in its payloads.

    The stored vector points down, in axes right, down, forward of the lens that the frame is centred on: at rest
    (0, 1, 0). It agrees with the accelerometer of the same clips, whose reading points up, in axes left, back, up.
    """
    found = list(streams(data, "GRAV"))
    if not found:
        raise ParameterError("GPMF - has no gravity track (GRAV) - use a HERO8, MAX or later, or give roll and pitch")
    if any(samples.shape[1] != 3 for samples in found):
        raise ParameterError(f"GPMF GRAV - needs three numbers a sample (got {found[0].shape[1]}) - copy it again")
    gravity = unit(np.concatenate(found))
    if not len(gravity):
        raise ParameterError("GPMF GRAV - is empty (got no samples) - give roll and pitch")
    up = np.stack([-gravity[:, 0], gravity[:, 1], gravity[:, 2]], axis=1)
    return np.column_stack([np.arange(len(up)) / frame_rate, *roll_pitch(up)])


# --- the horizon in a radiance map ----------------------------------------------------------------------------------

# Roll and pitch of an underwater camera, estimated from Snell's window in a radiance map.
#
# From under water the whole sky lies within asin(1/n) of the vertical, 48.3 degrees in sea water; outside of that
# circle the surface mirrors the water below. The estimate is the tilt at which a step of brightness at the circle's
# edge explains most of the picture:
#
#     log L = a + b y + c y^2 + (d + e y) x + (f + g y) z + s tanh((elevation - edge)/width)
#
# over directions (x, y, z) in level axes, above the horizon; a to g and s are fitted by least squares. The smooth terms
# model other gradients: the side towards the sun is brighter, which by itself would look like a tilt. Where haze or
# waves hide the edge, the step explains little and the estimate is not reliable.


LARGEST_TILT_RAD = np.radians(30.0)
"""Largest tilt that is tried [rad]. Beyond it the window would reach the horizon, where reefs are fitted instead."""
_WIDTH_RAD = np.radians(8.0)
"""Half width of the step [rad]: waves blur the edge about as much. Narrower, the fit follows single waves."""
_LOWEST_SINE = np.sin(np.radians(10.0))
"""Sine of the elevation below which pixels get no weight: there stand reefs and divers rather than the surface."""
_LEAST_EXPLAINED, _LEAST_CONTRAST = 0.7, 1.8
"""Smallest share of variance and brightness ratio of a reliable estimate. Lower ones accept clouds for a window."""
_ROUNDS = 3
"""Fits, each with outliers of the one before weighted down; the first two start from the best point of a grid."""
_OUTLIER = 2.5
"""Distance from the fit, in robust standard deviations, at which a pixel's weight is halved: divers, walls, the sun."""


@dataclass(frozen=True, slots=True)
class HorizonEstimate:
    """Roll and pitch [rad] estimated from one frame.

    explained: share, 0 to 1, of the variance left by the smooth terms that the edge of the window explains. contrast:
    brightness inside the window over that outside.
    """

    roll_rad: float
    pitch_rad: float
    explained: float
    contrast: float

    @property
    def reliable(self) -> bool:
        """Whether the edge of the window is distinct enough for an estimate within a degree or two."""
        return self.explained >= _LEAST_EXPLAINED and self.contrast >= _LEAST_CONTRAST


class _Fit:
    """The fit's normal equations for one picture."""

    def __init__(self, value: Array, direction: Array, solid_angle: Array, edge_rad: float) -> None:
        self._edge_rad = edge_rad
        self._value, self._direction, self._solid_angle = value, direction, solid_angle
        self.trust: Array = np.ones_like(value)

    def _equations(self, tilt: Array) -> tuple[Array, Array, Array, Array]:
        """Return each pixel's weight (n,), the equations' matrix (8, 8) and right side (8,), and the terms (8, n)."""
        x, y, z = (self._direction @ level_matrix(tilt[0], tilt[1]).T).T
        edge = np.tanh((np.arcsin(np.clip(y, -1.0, 1.0)) - self._edge_rad) / _WIDTH_RAD)
        above = np.clip((y - _LOWEST_SINE) / 0.1 + 0.5, 0.0, 1.0)
        terms, weight = np.stack([np.ones_like(y), y, y * y, x, z, x * y, z * y, edge]), self._solid_angle * above
        weighted = terms * (weight * self.trust)
        return weight, weighted @ terms.T + 1e-9 * np.eye(len(terms)), weighted @ self._value, terms

    def solve(self, tilt: Array) -> tuple[float, float]:
        """Return (share of variance not explained by the step, the step's half height in log brightness)."""
        weight, a, b, _ = self._equations(tilt)
        whole = np.linalg.solve(a, b)
        smooth = np.linalg.solve(a[:-1, :-1], b[:-1])
        total = float((weight * self.trust) @ self._value**2)
        left, without = total - float(b @ whole), total - float(b[:-1] @ smooth)
        if without <= 1e-9 * max(total, 1e-12) or whole[-1] <= 0.0:
            return 1.0, 0.0
        return left / without, float(whole[-1])

    def unexplained(self, tilt: Array) -> float:
        """Return the share of variance that a tilt leaves unexplained; more than 1 beyond the largest tilt."""
        size = float(np.hypot(*tilt))
        return 1.0 + size if size > LARGEST_TILT_RAD else self.solve(tilt)[0]

    def doubt_outliers(self, tilt: Array) -> None:
        """Set the weight of each pixel to 1/(1 + (distance from the fit/limit)^2)."""
        weight, a, b, terms = self._equations(tilt)
        fit = np.linalg.solve(a, b) @ terms
        distance = np.abs(self._value - fit)
        spread = 1.4826 * float(np.median(distance[weight > 0.5 * self._solid_angle])) + 1e-6
        self.trust = 1.0 / (1.0 + np.square(distance / (_OUTLIER * spread)))


def estimate_horizon(radiance: ArrayLike, refractive_index: float = REFRACTIVE_INDEX_SEA) -> HorizonEstimate:
    """Return the tilt, up to 30 degrees, at which a radiance map (H, W, 3) of an underwater plate is level.

    Take the light without the sun (`Environment.residual`), a map of 64 x 32. refractive_index: of the water.
    """
    from scipy.optimize import minimize

    image = np.asarray(radiance, np.float64)
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ParameterError(f"radiance - must be an RGB map (got shape {image.shape}) - give (H, W, 3)")
    height, width = image.shape[:2]
    fit = _Fit(
        np.log(np.maximum(luminance(image), 1e-4)).ravel(),
        directions(width, height).reshape(-1, 3),
        np.repeat(row_solid_angle(width, height), width),
        snell_elevation(refractive_index),
    )
    steps = np.linspace(-0.4, 0.4, 9)
    grid = [np.array([a, b]) for a in steps for b in steps if np.hypot(a, b) <= LARGEST_TILT_RAD]
    tilt = grid[0]
    for turn in range(_ROUNDS):
        start = min(grid, key=fit.unexplained) if turn < 2 else tilt
        found = minimize(fit.unexplained, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7})
        tilt = found.x
        if turn < _ROUNDS - 1:
            fit.doubt_outliers(tilt)
    left, step = fit.solve(tilt)
    return HorizonEstimate(float(tilt[0]), float(tilt[1]), 1.0 - left, float(np.exp(2.0 * step)))


def clip_horizon(estimates: Sequence[HorizonEstimate]) -> tuple[float, float, float] | None:
    """Return the roll and pitch [rad] that most frames of a clip agree on, the median of its reliable ones, and the rms
    angle [rad] of these about it; None where fewer than half of all are reliable.
    """
    seen = [e for e in estimates if e.reliable]
    if not seen or 2 * len(seen) < len(estimates):
        return None
    ups = np.stack([level_matrix(e.roll_rad, e.pitch_rad)[1] for e in seen])
    up = unit(np.median(ups, axis=0))
    angle = np.arccos(np.clip(ups @ up, -1.0, 1.0))
    roll, pitch = roll_pitch(up)
    return float(roll), float(pitch), float(np.sqrt(np.mean(angle**2)))
