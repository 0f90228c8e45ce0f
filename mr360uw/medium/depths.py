# SPDX-License-Identifier: Apache-2.0
"""Medium tables for a camera whose depth changes.

Tables are made at fixed depths, each 6 % deeper than the one before, and interpolated between them: linearly, the veil
in its logarithm. A frame's table depends on its depth alone and changes continuously from frame to frame.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from mr360uw.medium.medium import Medium
from mr360uw.types import MediumTable

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
        share = (depth_m - upper.camera_depth_m) / (lower.camera_depth_m - upper.camera_depth_m)
        mixed = {
            name: (1.0 - share) * getattr(upper, name) + share * getattr(lower, name)
            for name in ("attenuation", "diffuse", "beam", "unscattered")
        }
        floats = {name: values.astype(np.float32) for name, values in mixed.items()}
        # light falls off as an exponential of depth: the veil's logarithm is mixed
        floats["veil"] = upper.veil ** (1.0 - share) * lower.veil**share
        return self._medium.at_depth(depth_m, replace(upper, camera_depth_m=depth_m, **floats))

    def _made(self, step: int) -> MediumTable:
        return self._medium.at_depth(_RATIO**step).unit_table
