# SPDX-License-Identifier: Apache-2.0
"""Medium tables for a camera whose depth changes, and for water that changes.

Tables are made at fixed depths, each 6 % deeper than the one before, and interpolated between them: linearly, the veil
in its logarithm. A frame's table depends on its depth alone and changes continuously from frame to frame.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mr360uw.medium.medium import Medium
from mr360uw.types import MediumTable

TableAt = Callable[[float], MediumTable]

_RATIO = 1.06
"""Ratio of neighbouring depths. The interpolation error is at most 0.3 %; twice the step gives four times that."""
_KEPT = 16
"""Tables kept, enough for a swim over a factor of 2.4 in depth without making one twice."""


class MediumAtDepths:
    """The media of one water, sensor and mode at any depth of the camera."""

    def __init__(self, medium: Medium) -> None:
        self._medium = medium
        self._node = functools.lru_cache(maxsize=_KEPT)(self._made)

    def at(self, depth_m: float) -> Medium:
        """Return the medium for a camera at a depth [m], > 0."""
        place = float(np.log(depth_m) / np.log(_RATIO))
        step = int(np.floor(place))
        upper, lower = self._node(step), self._node(step + 1)
        above_m, below_m = upper.camera_depth_m, lower.camera_depth_m
        share = (depth_m - above_m) / (below_m - above_m) if below_m > above_m else 0.0
        table = replace(mixed_table(upper, lower, share), camera_depth_m=depth_m)
        return self._medium.at_depth(depth_m, table, (above_m, below_m) if below_m > above_m else ())

    def _made(self, step: int) -> MediumTable:
        floor_m = self._medium.floor_m  # below which there is no water
        depth_m = _RATIO**step
        return self._medium.at_depth(depth_m if floor_m is None else min(depth_m, floor_m)).unit_table


class MixedMedium:
    """Medium at any depth of a water between two others, a fraction `share` of the way.

    exact: of the water itself. first, second: tables, by depth, of the two. To tabulate a solved light field takes a
    third of a second, all else of a medium a hundredth.
    """

    def __init__(self, exact: Medium, first: TableAt, second: TableAt, share: float) -> None:
        self._exact, self._first, self._second, self._share = exact, first, second, share

    def at(self, depth_m: float) -> Medium:
        """Return the medium for a camera at a depth [m], > 0."""
        exact, mixed = self._exact, mixed_table(self._first(depth_m), self._second(depth_m), self._share)
        table = replace(mixed, camera_depth_m=depth_m, length_m=exact.length_m, refractive_index=exact.refractive_index)
        return exact.at_depth(depth_m, table)


def mixed_table(first: MediumTable, second: MediumTable, share: float) -> MediumTable:
    """Return the first of two tables, its values mixed with those of the second, of which `share` is taken."""
    mixed = {
        name: (1.0 - share) * getattr(first, name) + share * getattr(second, name)
        for name in ("attenuation", "diffuse", "beam", "unscattered")
    }
    floats = {name: values.astype(np.float32) for name, values in mixed.items()}
    if first.glow is not None and second.glow is not None:
        floats["glow"] = (1.0 - share) * first.glow + share * second.glow
    # light falls off as an exponential of depth and of coefficients: the veil's logarithm is mixed
    floats["veil"] = first.veil ** (1.0 - share) * second.veil**share
    return replace(first, **floats)
