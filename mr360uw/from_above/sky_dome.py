# SPDX-License-Identifier: Apache-2.0
"""Domes of radiance for a scene's sky: CIE standard general skies, or a map.

    L ~ (1 + a exp(b/cos Z)) (1 + c (exp(d X) - exp(d pi/2)) + e cos^2 X)

Z: angle from the zenith, X: from the sun (CIE S 011/E:2003; types 1 and 12).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import decode
from mr360uw.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R, PI
from mr360uw.from_above.settings import AerialScene
from mr360uw.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.types import Sun
from mr360uw.video.read.images import read_picture

Array = NDArray[np.float64]

_ROWS = 64
"""Rows of the dome of a standard sky: 3 degrees, over which it changes by some per cent."""
_MOST_ROWS = 512
"""Rows that maps are reduced to: what waves mirror is blurred more."""
_SHAPES = {"overcast": (4.0, -0.7, 0.0, -1.0, 0.0), "clear": (-1.0, -0.32, 10.0, -3.0, 0.45)}
"""a to e of types 1 and 12."""
_SHARE = {"overcast": 0.5, "clear": 0.2}
"""Irradiance of level ground over that of the sun's beam across itself. A clear sky gives 10 to 20 % of all light with
the sun high."""
_HORIZON = 0.02
"""Least cosine from the zenith: the exponent has a pole at the horizon."""


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
    dome = general_sky(_SHAPES[sky.kind], _sun_direction(scene))
    return _scaled(dome[..., None] * color, _SHARE[sky.kind] if sky.irradiance is None else sky.irradiance)


def general_sky(shape: tuple[float, float, float, float, float], sun: Array, rows: int = _ROWS) -> Array:
    """Return the relative radiance (rows, 2 rows) of a CIE general sky above the horizon, 0 below it.

    shape: a to e. sun: (3,) direction towards it.
    """
    a, b, c, d, e = shape
    view = directions(2 * rows, rows)
    up, cosine = view[..., 1], np.clip(view @ sun, -1.0, 1.0)
    gradation = 1.0 + a * np.exp(b / np.maximum(up, _HORIZON))
    indicatrix = 1.0 + c * (np.exp(d * np.arccos(cosine)) - math.exp(d * 0.5 * PI)) + e * cosine**2
    return np.where(up > 0.0, gradation * indicatrix, 0.0)


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
