# SPDX-License-Identifier: Apache-2.0
"""Says in words which spot of a plate is taken for the sun and how far, and where else a sun might be."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mr360uw.ibl.plate import Plate
from mr360uw.ibl.sun.detect import find_disc
from mr360uw.ibl.sun.judge import taken_share
from mr360uw.types import Floats, Sun

_WHOLE = 0.995
"""Share of a sun's light from which it is all of it in words."""


@dataclass(frozen=True, slots=True)
class SunFound:
    """The most sun-like spot of a plate. words: one line on it. share: of its light that is taken for a beam, 0 to 1.

    angles_deg: azimuth and elevation in the world; None where nothing stands out.
    """

    words: str
    share: float = 0.0
    angles_deg: tuple[float, float] | None = None

    @property
    def to_uncomment(self) -> str:
        """The text at the end of a scene file, all comment, that makes a spot in doubt its sun; "" without a doubt."""
        if self.angles_deg is None or self.share == 1.0 or self.angles_deg[1] < 0.0:
            return ""
        azimuth, elevation = self.angles_deg
        rows = ("[light]", 'sun = "given"', f"sun_azimuth_deg = {azimuth:.1f}", f"sun_elevation_deg = {elevation:.1f}")
        return "\n".join(["", f"# {self.words}; to make it the sun, uncomment:", *(f"# {row}" for row in rows), ""])


def sun_found(plate: Plate, world_from_camera: Floats, *, underwater: bool = False) -> SunFound:
    """Return what is found of a sun in a plate.

    world_from_camera: rotation (3, 3).
    """
    disc = find_disc(plate, underwater=underwater)
    if disc is None:
        return SunFound("no sun: nothing stands out")
    azimuth, elevation = _angles_deg(world_from_camera @ disc.blob.direction)
    share = taken_share(disc.confidence)
    place = f"{_place(azimuth, elevation)}, confidence {disc.confidence:.2f}"
    against = f"; {disc.reason}" if disc.reason else ""
    if share > 0.0:
        words = _shared(place, share) + (against if share < 1.0 else "")
    else:
        where = " inside Snell's window" if underwater else ""
        words = f"no sun{where}; best candidate at {place}{against}"
    return SunFound(words, share, (azimuth, elevation))


def tracked_in_words(sun: Sun | None) -> str:
    """Return a line on the sun of a clip's track, in the world's axes; None: of a shot without one."""
    return "no sun in this shot" if sun is None else _shared(_place(*_angles_deg(sun.direction)), sun.share)


def _shared(place: str, share: float) -> str:
    if share > _WHOLE:
        return f"sun at {place}"
    return f"perhaps a sun at {place}: {100.0 * share:.0f} % of its light is used"


def _place(azimuth_deg: float, elevation_deg: float) -> str:
    return f"azimuth {azimuth_deg:z.1f}, elevation {elevation_deg:z.1f} degrees"


def _angles_deg(direction: Floats) -> tuple[float, float]:
    x, y, z = map(float, direction)
    return math.degrees(math.atan2(x, -z)), math.degrees(math.atan2(y, math.hypot(x, z)))
