# SPDX-License-Identifier: Apache-2.0
"""What shading reads of the ambient light at a place of a body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CHANNELS = 12
"""Values of a knot: ratio of irradiance (3), 0; ratio of glossy light that is kept (3), 0; radiance that is reflected
besides (3), 0."""
FEW_CHANNELS = 4
"""Values of a knot that reflects nothing besides and keeps the same ratio of all light: that ratio (3), 0."""
UNTOUCHED = (1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, *[0.0] * (CHANNELS - 7))
"""Values where nothing is in the way."""


def whole_values(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the values (K, CHANNELS) of knots that are given with those or with `FEW_CHANNELS`."""
    if values.shape[1] == CHANNELS:
        return values
    whole = np.zeros((len(values), CHANNELS), np.float32)
    whole[:, :FEW_CHANNELS] = whole[:, FEW_CHANNELS : 2 * FEW_CHANNELS] = values
    return whole
