# SPDX-License-Identifier: Apache-2.0
"""Poses of bodies relative to each other and to the ground, rounded far below what shows.

What is found from a rounded pose is kept under it: bodies that move together keep what they see of each other, and the
same pose gives the same result to the last bit wherever in a clip it occurs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.composite.affine import scale_of
from mr360uw.types import Floats

_BITS = 20
"""Places are rounded to 2^-20 of the smaller body's radius, turns to as much of a radian."""


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """linear: (3, 3), shift: (3,) [m of the first mesh]: where a second frame lies in a first; scale: size of the
    linear part. key: equal for equal.
    """

    linear: Floats
    shift: Floats
    scale: float
    key: bytes


def relative_pose(inverse: Floats, matrix: Floats, scale: float, length_m: float) -> RelativePose:
    """Return the pose `inverse` @ `matrix`, both (4, 4), rounded; scale: size of its linear part; length_m: of what is
    small, in the first mesh's metres.
    """
    pose = inverse @ matrix
    steps = np.rint(np.log2([scale, length_m])) - _BITS
    unit = np.exp2(steps)
    linear, shift = np.rint(pose[:3, :3] / unit[0]) + 0.0, np.rint(pose[:3, 3] / unit[1]) + 0.0
    key, linear = linear.tobytes() + shift.tobytes() + steps.tobytes(), linear * unit[0]
    return RelativePose(linear, shift * unit[1], scale_of(linear), key)


def rounded(values: Floats, unit: float = 1.0) -> Floats:
    """Return values of the order of `unit` rounded as poses are."""
    step = float(np.exp2(np.rint(np.log2(unit)) - _BITS))
    return np.rint(np.asarray(values) / step) * step + 0.0
