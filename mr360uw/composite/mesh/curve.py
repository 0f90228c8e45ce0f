# SPDX-License-Identifier: Apache-2.0
"""Animation clips: values over time between keys (glTF 2.0 specification, section 3.11 and appendix C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mr360uw.types import Floats

Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]
Target = Literal["translation", "rotation", "scale", "weights"]
_STRAIGHT = 1.0 - 1e-10
"""Cosine between quaternions above which the arc is taken as straight; its error there is below 1e-15."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Values (k, w) at ascending times (k,) [s]; before the first and after the last they stay.

    tangents: of CUBICSPLINE, (k, 2, w), into and out of each key, per second. turns: whether the values are unit
    quaternions x, y, z, w.
    """

    time_s: Floats
    values: Floats
    interpolation: Interpolation = "LINEAR"
    tangents: Floats | None = None
    turns: bool = False

    def at(self, time_s: float) -> Floats:
        """Return the value (w,) at a time: STEP, LINEAR (quaternions: the shortest arc), or a cubic Hermite spline."""
        key = int(np.searchsorted(self.time_s, time_s, side="right")) - 1
        if key < 0 or key == len(self.time_s) - 1 or self.interpolation == "STEP":
            return np.asarray(self.values[max(key, 0)])
        span = float(self.time_s[key + 1] - self.time_s[key])
        t, before, after = (time_s - float(self.time_s[key])) / span, self.values[key], self.values[key + 1]
        if self.tangents is not None:
            leaving, arriving = span * self.tangents[key, 1], span * self.tangents[key + 1, 0]
            value = (
                (2 * t**3 - 3 * t**2 + 1) * before
                + (t**3 - 2 * t**2 + t) * leaving
                + (3 * t**2 - 2 * t**3) * after
                + (t**3 - t**2) * arriving
            )
            return np.asarray(value / np.linalg.norm(value) if self.turns else value)
        return slerp(before, after, t) if self.turns else np.asarray((1.0 - t) * before + t * after)


def slerp(before: Floats, after: Floats, t: float) -> Floats:
    """Return the unit quaternion (4,) a fraction t along the shortest arc between two (Shoemake 1985)."""
    cosine = float(before @ after)
    if cosine < 0.0:
        after, cosine = -after, -cosine
    if cosine > _STRAIGHT:
        value = (1.0 - t) * before + t * after
        return np.asarray(value / np.linalg.norm(value))
    angle = np.arccos(cosine)
    return np.asarray((np.sin((1.0 - t) * angle) * before + np.sin(t * angle) * after) / np.sin(angle))


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A curve that moves one thing: `target` of the skeleton's node number `node`."""

    node: int
    target: Target
    curve: Curve


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """An animation: channels that are played together."""

    name: str
    channels: tuple[Channel, ...]

    @property
    def first_s(self) -> float:
        """Time of the first key [s]."""
        return min((float(c.curve.time_s[0]) for c in self.channels), default=0.0)

    @property
    def duration_s(self) -> float:
        """Time from the first key to the last [s]."""
        return max((float(c.curve.time_s[-1]) for c in self.channels), default=0.0) - self.first_s
