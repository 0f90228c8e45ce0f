# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sea, its floor and its sky by a camera below or above the water.

Camera rays meet the moving surface and part there by Fresnel's equations: in the water they reach the floor, or the
surface again; in the air the sky, or another wave. Waves smaller than a pixel act by the statistics of their slopes.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import borrowing
from mr360uw.plot import Figure, Shown
from mr360uw.surface.intersection import NOWHERE, Hit
from mr360uw.surface.tracing.facet_draws import next_key
from mr360uw.surface.tracing.ray_kernel import OFF_M, STACK, RayWorld, followed, met, put
from mr360uw.surface.tracing.ray_optics import Ray, Vector, bent
from mr360uw.surface.tracing.stage_arrays import RayStage, ray_world
from mr360uw.surface.tracing.table_reads import add
from mr360uw.types import View

Array = NDArray[np.float64]

_AT_ONCE = 1 << 14
"""Rays that are traced on one thread at a time."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurfacePicture(Shown):
    """A picture of the sea; all but the radiance is of the ray through each pixel's centre.

    Masks and distances have hard edges, the radiance is the mean of all rays of a pixel. Light is linear: encode it for
    a screen.

    Parameters
    ----------
    radiance : ndarray
        Linear radiance (H, W, 3), in units of the dome's.
    distance_m : ndarray
        Distance (H, W) [m] to the first of surface and floor, infinity for the sky and for level rays.
    in_water_m : ndarray
        Length (H, W) [m] in the water: that distance, or for a camera above the waves that of the refracted ray, 0
        where there is none.
    normal : ndarray
        Normal (H, W, 3) of the surface, up, zero where it is not met.
    surface, floor : ndarray
        Masks (H, W) of what is met first.
    camera_in_water : bool
        On which side of the waves the camera is.

    See Also
    --------
    uw.surface.picture : Makes one.
    uw.plot.show : Draws the radiance.

    Examples
    --------
    >>> sea, view = uw.caustics.GerstnerSea(wave_count=4), uw.types.View(8, 4, surface_y_m=1.0)
    >>> seen = uw.surface.picture(sea, np.ones((16, 32, 3)), (-3.0, 0.3), view, samples=1)
    >>> bool(np.isfinite(seen.distance_m[seen.floor]).all())
    True
    """

    radiance: Array
    distance_m: Array
    in_water_m: Array
    normal: Array
    surface: NDArray[np.bool_]
    floor: NDArray[np.bool_]
    camera_in_water: bool

    def __repr__(self) -> str:
        height, width = self.distance_m.shape
        side = "below" if self.camera_in_water else "above"
        return f"<SurfacePicture {height} x {width}, from {side} the surface, mean {np.mean(self.radiance):.3g}>"

    def _figure(self) -> Figure:
        white = max(float(np.quantile(self.radiance, 0.99)), 1e-12)
        return Figure("radiance, white at its 99 % quantile", image=self.radiance / white)


def rendered(stage: RayStage, view: View, samples: int) -> SurfacePicture:
    """Return the picture, made in bands of rows on all cores. samples: per pixel and axis."""
    height, width, side = view.height, view.width, -1.0 if stage.camera_in_water else 1.0
    radiance, distance, wet = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width))
    normal, kind = np.zeros((height, width, 3)), np.zeros((height, width), np.uint8)
    world = ray_world(stage)
    rows = max(_AT_ONCE // (width * samples * samples), 1)

    def draw(first: int) -> None:
        band = slice(first, min(first + rows, height))
        out = radiance[band], distance[band], wet[band], normal[band], kind[band]
        origins, directions = _camera_rays(view, band, 1)
        footprint = side, view.pixel_m / samples, view.pixel_rad / samples
        middle = np.zeros((band.stop - band.start, width, 8))
        _centres(world, origins, directions, (side, view.pixel_m, view.pixel_rad), *out[1:], middle)
        if samples > 1:
            origins, directions = _camera_rays(view, band, samples)
        key = (first * width * samples * samples) % 2**32
        _samples(world, origins, directions, footprint, key, middle, np.zeros(STACK), out[0])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(draw, range(0, height, rows)))  # to see their errors
    return SurfacePicture(radiance, distance, wet, normal, kind == 1, kind == 2, stage.camera_in_water)


def _camera_rays(view: View, rows: slice, samples: int) -> tuple[Array, Array]:
    """Return origins, y over the mean surface, and directions (h, w, n, 3) of the rays of a band of rows, `samples`
    squared in each pixel, evenly placed."""
    place = (np.arange(samples) + 0.5) / samples
    row = np.arange(rows.start, rows.stop)[:, None] + place
    column = np.arange(view.width)[:, None] + place
    shape = (len(row), view.width, samples, samples)
    y, x = (a.reshape(len(row), view.width, -1) for a in np.broadcast_arrays(
        np.broadcast_to(row[:, None, :, None], shape), np.broadcast_to(column[None, :, None, :], shape)
    ))  # fmt: skip
    origins = view.origins(x, y) - np.array([0.0, view.surface_y_m, 0.0])
    return np.ascontiguousarray(origins), np.ascontiguousarray(view.directions(x, y))


@borrowing
def _centres(
    w: RayWorld, origins: Any, directions: Any, of: Vector, distance: Any, wet: Any, normal: Any, kind: Any, hits: Any
) -> None:
    """Write what the rays of pixels' centres meet: `SurfacePicture`, kind 1 for the surface, 2 for the floor, and where
    they meet the surface, hits (h, w, 8). of: side, width and spread of the rays.
    """
    side, width, spread = of
    rows, columns = distance.shape
    for row in range(rows):
        for column in range(columns):
            p, q = origins[row, column, 0], directions[row, column, 0]
            o, v = (p[0], p[1], p[2]), (q[0], q[1], q[2])
            hit, floor = met(w, Ray(o, v, side, width, spread), NOWHERE, False)
            t, length = hit.distance, 0.0
            if t < math.inf:
                kind[row, column] = 1
                nx, ny, nz = hit.normal
                normal[row, column, 0], normal[row, column, 1], normal[row, column, 2] = nx, ny, nz
                if side > 0.0:
                    d = bent(v[0], v[1], v[2], nx, ny, nz, 1.0 / w.refractive_index)
                    at = o[0] + t * v[0] + OFF_M * d[0], o[1] + t * v[1] + OFF_M * d[1], o[2] + t * v[2] + OFF_M * d[2]
                    on, below = met(w, Ray(at, d, -1.0, width, spread), NOWHERE, False)
                    length = min(on.distance, below)
            elif floor < math.inf:
                t, kind[row, column] = floor, 2
            distance[row, column] = t
            wet[row, column] = t if side < 0.0 else length
            out = hits[row, column]
            out[0], out[4], out[5], out[6], out[7] = hit.distance, hit.a, hit.b, hit.sigma_m, hit.level
            out[1], out[2], out[3] = hit.normal


@borrowing
def _samples(
    w: RayWorld, origins: Any, directions: Any, of: Vector, key: int, hits: Any, stack: Any, radiance: Any
) -> None:
    """Write the radiance of pixels, the mean of their rays. of: side, width and spread of the rays. key: number of the
    first ray of all. hits: where the rays meet the surface, if each pixel has but one. stack: zeros of shape `STACK`.
    """
    side, width, spread = of
    rows, columns, count = origins.shape[:3]
    known = count == 1
    share = 1.0 / count
    for row in range(rows):
        for column in range(columns):
            k = hits[row, column]
            start = Hit(k[0], (k[1], k[2], k[3]), k[4], k[5], k[6], k[7])
            light = (0.0, 0.0, 0.0)
            for sample in range(count):
                p, q = origins[row, column, sample], directions[row, column, sample]
                ray = Ray((p[0], p[1], p[2]), (q[0], q[1], q[2]), side, width, spread)
                number = (key + (row * columns + column) * count + sample) & 0xFFFFFFFF
                put(stack, 0, ray, (share, share, share), 0.0, next_key(number, 0), 0)
                light = add(light, followed(w, stack, start, known), 1.0)
            radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2] = light
