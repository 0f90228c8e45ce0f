# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sea, its floor and its sky by a camera below or above the water.

Camera rays meet the moving surface and part there by Fresnel's equations: in the water they reach the floor, or the
surface again; in the air the sky, or another wave. Waves smaller than a pixel act by the statistics of their slopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.surface.ray_tree import Rays, Stage, meet, refracted_distance, trace
from mr360uw.surface.slopes import next_keys
from mr360uw.types import View

Array = NDArray[np.float64]

_AT_ONCE = 1 << 17
"""Rays that are traced together: with all they become they take 0.2 GB."""


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


def rendered(stage: Stage, view: View, samples: int) -> SurfacePicture:
    """Return the picture, made in bands of rows. samples: per pixel and axis."""
    in_water = stage.camera_in_water
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
        radiance[band] = trace(stage, rays, shape[0] * width).reshape(*shape, 3)
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
    first = np.uint32(rows.start * view.width * samples * samples)
    spread = np.full(count, view.pixel_rad / samples)
    return Rays(
        pixel, next_keys(np.arange(count, dtype=np.uint32) + first, 0), np.ascontiguousarray(origin),
        np.ascontiguousarray(direction), np.full((count, 3), 1.0 / samples**2),
        np.full(count, view.pixel_m / samples), spread, np.zeros(count),
    )  # fmt: skip
