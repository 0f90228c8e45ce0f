# SPDX-License-Identifier: Apache-2.0
"""Direction of a sun that is not detected: from the settings' angles, or from their date, place and heading."""

from __future__ import annotations

import math

from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.sun.solar import daylight_angles
from mr360uw.sphere import Array, direction_from_angles


def given_direction(settings: LightSettings) -> Array | None:
    """Return the direction (3,) that the settings give: "given" as the camera sees it, "date" in the air, else None."""
    if settings.sun == "given":
        return direction_from_angles(math.radians(settings.sun_azimuth_deg), math.radians(settings.sun_elevation_deg))
    if settings.sun == "date":
        azimuth, elevation = daylight_angles(settings.sun_time, *settings.place_deg)
        return direction_from_angles(azimuth - math.radians(settings.heading_deg), elevation)
    return None
