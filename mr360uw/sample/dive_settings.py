# SPDX-License-Identifier: Apache-2.0
"""Parameters of a synthetic dive: depths, water, sky, waves, floor, camera, recording; and named dives."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from importlib import resources
from math import radians
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import ValidationError, model_validator

from mr360uw.base.constants import PI
from mr360uw.base.parameters import Parameters, checked, parameter
from mr360uw.base.sphere import direction_from_angles, yaw_matrix
from mr360uw.caustics import GerstnerSea
from mr360uw.errors import ParameterError
from mr360uw.medium.water import JerlovType
from mr360uw.types import Floats, View

PRESETS: Mapping[str, Mapping[str, Any]] = tomllib.loads(
    (resources.files("mr360uw.sample") / "presets.toml").read_text(encoding="utf-8")
)
"""Dives that look different: bright coral sand, a shallow lagoon, open ocean, coasts with more and more in the water, a
low sun, and a gale under clouds."""


_ABOVE_FLOOR_M = 3.5
"""Height [m] of the camera above the floor where no depth of the floor is given."""
_LEAST_ABOVE_M = 0.2
"""Least height [m] of the camera over the floor's mean."""
_TILE_M = 16.0
"""Side [m] of the square after which the waves repeat."""
_BOB_S = 4.0
"""Period [s] in which the camera bobs: that of a light swell."""


