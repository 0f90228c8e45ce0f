# SPDX-License-Identifier: Apache-2.0
"""Light of a lamp along camera rays, divided where the lamp sees equal angles of them.

With s0 the foot of the perpendicular from the lamp to the ray and h the lamp's distance from it,

    s = s0 + w tan(u)        w^2 = h^2 + r_min^2        ds/r^2 = w (1 + tan(u)^2)/r^2 du <= 2/w du

(Kulla & Fajardo 2012, with a width that does not vanish for rays through the lamp). r is never less than r_min, the
lamp's radius or `NEAREST_LAMP_M`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import NEAREST_LAMP_M
from mr360uw.types import Floats, Lamp

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LampSegments:
    """Segments of m rays. light: (m, k) integral of spot(angle)/r^2 over each [1/m]. cosine: (m, k) of the angle by
    which light turns. distance_m: (m, k) from the camera. path_m: (m, k) from the lamp over the segment to the camera.
    point: (m, k, 3) in the world.
    least_m: distance from the lamp within which nothing shades.
    """

    light: Array
    cosine: Array
    distance_m: Array
    path_m: Array
    point: Array
    least_m: float


def nearest_m(lamp: Lamp) -> float:
    """Return the distance [m] from a lamp's centre within which irradiance is constant and nothing casts a shadow."""
    return max(lamp.radius_m, NEAREST_LAMP_M)


def spot_factor(lamp: Lamp, towards: Floats) -> Array:
    """Return the fraction (...,) of the axial intensity that a lamp emits against unit directions `towards` it.

    1 within the core of the cone, 0 beyond its edge, a smooth step of the cosine between.
    """
    if lamp.cos_edge <= -1.0:
        return np.ones(towards.shape[:-1])
    cosine = -(towards @ lamp.axis)
    t = np.clip((cosine - lamp.cos_edge) / max(lamp.cos_core - lamp.cos_edge, 1e-6), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def lamp_segments(
    lamp: Lamp, origin: Array, directions: Array, start_m: Array, end_m: Array, count: int
) -> LampSegments:
    """Return `count` segments of rays (m, 3) from one point between distances start_m and end_m (m,)."""
    least = nearest_m(lamp)
    to_lamp = np.asarray(lamp.position, np.float64) - origin
    foot = directions @ to_lamp
    beside = np.linalg.norm(to_lamp - foot[:, None] * directions, axis=-1)
    width = np.sqrt(beside * beside + least * least)
    first, last = (np.arctan2(s - foot, width) for s in (start_m, end_m))
    step = (last - first) / count
    tangent = np.tan(first[:, None] + (np.arange(count) + 0.5) * step[:, None])
    s = np.maximum(foot[:, None] + width[:, None] * tangent, 0.0)
    point = origin + s[..., None] * directions[:, None]
    away = np.asarray(lamp.position, np.float64) - point
    r = np.maximum(np.linalg.norm(away, axis=-1), least)
    towards = away / r[..., None]
    light = spot_factor(lamp, towards) / (r * r) * width[:, None] * (1.0 + tangent * tangent) * step[:, None]
    cosine = np.einsum("mkc,mc->mk", towards, directions)
    return LampSegments(light, cosine, s, r + s, point, least)
