# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sea, its floor and its sky by a camera below or above the water.

Camera rays meet the moving surface and part there by Fresnel's equations: in the water they reach the floor, or the
surface again; in the air the sky, or another wave. Waves smaller than a pixel act by the statistics of their slopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.caustics import CausticSettings
from mr360uw.caustics.settings import Sea
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.medium import Medium, Water
from mr360uw.optics import check_refractive_index
from mr360uw.shapes import exactly, number
from mr360uw.sphere import unit
from mr360uw.surface.ray_tree import Rays, Stage, meet, refracted_distance, trace
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import Floor
from mr360uw.surface.sky import Dome
from mr360uw.surface.slopes import next_keys
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Sun, View

Array = NDArray[np.float64]

_AT_ONCE = 1 << 17
"""Rays that are traced together: with all they become they take 0.2 GB."""
_MOST_SAMPLES = 32


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePicture:
    """A picture of the sea.

    radiance: (H, W, 3) linear, in units of the dome's. What follows is of the ray through each pixel's centre.
    distance_m: (H, W) to the first of surface and floor, infinity for the sky and for level rays. in_water_m: (H, W)
    length in the water: that distance, or for a camera above the waves that of the refracted ray, 0 where there is
    none. normal: (H, W, 3) of the surface, up, zero where it is not met. surface, floor: (H, W) masks of what is met
    first. camera_in_water: on which side of the waves the camera is.
    """

    radiance: Array
    distance_m: Array
    in_water_m: Array
    normal: Array
    surface: NDArray[np.bool_]
    floor: NDArray[np.bool_]
    camera_in_water: bool


def picture(
    sea: Sea,
    dome: ArrayLike,
    floor: Floor | tuple[float, ArrayLike],
    view: View,
    water: Water | Medium | None = None,
    *,
    sun: Sun | None = None,
    time_s: float = 0.0,
    samples: int = 2,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    caustics: CausticSettings | None = None,
) -> SurfacePicture:
    """Return what a camera below or above a moving sea sees, in float64.

    dome: (h, w, 3) equirectangular radiance of the sky, of which the upper half is read; a sun in it is part of the
    sky. floor: a `Floor`, or its height [m] in the world and its albedo. view: its `surface_y_m` is the height of the
    mean surface. water: None for clear water; else its scattered light is that of the solved field of deep water.
    sun: a sun that is not in the dome, as seen in the air; below the horizon it gives no light. samples: per pixel and
    axis, 1 to 32. caustics: resolution of the sun's pattern on the floor.

    Raises `ParameterError`, also for cameras below the floor.
    """
    check_refractive_index(refractive_index)
    if not 1 <= samples <= _MOST_SAMPLES:
        raise ParameterError(f"samples - outside 1 to {_MOST_SAMPLES} (got {samples}) - take 2 to 4")
    if not isinstance(floor, Floor) and (not isinstance(floor, tuple) or len(floor) != 2):
        raise ParameterError(f"floor - must be a Floor, or height and albedo (got {floor!r:.40}) - give (-5.0, 0.3)")
    if water is not None and not isinstance(water, Water | Medium):
        raise ParameterError(f"water - must be a Water, a Medium or None (got {water!r:.40}) - see uw.medium.Water")
    ground = floor if isinstance(floor, Floor) else Floor(*floor)
    sky, light = Dome(dome), _checked(sun)
    position = exactly("view.position", view.position, (3,)).astype(np.float64)
    if not position[1] > ground.height_m:
        raise ParameterError(
            f"view - the camera must be above the floor (got y = {position[1]:g} over {ground.height_m:g} m) - raise it"
        )
    sampled = SampledSea.of(sea, number("time_s", time_s))
    over = float(position[1] - view.surface_y_m)
    in_water = over < float(sampled.heights(position[[0]], position[[2]])[0])
    water_light = WaterLight.of(water, sky, light, max(-over, 0.01) if in_water else None, refractive_index)
    depth = view.surface_y_m - ground.height_m
    floor_light = water_light.on_floor(
        sea, sky, light, depth, time_s, refractive_index, ground.mean_albedo, caustics or CausticSettings()
    )
    stage = Stage(
        sampled, sky, ground, -depth, floor_light, water_light, light, refractive_index, samples * samples
    )  # fmt: skip
    return _rendered(stage, view, in_water, samples)


def _checked(sun: Sun | None) -> Sun | None:
    if sun is None:
        return None
    if not 0.0 < number("sun.half_angle_rad", sun.half_angle_rad) <= 0.5:
        raise ParameterError(f"sun.half_angle_rad - outside (0, 0.5] (got {sun.half_angle_rad}) - the sun has 0.00465")
    irradiance = exactly("sun.irradiance", sun.irradiance, (3,)).astype(np.float64)
    direction = unit(exactly("sun.direction", sun.direction, (3,)))
    return Sun(direction, irradiance, float(sun.half_angle_rad), sun.confidence)


def _rendered(stage: Stage, view: View, in_water: bool, samples: int) -> SurfacePicture:
    """Return the picture, made in bands of rows."""
    height, width = view.height, view.width
    radiance, distance, wet = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width))
    normal = np.zeros((height, width, 3))
    surface, floor = np.zeros((height, width), bool), np.zeros((height, width), bool)
    rows = max(_AT_ONCE // (width * samples * samples), 1)
    for first in range(0, height, rows):
        band = slice(first, min(first + rows, height))
        shape = (band.stop - first, width)
        middle = _camera_rays(view, band, 1)
        met, hits = meet(stage, middle, in_water)
        wet[band] = (met.distance if in_water else refracted_distance(stage, middle, hits)).reshape(shape)
        distance[band], normal[band] = met.distance.reshape(shape), met.normal.reshape(*shape, 3)
        surface[band], floor[band] = met.surface.reshape(shape), met.floor.reshape(shape)
        rays = _camera_rays(view, band, samples)
        radiance[band] = trace(stage, rays, in_water, shape[0] * width).reshape(*shape, 3)
    return SurfacePicture(radiance, distance, wet, normal, surface, floor, in_water)


def _camera_rays(view: View, rows: slice, samples: int) -> Rays:
    """Return the rays of a band of rows, `samples` squared in each pixel, evenly placed."""
    place = (np.arange(samples) + 0.5) / samples
    row = np.arange(rows.start, rows.stop)[:, None] + place
    column = np.arange(view.width)[:, None] + place
    y, x = np.broadcast_arrays(row[:, None, :, None], column[None, :, None, :])
    count = x.size
    pixel = np.repeat(np.arange(count // samples**2), samples**2)
    direction = view.directions(x, y).reshape(count, 3)
    origin = view.origins(x, y).reshape(count, 3) - np.array([0.0, view.surface_y_m, 0.0])
    first = np.uint64(rows.start * view.width * samples * samples)
    spread = np.full(count, view.pixel_rad / samples)
    return Rays(
        pixel, next_keys(np.arange(count, dtype=np.uint64) + first, 0), np.ascontiguousarray(origin),
        np.ascontiguousarray(direction), np.full((count, 3), 1.0 / samples**2),
        np.full(count, view.pixel_m / samples), spread, np.zeros(count),
    )  # fmt: skip
