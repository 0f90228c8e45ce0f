# SPDX-License-Identifier: Apache-2.0
"""Azimuth and elevation of the sun above the water, from date and place.

Low precision coordinates of the sun (Meeus 1998, chapters 12, 13 and 25), good to 0.01 degrees from 1950 to 2050, with
the refraction of the air (Saemundsson 1986). Refraction at the water surface is left to the caller.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

from mr360uw.errors import ParameterError


def parse_time(text: str) -> datetime:
    """Return the time of an ISO 8601 text that states its zone."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise ParameterError(f"sun_time - not ISO 8601 (got {text!r}) - write 2026-06-21T12:00:00+02:00") from error
    if time.tzinfo is None:
        raise ParameterError(f"sun_time - states no time zone (got {text!r}) - end it in +02:00 or Z")
    return time


def sun_angles(time: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Return (compass azimuth, apparent elevation) [rad] of the sun; azimuth 0 = north, + = east."""
    days = (time.astimezone(UTC) - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / 86400.0
    century = (days + 69.0 / 86400.0) / 36525.0  # terrestrial time runs ahead by about 69 s
    mean_longitude = 280.46646 + 36000.76983 * century + 0.0003032 * century**2
    anomaly = math.radians(357.52911 + 35999.05029 * century - 0.0001537 * century**2)
    centre = (
        (1.914602 - 0.004817 * century) * math.sin(anomaly)
        + (0.019993 - 0.000101 * century) * math.sin(2.0 * anomaly)
        + 0.000289 * math.sin(3.0 * anomaly)
    )
    node = math.radians(125.04 - 1934.136 * century)
    longitude = math.radians(mean_longitude + centre - 0.00569 - 0.00478 * math.sin(node))
    obliquity = math.radians(23.439291 - 0.0130042 * century + 0.00256 * math.cos(node))
    right_ascension = math.atan2(math.cos(obliquity) * math.sin(longitude), math.cos(longitude))
    declination = math.asin(math.sin(obliquity) * math.sin(longitude))
    sidereal = math.radians((280.46061837 + 360.98564736629 * days + longitude_deg) % 360.0)
    hour_angle = sidereal - right_ascension
    latitude = math.radians(latitude_deg)
    sine = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(
        hour_angle
    )
    elevation = math.asin(max(-1.0, min(1.0, sine)))
    azimuth = math.atan2(
        -math.sin(hour_angle),
        math.tan(declination) * math.cos(latitude) - math.sin(latitude) * math.cos(hour_angle),
    )
    return azimuth % (2.0 * math.pi), elevation + refraction(elevation)


def refraction(elevation_rad: float) -> float:
    """Return the refraction of the air [rad] at a true elevation (Saemundsson 1986); 0 more than 1 degree below 0."""
    degrees = math.degrees(elevation_rad)
    if degrees < -1.0:
        return 0.0
    return math.radians(1.02 / 60.0 / math.tan(math.radians(degrees + 10.3 / (degrees + 5.11))))


def daylight_angles(text: str, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Return `sun_angles` of an ISO 8601 time; raise `ParameterError` where the sun is not up.

    A night is an error because it is mostly a wrong zone or place.
    """
    azimuth, elevation = sun_angles(parse_time(text), latitude_deg, longitude_deg)
    if elevation <= 0.0:
        raise ParameterError(
            f"sun_time - the sun is {math.degrees(-elevation):.1f} degrees below the horizon "
            f"(got {text} at latitude {latitude_deg:g}, longitude {longitude_deg:g}) - "
            f'check zone and place, or take light.sun "none" for a night'
        )
    return azimuth, elevation