class DiveSettings(Parameters):
    """Parameters of a dive. Angles of the sun are those above the water."""

    depth_m: float = parameter(4.0, "depth of the camera at the start", unit="m", low=0.05, high=100.0)
    floor_m: float | None = parameter(
        None, "mean depth of the floor; none: 3.5 m below the camera", unit="m", low=0.25, high=200.0
    )
    water: JerlovType = parameter("IB", "Jerlov type of the water")
    sky: Literal["clear", "even", "overcast"] = parameter(
        "clear", "clear: blue, with a glow about the sun; even: the same all over, with a sun; overcast: without one"
    )
    sky_map: Path | None = parameter(None, "equirectangular HDR picture of the sky, in place of `sky` and the sun")
    sun_elevation_deg: float = parameter(57.3, "elevation of the sun", unit="deg", low=3.0, high=90.0)
    sun_azimuth_deg: float = parameter(
        34.4, "azimuth of the sun, 0 = ahead, + = right", unit="deg", low=-360.0, high=360.0
    )
    sun_share: float | None = parameter(
        None, "fraction of the light below the surface that is the sun's; none: as its elevation gives it", unit="1",
        above=0.0, high=0.95,
    )  # fmt: skip
    wind_m_s: float = parameter(3.0, "speed of the wind", unit="m/s", low=0.3, high=15.0)
    wind_direction_deg: float = parameter(35.0, "azimuth the wind blows towards", unit="deg", low=-360.0, high=360.0)
    detail_slope: float = parameter(
        0.02, "root mean square slope of ripples that are not drawn: they widen the lines of light", unit="1", low=0.0,
        high=0.5,
    )  # fmt: skip
    relief: float = parameter(
        1.0, "factor on the heights of sand, rocks and grass; 0: level", unit="1", low=0.0, high=2.0
    )
    solid: bool = parameter(
        False, "rays meet the relief, so that rocks have outlines: a frame takes several times as long; else it shades "
        "a level floor",
    )  # fmt: skip
    sand_albedo: float = parameter(
        0.34, "albedo of the sand in green: 0.1 volcanic, 0.5 white", unit="1", low=0.01, high=0.8
    )
    sand_contrast: float = parameter(
        1.0, "contrast of the sand's albedo: 1 ordinary, 0 even, 3 stones", unit="1", low=0.0, high=5.0
    )
    rocks: float = parameter(0.06, "fraction of the floor under rocks", unit="1", low=0.0, high=0.7)
    grass: float = parameter(0.1, "fraction of the floor under sea grass", unit="1", low=0.0, high=0.9)
    speed_m_s: float = parameter(0.0, "speed at which the camera swims ahead", unit="m/s", low=-10.0, high=10.0)
    yaw_deg_s: float = parameter(0.0, "rate at which the camera turns right", unit="deg/s", low=-90.0, high=90.0)
    bob_m: float = parameter(
        0.0, "amplitude of the camera's bobbing, with a period of 4 s", unit="m", low=0.0, high=2.0
    )
    stops: float = parameter(0.0, "exposure over the automatic one", unit="stops", low=-10.0, high=10.0)
    transfer: Literal["srgb", "bt709"] = parameter("srgb", "transfer curve of the codes")
    bits: Literal[8, 10] = parameter(8, "bits of a code")
    noise: float = parameter(
        0.0, "variance of the sensor's noise over that of a small camera in good light", unit="1", low=0.0, high=16.0
    )
    seed: int = parameter(1, "seed of waves, floor and noise", low=0, high=2**31 - 1)

    @model_validator(mode="after")
    def _afloat(self) -> Self:
        lowest = self.depth_m + self.bob_m + _LEAST_ABOVE_M
        if self.floor_depth_m < lowest:
            raise ValueError(
                f"floor_m - must lie below the camera (got {self.floor_depth_m:g} m) - give at least {lowest:g}"
            )
        if self.bob_m > 0.0 and self.bob_m > self.depth_m - 0.05:
            raise ValueError(
                f"bob_m - takes the camera out of the water (got {self.bob_m:g} m) - give less than {self.depth_m:g}"
            )
        return self

    @classmethod
    @checked
    def of(cls, preset: str | None = None, **options: Any) -> DiveSettings:
        """Return a preset's parameters (the defaults for None) with options that differ; None counts as not given.

        Raises `ParameterError` with a line for each problem.
        """
        from mr360uw.scene.problems import problems

        given = {name: value for name, value in options.items() if value is not None}
        lines, named = [], {} if preset is None else PRESETS.get(preset, {})
        if preset is not None and preset not in PRESETS:
            near = difflib.get_close_matches(preset, PRESETS, 1)
            advice = f"did you mean '{near[0]}'?" if near else f"take one of {', '.join(PRESETS)}"
            lines.append(f"preset - no such dive (got {preset!r:.40}) - {advice}")
        try:
            settings = cls.model_validate({**named, **given})
        except ValidationError as error:
            lines += [line.removeprefix("dive ").lstrip(" -") for line in problems(error, cls, "dive", {})]
        if lines:
            raise ParameterError("\n".join(lines))
        return settings

    @property
    def floor_depth_m(self) -> float:
        """Mean depth of the floor [m]."""
        return self.depth_m + _ABOVE_FLOOR_M if self.floor_m is None else self.floor_m

    @property
    def sun_in_air(self) -> Floats:
        """Unit direction (3,) towards the sun, above the surface; of a map of the sky it is in the map."""
        return direction_from_angles(radians(self.sun_azimuth_deg), radians(self.sun_elevation_deg))

    @property
    def sea(self) -> GerstnerSea:
        """The surface of the dive, with few ripples, as under a natural slick (Cox & Munk 1954)."""
        return GerstnerSea(
            wind_speed=self.wind_m_s, wind_direction_deg=self.wind_direction_deg, tile_m=_TILE_M, seed=self.seed,
            detail_slope=self.detail_slope,
        )  # fmt: skip

    @property
    def moves(self) -> bool:
        """Whether the camera does."""
        return bool(self.speed_m_s or self.yaw_deg_s or self.bob_m)

    def camera_at(self, time_s: float) -> tuple[Floats, Floats]:
        """Return position (3,) [m] and rotation (3, 3) of the camera, which swims where it looks."""
        rate = radians(self.yaw_deg_s)
        turned = rate * time_s
        ahead = time_s if abs(turned) < 1e-9 else np.sin(turned) / rate
        aside = 0.5 * turned * time_s if abs(turned) < 1e-9 else (1.0 - np.cos(turned)) / rate
        up = self.bob_m * np.sin(2.0 * PI * time_s / _BOB_S)
        place = np.array([self.speed_m_s * aside, up, -self.speed_m_s * ahead])
        return place, yaw_matrix(turned)

    def view(self, width: int, height: int, time_s: float) -> View:
        """Return the camera at a time: the world's origin is where it starts."""
        return View(width, height, *self.camera_at(time_s), surface_y_m=self.depth_m)
