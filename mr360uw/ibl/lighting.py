# SPDX-License-Identifier: Apache-2.0
"""Environment maps of a plate: radiance, irradiance, glossy levels, and the same without the sun."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.ibl.cosine import cosine_beam, cosine_filter
from mr360uw.ibl.expansion import checked_plate, expand
from mr360uw.ibl.glossy import glossy_levels
from mr360uw.ibl.plate import COARSE_SCALE, LinearPlate
from mr360uw.ibl.reduce import reduce_map
from mr360uw.ibl.settings import LightSettings, Operator
from mr360uw.ibl.sun import find_disc, sun_of_disc
from mr360uw.ibl.tangent import patch_directions, patch_solid_angle
from mr360uw.sphere import frame_from_direction, row_solid_angle
from mr360uw.types import Environment, Floats, Sun


def environment(
    plate: ArrayLike,
    settings: LightSettings | None = None,
    *,
    expansion: Operator | None = None,
    sun: Sun | Literal["detect"] | None = "detect",
    underwater: bool = False,
    glossy: bool = False,
) -> Environment:
    """Return the light of a linear plate (H, W, 3)."""
    settings = settings or LightSettings()
    if expansion is not None:
        settings = settings.model_copy(update={"operator": expansion})
    raw = LinearPlate.of(checked_plate(plate))
    seen = raw if settings.operator in ("none", "closure") else LinearPlate.of(expand(raw.image, settings))
    if sun == "detect":
        disc = find_disc(raw, underwater=underwater)
        sun = None if disc is None or disc.confidence < settings.minimum_confidence else sun_of_disc(seen, disc)
    coarse = seen.coarse
    residual = coarse if sun is None else without_sun(coarse, sun)
    return assemble(coarse, residual, sun, settings.glossy_roughness if glossy else ())


def without_sun(coarse: Floats, sun: Sun) -> Floats:
    """Return a coarse map with the sun's light taken out of the pixels of its disc."""
    height, width = coarse.shape[:2]
    radius = max(2.0 * sun.half_angle_rad, np.radians(1.0))
    x, y = frame_from_direction(patch_directions(sun.direction, radius, 33), width, height)
    share = np.zeros((height, width))
    np.add.at(share, (np.minimum(y.astype(int), height - 1), x.astype(int) % width), patch_solid_angle(radius, 33))
    share *= luminance_of(coarse)
    taken = share / share.sum() / row_solid_angle(width, height)[:, None]
    return np.maximum(coarse - taken[..., None] * sun.irradiance, 0.0).astype(np.float32)


def luminance_of(image: Floats) -> Floats:
    """Return the luminance, kept above zero."""
    return np.maximum(image @ np.array([0.2126, 0.7152, 0.0722]), 1e-6)


def assemble(coarse: Floats, residual: Floats, sun: Sun | None, roughness: tuple[float, ...]) -> Environment:
    """Return the environment of coarse maps (128, 256, 3) with and without the sun."""
    ambient = cosine_filter(COARSE_SCALE)(residual)
    irradiance = ambient if sun is None else ambient + cosine_beam(sun.direction, sun.irradiance)
    return Environment(
        radiance=reduce_map(coarse, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS),
        irradiance=irradiance,
        sun=sun,
        residual=reduce_map(residual, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS),
        ambient=ambient,
        glossy=glossy_levels(residual, roughness),
        glossy_roughness=np.asarray(roughness, np.float32),
    )
