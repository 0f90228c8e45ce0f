# SPDX-License-Identifier: Apache-2.0
"""Bodies over level ground by their places relative to each other, of which the light that they block is a function."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.on_ground.height_field import HeightField
from mr360uw.composite.ambient.on_ground.height_sweep import AZIMUTHS, may_block, sweep
from mr360uw.types import Floats

Swept = tuple[NDArray[np.float32], NDArray[np.float32]]
"""What m bodies block at n places, as `height_sweep.sweep` finds it: begins (m, n, 3), blocked (m, n, AZIMUTHS, 5)."""


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """Bodies over level ground. fields: m height fields. origin: (m, 3) place of each body's origin [m] from a point of
    the ground. Bodies that move together with that point stay the same, to the last bit.
    """

    fields: tuple[HeightField, ...]
    origin: Floats

    @property
    def key(self) -> Hashable:
        """Equal for the same bodies at the same places."""
        return self.fields, self.origin.tobytes()

    def sweep(self, points: Floats) -> Swept:
        """Return what the bodies block at places (n, 3) from the same point as their origins."""
        places = np.ascontiguousarray(points, np.float64)
        swept = nothing_swept(len(self.fields), len(places))
        for field, origin, begins, blocked in zip(self.fields, self.origin, *swept, strict=True):
            sweep_field(field, places, origin, begins, blocked)
        return swept

    def seen_from(self, points: Floats) -> NDArray[np.bool_]:
        """Return which bodies may block light at places (n, 3) from the same point as their origins, (m, n)."""
        seen = np.zeros((len(self.fields), len(points)), np.bool_)
        for row, field, origin in zip(seen, self.fields, self.origin, strict=True):
            may_block(points, origin, field.frame, field.highest_m, row)
        return seen

    def plans(self) -> Floats:
        """Return what `patch_kernel.survey` takes of the bodies, (m, 8)."""
        plans = np.zeros((len(self.fields), 8))
        for plan, field, origin in zip(plans, self.fields, self.origin, strict=True):
            plan[:6] = field.frame
            plan[:2] += origin[[0, 2]]
            plan[6:] = np.maximum(np.array([field.lowest_m, field.highest_m]) + origin[1], 0.0)
        return plans


def nothing_swept(bodies: int, points: int) -> Swept:
    """Return arrays for the sweeps of so many bodies at so many places."""
    return np.zeros((bodies, points, 3), np.float32), np.zeros((bodies, points, AZIMUTHS, 5), np.float32)


def sweep_field(
    field: HeightField, places: Floats, origin: Floats, begins: NDArray[np.float32], blocked: NDArray[np.float32]
) -> None:
    """Set what a body with its origin (3,) blocks at places (n, 3)."""
    sweep(places, origin, field.frame, field.outline, field.squares, begins, blocked)
