# SPDX-License-Identifier: Apache-2.0
"""Small levelled map of a plate without expansion, to which the colour of its water is fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.ibl.level.tilt import level_matrix, roll_pitch
from mr360uw.ibl.level.upward import is_level, upward
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, coarse_directions, remap
from mr360uw.ibl.reduce import reduce_map
from mr360uw.sphere import frame_from_direction
from mr360uw.types import Floats, YuvImage

_FINER = 8
"""Planes are averaged as code values to cells this many times finer than the map, before they are decoded to light."""


def plate_map(plate: Floats | YuvImage, up: ArrayLike | None = None) -> Floats:
    """Return the (32, 64, 3) means of a linear plate (H, W, 3) or of decoded planes over exact solid angles.

    Codes outside the gamut (deep blue water in red) give negative light; means are clipped at 0. up: direction (3,) of
    the world's up in the plate's axes; the map is levelled and its heading kept.
    """
    fine, up = _fine(plate), upward(up)
    if not is_level(up):
        fine = reduce_map(fine, COARSE_COLUMNS, COARSE_ROWS)
        seen = coarse_directions() @ level_matrix(*map(float, roll_pitch(up)))
        fine = remap(fine, *frame_from_direction(seen, COARSE_COLUMNS, COARSE_ROWS))
    return np.maximum(reduce_map(fine, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS), 0.0)


def _fine(plate: Floats | YuvImage) -> Floats:
    if not isinstance(plate, YuvImage):
        return np.asarray(plate, np.float32)
    import cv2

    from mr360uw.yuv.decoding import linear_from_planes

    height, width = plate.y.shape
    size = min(width, _FINER * ENVIRONMENT_COLUMNS), min(height, _FINER * ENVIRONMENT_ROWS)
    y, u, v = (cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in (plate.y, plate.u, plate.v))
    return linear_from_planes(YuvImage(y, u, v, plate.spec))
