# SPDX-License-Identifier: Apache-2.0
"""Says in words which spot of a plate is taken for the sun, or which comes nearest to one and why it is not."""

from __future__ import annotations

import math

from mr360uw.ibl.plate import Plate
from mr360uw.ibl.sun.detect import find_disc
from mr360uw.types import Floats


def sun_in_words(
    plate: Plate, world_from_camera: Floats, minimum_confidence: float = 0.5, *, underwater: bool = False
) -> str:
    """Return one line on a plate's sun: its azimuth and elevation in the world, or those of the best candidate.

    world_from_camera: rotation (3, 3). minimum_confidence: below it a candidate stays in the sky.
    """
    disc = find_disc(plate, underwater=underwater)
    if disc is None:
        return "no sun: nothing stands out"
    x, y, z = map(float, world_from_camera @ disc.blob.direction)
    azimuth, elevation = math.degrees(math.atan2(x, -z)), math.degrees(math.atan2(y, math.hypot(x, z)))
    place = f"azimuth {azimuth:z.1f}, elevation {elevation:z.1f} degrees, confidence {disc.confidence:.2f}"
    if disc.confidence >= minimum_confidence and disc.confidence > 0.0:
        return f"sun at {place}"
    against = f"; {disc.reason}" if disc.reason else ""
    where = " inside Snell's window" if underwater else ""
    return f"no sun{where}; best candidate at {place}{against}"
