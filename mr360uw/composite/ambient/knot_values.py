# SPDX-License-Identifier: Apache-2.0
"""What shading reads of the ambient light at a place of a body."""

from __future__ import annotations

import numpy as np

from mr360uw.types import Floats

CHANNELS = 12
"""Values of a knot: ratio of irradiance (3), visible fraction; visibility a + b.d (4); light of what blocks (3), 0."""
UNTOUCHED = (1.0, 1.0, 1.0, 1.0, 1.0, *[0.0] * (CHANNELS - 5))
"""Values where nothing is in the way."""


def reflected_light(values: Floats, axis: Floats) -> tuple[Floats, Floats, Floats]:
    """Return what values (n, CHANNELS) of places make of ambient light: the ratio (n, 3) of its irradiance, the visible
    fraction (n, 1) of the light about unit directions `axis` (n, 3), and the radiance (n, 3) that is seen instead.

    Twin: ambient.glsl.
    """
    seen = np.clip(values[:, 4] + np.sum(values[:, 5:8] * axis, axis=-1), 0.0, 1.0)
    hidden = (1.0 - seen) / np.maximum(1.0 - values[:, 3], 1e-4)
    return values[:, :3], seen[:, None], values[:, 8:11] * hidden[:, None]
