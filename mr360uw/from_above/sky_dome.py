# SPDX-License-Identifier: Apache-2.0
"""Domes of radiance for a scene's sky: standard skies, or a map."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import decode
from mr360uw.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R
from mr360uw.from_above.settings import AerialScene
from mr360uw.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.surface.standard_sky import CLEAR, OVERCAST, standard_sky
from mr360uw.types import Sun
from mr360uw.video.read.images import read_picture

Array = NDArray[np.float64]

_MOST_ROWS = 512
"""Rows that maps are reduced to: what waves mirror is blurred more."""
_SHAPES = {"overcast": OVERCAST, "clear": CLEAR}
_SHARE = {"overcast": 0.5, "clear": 0.2}
"""Irradiance of level ground over that of the sun's beam across itself. A clear sky gives 10 to 20 % of all light with
the sun high."""


def sun_of(scene: AerialScene) -> Sun | None:
    """Return the sun of a scene; None where it has none."""
    given = scene.sun.irradiance
    irradiance = np.full(3, 1.0 if scene.sky.kind == "clear" else 0.0) if given is None else np.array(given)
    if not np.any(irradiance > 0.0):
        return None
    return Sun(_sun_direction(scene), irradiance, scene.sun.half_angle_rad, 1.0)


def sky_of(scene: AerialScene) -> Array:
    """Return the radiance (h, 2 h, 3) of a scene's sky, without its sun; raise `VideoError` for maps that cannot be
    read.
    """
    sky = scene.sky
    if sky.kind == "map":
        assert sky.map is not None
        return _scaled(_map(sky.map, sky.turn_deg), sky.irradiance)
    color = np.array([CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B]) if sky.kind == "clear" else np.ones(3)
    dome = standard_sky(_SHAPES[sky.kind], _sun_direction(scene))
    return _scaled(dome[..., None] * color, _SHARE[sky.kind] if sky.irradiance is None else sky.irradiance)


def _sun_direction(scene: AerialScene) -> Array:
    return direction_from_angles(math.radians(scene.sun.azimuth_deg), math.radians(scene.sun.elevation_deg))


def _map(path: Path, turn_deg: float) -> Array:
    """Return the radiance (h, 2 h, 3) of a picture of the sky, turned to the right."""
    import cv2

    codes = read_picture(path)
    light = codes.astype(np.float64)
    if codes.dtype.kind != "f":
        light = np.asarray(decode(light / np.iinfo(codes.dtype).max, "srgb"), np.float64)
    rows = min(max(codes.shape[0] // 2 * 2, 2), _MOST_ROWS)
    light = np.asarray(cv2.resize(light, (2 * rows, rows), interpolation=cv2.INTER_AREA), np.float64)
    light = np.maximum(np.nan_to_num(light, posinf=0.0, neginf=0.0), 0.0)
    return np.roll(light, round(turn_deg / 360.0 * 2 * rows), axis=1)


def _scaled(dome: Array, irradiance: float | None) -> Array:
    """Return a dome with a mean irradiance of level ground; the dome itself for None or a dark one."""
    height, width = dome.shape[:2]
    weight = row_solid_angle(width, height) * np.maximum(directions(width, height)[:, 0, 1], 0.0)
    total = float(np.mean(np.einsum("hwc,h->c", dome, weight)))
    return dome if irradiance is None or total <= 0.0 else dome * (irradiance / total)
