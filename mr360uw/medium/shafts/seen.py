# SPDX-License-Identifier: Apache-2.0
"""Shafts along the rays that a picture needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.shafts.froxels import FroxelGrid, shaft_field
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.types import Floats

Array = NDArray[np.float64]


def shafts_seen(scene: ShaftScene, directions: Array, end_m: Array, grid: FroxelGrid, frame: int = 0) -> Floats:
    """Return the deviation (m, 3) along rays (m, 3) from the camera up to end_m (m,).

    The radiance by which light in the water deviates from the smooth veil (`deviation`), of either sign. frame: index
    that places the samples; 0 is the middle.
    """
    return shaft_field(scene, grid, frame).radiance(directions, end_m)
