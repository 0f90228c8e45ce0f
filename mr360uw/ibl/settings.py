# SPDX-License-Identifier: Apache-2.0
"""Settings of the light: the `[light]` table of a scene; the sun's direction from date and place."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from mr360uw.base.parameters import Parameters, advanced, listed, parameter
from mr360uw.base.sphere import Array, direction_from_angles
from mr360uw.errors import ParameterError

Operator = Literal["none", "mr360", "landis", "akyuz", "kovaleski", "piecewise", "closure"]
Region = Literal["all", "upper", "snell"]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
SunSource = Literal["detect", "given", "date", "none"]

EXPOSURE = "brighter (+) or darker (-) than the plate's light makes it: an object; that of [light]: all objects"
"""What the key of objects and that of the light mean."""
GLOSSY_ROUGHNESS = (0.1, 0.2, 0.4, 0.7, 1.0)
"""Roughnesses that the light of a plate is filtered for; it is interpolated between them."""
MINIMUM_ROUGHNESS = 0.05
"""Below it the lobe is far narrower than a pixel of the finest source map."""


@listed
class LightSettings(Parameters):
    """Light from the plate: expansion to scene radiance, the region it acts in, and the source of the sun.

    The `[light]` table of a scene, and the `settings` of library calls. By default the sun is looked for, and what the
    plate clipped of it is restored.

    Raises
    ------
    ParameterError
        If a value is out of its range; the message names it.

    See Also
    --------
    uw.ibl.environment : Finds the light with them.
    uw.Scene : Has them as `light`.

    Examples
    --------
    >>> uw.ibl.LightSettings(sun="given", sun_elevation_deg=40.0).sun
    'given'
    """

    operator: Operator = advanced("closure", "inverse tone mapping; none = the plate already is scene radiance")
    region: Region = parameter(
        "upper", "where the expansion acts: the whole sphere, above the horizon, Snell's cone", internal="comparisons"
    )
    peak: float = parameter(
        12.0, "radiance that display white expands to (landis, akyuz, piecewise)", unit="1", low=1.0, high=1e4,
        internal="comparisons",
    )  # fmt: skip
    direct_to_diffuse: float | None = advanced(
        None, "sun's horizontal irradiance over the sky's, for the closure; none = as the plate's sky and ground tell",
        unit="1", low=0.0, high=100.0,
    )  # fmt: skip
    sun: SunSource = parameter("detect", "where the sun's direction comes from")
    sun_azimuth_deg: float = parameter(
        0.0, "given sun: azimuth, 0 = centre of the levelled frame, + = right", unit="deg", low=-360.0, high=360.0
    )
    sun_elevation_deg: float = parameter(
        60.0, "given sun: elevation above the horizon as the camera sees it", unit="deg", low=0, high=90
    )
    sun_time: str = parameter("", "date and time of the shot with its zone, ISO 8601: 2026-06-21T12:00:00+00:00")
    place_deg: tuple[Latitude, Longitude] = parameter((0.0, 0.0), "latitude and longitude, + = north, east", unit="deg")
    heading_deg: float = parameter(
        0.0, "compass heading of the frame's centre, 0 = north, + = east", unit="deg", low=-360.0, high=360.0
    )
    exposure: float = parameter(0.0, EXPOSURE, unit="stops", low=-10.0, high=10.0)
    white_cd_m2: float = parameter(
        2000.0, "luminance that the plate's white stands for: how bright lamps look beside it", unit="cd/m2",
        above=0.0, high=1e7,
    )  # fmt: skip
    track: Path | None = parameter(None, "track of the sun that `analyse` wrote (.json or .csv), edited or not")
    smooth: bool = parameter(
        True, "whether a first pass over the clip smooths the sun it detects and the haze's gain", internal="the clip"
    )

    @model_validator(mode="after")
    def _daylight(self) -> LightSettings:
        if self.sun == "date":
            daylight_angles(self.sun_time, *self.place_deg)
        return self

    @property
    def given_direction(self) -> Array | None:
        """Direction (3,) of a sun that is not detected: "given" as the camera sees it, "date" in the air, else None."""
        if self.sun == "given":
            return direction_from_angles(math.radians(self.sun_azimuth_deg), math.radians(self.sun_elevation_deg))
        if self.sun == "date":
            azimuth, elevation = daylight_angles(self.sun_time, *self.place_deg)
            return direction_from_angles(azimuth - math.radians(self.heading_deg), elevation)
        return None


# Azimuth and elevation of the sun above the water, from date and place.
#
# Low precision coordinates of the sun (Meeus 1998, chapters 12, 13 and 25), good to 0.01 degrees from 1950 to 2050,
# with the refraction of the air (Saemundsson 1986). Refraction at the water surface is left to the caller.


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
