# SPDX-License-Identifier: Apache-2.0
"""The plate as a small map, just as it is: what the colour of its water is read from."""

from __future__ import annotations

import numpy as np

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.ibl.reduce import reduce_map
from mr360uw.types import Floats, YuvImage

_FINER = 8
"""Planes are averaged as code values down to cells this many times finer than the map, which are smooth inside."""


def plate_map(plate: Floats | YuvImage) -> Floats:
    """Return the (32, 64, 3) means of a linear plate (H, W, 3) or of decoded planes over exact solid angles."""
    if not isinstance(plate, YuvImage):
        return reduce_map(np.asarray(plate, np.float32), ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)
    import cv2

    from mr360uw.video.planes import linear_from_planes

    height, width = plate.y.shape
    size = min(width, _FINER * ENVIRONMENT_COLUMNS), min(height, _FINER * ENVIRONMENT_ROWS)
    y, u, v = (cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in (plate.y, plate.u, plate.v))
    small = linear_from_planes(YuvImage(y, u, v, plate.spec))
    return reduce_map(small, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)
