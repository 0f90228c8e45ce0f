# SPDX-License-Identifier: Apache-2.0
"""Division of camera rays into segments of equal transmittance, and where rays end.

Segment edges are uniform in t over [0, 1], with x = rate reach. Beyond an optical length of `_STEEPEST` no light is
left; reach is bounded so that |x| is no more:

    r(t) = -reach log(1 - t (1 - exp(-x)))/x        t(r) = (1 - exp(-x r/reach))/(1 - exp(-x))

For the light of a lamp, rays are divided where the lamp sees equal angles of them. With s0 the foot of the
perpendicular from the lamp to the ray and h the lamp's distance from it,

    s = s0 + w tan(u)        w^2 = h^2 + r_min^2        ds/r^2 = w (1 + tan(u)^2)/r^2 du <= 2/w du

(Kulla & Fajardo 2012, with a width that does not vanish for rays through the lamp). r is never less than r_min, the
lamp's radius or `NEAREST_LAMP_M`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import LONGEST_RAY_M, NEAREST_LAMP_M
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.shapes import numbers
from mr360uw.types import Floats, Lamp, View

Array = NDArray[np.float64]

_STEEPEST = 30.0
_STRAIGHT = 1e-6
"""Below this optical length segments are even; the next term of the series is half of it."""


def radius_at(t: ArrayLike, rate: ArrayLike, reach_m: ArrayLike) -> Array:
    """Return distances (...,) [m] along rays at fractions t of their light. rate: [1/m] at which that light fades."""
    t, x, reach = _coordinates(t, rate, reach_m)
    curved = np.where(np.abs(x) > _STRAIGHT, x, 1.0)
    return np.where(np.abs(x) > _STRAIGHT, -reach * np.log1p(t * np.expm1(-curved)) / curved, reach * t)


def fraction_at(radius_m: ArrayLike, rate: ArrayLike, reach_m: ArrayLike) -> Array:
    """Return the fractions (...,) in [0, 1] at distances [m], the inverse of `radius_at`."""
    r, x, reach = _coordinates(radius_m, rate, reach_m)
    part = np.clip(np.divide(r, reach, out=np.zeros(r.shape), where=reach > 0.0), 0.0, 1.0)
    curved = np.where(np.abs(x) > _STRAIGHT, x, 1.0)
    return np.where(np.abs(x) > _STRAIGHT, np.expm1(-curved * part) / np.expm1(-curved), part)


def _coordinates(first: ArrayLike, rate: ArrayLike, reach_m: ArrayLike) -> tuple[Array, Array, Array]:
    first, rate, reach = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (first, rate, reach_m)))
    reach = np.minimum(reach, _STEEPEST / np.maximum(np.abs(rate), 1e-30))
    return first, rate * reach, reach


def segment_points(origin: Array, directions: Array, edge_m: Array, at: float = 0.5) -> tuple[Array, Array]:
    """Return a point of each segment (m k, 3) in the world, and the vector (m k, 3) [m] along it.

    directions: (m, 3). edge_m: (m, k + 1), or (1, k + 1) for all. at: where in a segment the point is, as a fraction.
    """
    length = np.diff(edge_m)
    point = origin + (edge_m[:, :-1] + at * length)[..., None] * directions[:, None]
    along = length[..., None] * directions[:, None]
    return point.reshape(-1, 3), along.reshape(-1, 3)


def camera_depth_m(view: View, surface_y_m: float) -> float:
    """Return the depth [m] of a view's camera; raise `ParameterError` for a camera above the water."""
    depth = surface_y_m - float(view.position[1])
    if not depth >= 0.0:
        raise ParameterError(
            f"view - the camera is above the water (got a depth of {depth:g} m) - lower it, or give surface_y_m"
        )
    return depth


def ray_ends_m(view: View, directions: Array, surface_y_m: float, bodies: Bodies, end_m: ArrayLike | None) -> Array:
    """Return the length (n,) [m] of camera rays (n, 3): to the surface, the first body, or `end_m`, scalar or (H, W).

    Raises `ParameterError` for a camera above the water and distances that are negative or no numbers.
    """
    depth = camera_depth_m(view, surface_y_m)
    given: Array = np.full(len(directions), LONGEST_RAY_M)
    if end_m is not None:
        ends = numbers("end_m", end_m, infinite=True).astype(np.float64, copy=False)
        if ends.shape not in ((), (view.height, view.width)) or not np.all(ends >= 0.0):
            raise ParameterError(
                f"end_m - must be distances >= 0 of shape () or {(view.height, view.width)} "
                f"(got {ends.shape}, least {np.min(ends, initial=np.inf):g}) - give metres along the rays"
            )
        given = np.broadcast_to(ends, (view.height, view.width)).ravel()
    nearest = np.minimum(given, bodies.first_hit_m(np.asarray(view.position, np.float64), directions))
    return ray_in_water(nearest, depth, np.clip(directions[:, 1], -1.0, 1.0))


def view_directions(view: View) -> Array:
    """Return the unit directions (H W, 3) of a view's pixel centres in the world, row by row."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    return np.asarray(view.directions(x, y), np.float64).reshape(-1, 3)


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
