# SPDX-License-Identifier: Apache-2.0
"""Environment maps of a plate: radiance, irradiance, glossy levels, and the same without the sun."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, SUN_HALF_ANGLE_RAD
from mr360uw.errors import ParameterError
from mr360uw.ibl.blob import CLIPPED
from mr360uw.ibl.cosine import cosine_beam, cosine_filter
from mr360uw.ibl.expansion import checked_plate
from mr360uw.ibl.glossy import glossy_levels
from mr360uw.ibl.plate import COARSE_SCALE, LinearPlate, Plate
from mr360uw.ibl.reduce import reduce_map
from mr360uw.ibl.settings import LightSettings, Operator
from mr360uw.ibl.solar import given_direction
from mr360uw.ibl.split import Split, close, split_sun, with_sun
from mr360uw.ibl.sun import DISPLAY_WHITE, find_disc, split_disc
from mr360uw.sphere import unit
from mr360uw.types import Environment, Floats, Sun

SunChoice = Sun | Literal["detect"] | NDArray[np.floating[Any]] | None


def environment(
    plate: ArrayLike,
    settings: LightSettings | None = None,
    *,
    expansion: Operator | None = None,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
) -> Environment:
    """Return the light of a linear plate (H, W, 3), of any size.

    settings: how to expand it; `expansion` overrides their operator, "none" says that the plate is scene radiance
    already. sun: "detect" takes it from where the settings say, by default looks for one (inside Snell's window if
    `underwater`) and leaves it in the sky where the confidence is too low; a direction (3,) as the camera sees it
    measures the light there; a `Sun` replaces whatever shines there; None leaves all light in the sky. glossy: also
    filter the residual at the roughnesses of the settings. Raises `ParameterError` for arrays that are no plate.
    """
    settings = settings or LightSettings()
    if expansion is not None:
        settings = LightSettings(**{**settings.model_dump(), "operator": expansion})
    return light_of(LinearPlate.of(checked_plate(plate), settings), settings, sun, underwater, glossy)


def light_of(
    plate: Plate, settings: LightSettings, sun: SunChoice = "detect", underwater: bool = False, glossy: bool = False
) -> Environment:
    """Return the light of a plate whatever its storage; see `environment`."""
    split = _split(plate, settings, sun, underwater)
    coarse = plate.coarse if split is None else with_sun(split.residual, split.sun)
    residual = coarse if split is None else split.residual
    return assemble(coarse, residual, None if split is None else split.sun, settings.glossy_roughness if glossy else ())


def _split(plate: Plate, settings: LightSettings, sun: SunChoice, underwater: bool) -> Split | None:
    if isinstance(sun, str):
        if settings.sun == "none":
            return None
        if settings.sun == "date" and underwater:
            raise ParameterError(
                'sun - "date" is a place in the air (got a plate under water) - refract it, pass it as sun'
            )
        direction = given_direction(settings)
        if direction is None:
            return _detected(plate, settings, underwater)
        sun = direction
    if sun is None:
        return None
    if isinstance(sun, Sun):
        return Split(split_sun(plate, sun.direction, sun.half_angle_rad, sun.confidence).residual, sun)
    direction = unit(sun)
    split = split_sun(plate, direction, SUN_HALF_ANGLE_RAD, 1.0)
    clipped = settings.operator == "closure" and float(plate.brightest.max()) <= DISPLAY_WHITE
    return close(split, settings.direct_to_diffuse) if clipped else split


def _detected(plate: Plate, settings: LightSettings, underwater: bool) -> Split | None:
    disc = find_disc(plate, underwater=underwater)
    if disc is None or disc.confidence < settings.minimum_confidence:
        return None
    split = split_disc(plate, disc)
    clipped = float(plate.brightest.max()) <= DISPLAY_WHITE and disc.blob.peak >= CLIPPED
    return close(split, settings.direct_to_diffuse) if clipped and settings.operator == "closure" else split


def assemble(coarse: Floats, residual: Floats, sun: Sun | None, roughness: tuple[float, ...] = ()) -> Environment:
    """Return the environment of coarse maps (128, 256, 3) with and without the sun."""
    ambient = cosine_filter(COARSE_SCALE)(residual)
    return Environment(
        radiance=reduce_map(coarse, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS),
        irradiance=ambient if sun is None else ambient + cosine_beam(sun.direction, sun.irradiance),
        sun=sun,
        residual=reduce_map(residual, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS),
        ambient=ambient,
        glossy=glossy_levels(residual, roughness),
        glossy_roughness=np.asarray(roughness, np.float32),
    )
