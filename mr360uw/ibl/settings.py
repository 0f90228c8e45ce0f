# SPDX-License-Identifier: Apache-2.0
"""Settings of the light: the `[light]` table of a scene."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Literal

from pydantic import field_validator, model_validator

from mr360uw.color import DisplayTransfer
from mr360uw.constants import MAXIMUM_GLOSSY_LEVELS
from mr360uw.ibl.sun.solar import daylight_angles
from mr360uw.parameters import Parameters, parameter

Operator = Literal["none", "mr360", "landis", "akyuz", "kovaleski", "piecewise", "closure"]
OPERATORS: tuple[Operator, ...] = ("none", "mr360", "landis", "akyuz", "kovaleski", "piecewise", "closure")
Region = Literal["all", "upper", "snell"]
SunSource = Literal["detect", "given", "date", "none"]

MINIMUM_ROUGHNESS = 0.05
"""Below it the lobe is far narrower than a pixel of the finest source map."""


class LightSettings(Parameters):
    """Light from the plate: expansion to scene radiance, the region it acts in, and the source of the sun."""

    operator: Operator = parameter("closure", "inverse tone mapping; none = the plate already is scene radiance")
    transfer: DisplayTransfer = parameter("srgb", "curve from code values to linear light that the operators assume")
    region: Region = parameter("upper", "where the expansion acts: the whole sphere, above the horizon, Snell's cone")
    ramp_deg: float = parameter(10.0, "half width of the smooth edge of that region", unit="deg", low=0.0, high=45.0)
    peak: float = parameter(
        12.0, "radiance that display white expands to (landis, akyuz, piecewise)", unit="1", low=1.0, high=1e4
    )
    mr360_strength: float = parameter(10.0, "factor of the MR360 power term", unit="1", low=0.0, high=1e3)
    mr360_power: float = parameter(10.0, "exponent of the MR360 power term", unit="1", low=1.0, high=40.0)
    mr360_base: float = parameter(1.8, "gain of black under MR360", unit="1", low=0.1, high=10.0)
    landis_threshold: float = parameter(0.5, "luminance above which Landis expands", unit="1", low=0.0, high=0.99)
    landis_alpha: float = parameter(2.0, "exponent of the Landis blend", unit="1", low=0.1, high=10.0)
    akyuz_gamma: float = parameter(1.0, "exponent of the Akyuz scale", unit="1", low=0.1, high=10.0)
    kovaleski_threshold: float = parameter(
        0.9, "code value of the brightest channel that Kovaleski-Oliveira enhance", unit="1", low=0.1, high=1.0
    )
    kovaleski_boost: float = parameter(3.0, "gain they add where it is enhanced fully", unit="1", low=0.0, high=1e3)
    piecewise_split: float = parameter(
        0.85, "luminance of diffuse white, above which the piecewise curve is steep", unit="1", low=0.01, high=0.99
    )
    direct_to_diffuse: float | None = parameter(
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
    latitude_deg: float = parameter(0.0, "place of the shot, + = north", unit="deg", low=-90.0, high=90.0)
    longitude_deg: float = parameter(0.0, "place of the shot, + = east", unit="deg", low=-180.0, high=180.0)
    heading_deg: float = parameter(
        0.0, "compass heading of the frame's centre, 0 = north, + = east", unit="deg", low=-360.0, high=360.0
    )
    minimum_confidence: float = parameter(
        0.5, "confidence at which half a detected sun's light is its beam: from half of it some, at 1.5 times it all",
        unit="1", low=0.0, high=1.0,
        fixed="one holds for the clip's whole track",
    )  # fmt: skip
    exposure: float = parameter(
        0.0, "brighter (+) or darker (-) than the plate's light makes them: all objects, see object.exposure",
        unit="stops", low=-10.0, high=10.0,
    )  # fmt: skip
    white_cd_m2: float = parameter(
        2000.0, "luminance that the plate's white stands for: how bright lamps look beside it", unit="cd/m2",
        above=0.0, high=1e7,
    )  # fmt: skip
    track: Path | None = parameter(None, "track of the sun that `analyse` wrote (.json or .csv), edited or not")
    smooth: bool = parameter(True, "whether a first pass over the clip smooths the sun it detects and the haze's gain")
    glossy_roughness: tuple[float, ...] = parameter(
        (0.1, 0.2, 0.4, 0.7, 1.0), "roughnesses of the glossy levels, ascending in [0.05, 1], at most 8", unit="1"
    )

    @field_validator("glossy_roughness")
    @classmethod
    def _glossy_levels(cls, levels: tuple[float, ...]) -> tuple[float, ...]:
        if len(levels) > MAXIMUM_GLOSSY_LEVELS:
            raise ValueError(f"holds at most {MAXIMUM_GLOSSY_LEVELS} levels: leave some out")
        if any(not MINIMUM_ROUGHNESS <= level <= 1.0 for level in levels):
            raise ValueError(f"must lie in [{MINIMUM_ROUGHNESS}, 1]: smoother surfaces take the first")
        if any(b <= a for a, b in itertools.pairwise(levels)):
            raise ValueError("must ascend: sort it, without repeats")
        return levels

    @model_validator(mode="after")
    def _daylight(self) -> LightSettings:
        if self.sun == "date":
            daylight_angles(self.sun_time, self.latitude_deg, self.longitude_deg)
        return self
