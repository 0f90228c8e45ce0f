# SPDX-License-Identifier: Apache-2.0
"""The up direction of a frame, and the elevation of its pixels above the horizon.

`up` is the direction (3,) of the world's up in the frame's axes, the second row of `world_from_camera`. In a level
frame it is +y; then elevation is a matter of the row alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

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
