# SPDX-License-Identifier: Apache-2.0
"""First solid surfaces of bodies along any rays, for images of bodies in the water's surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.raycast.geometry import Geometry, Hits, base_color, surface_along
from mr360uw.composite.raycast.pixel_samples import MAXIMUM_HITS
from mr360uw.composite.sampling import PIXEL_FILTER, WHOLE_PIXEL
from mr360uw.constants import PI
from mr360uw.rays import RayScene, barycentric
from mr360uw.types import Floats

Indices = NDArray[np.int64]


def first_surfaces(geometry: Geometry, scene: RayScene, origin: Floats, direction: Floats) -> tuple[Indices, Floats]:
    """Return the triangle (n,) that each ray meets first, -1 for none, and the distance (n,) [m], infinity for none.

    origin, direction: (n, 3), from the camera. Rays pass through back faces of one-sided materials, and through masks
    where they are open; masks are read at their finest level.
    """
    found, distance = np.full(len(origin), -1, np.int64), np.full(len(origin), np.inf)
    two_sided = np.array([m.double_sided for m in geometry.materials] or [True])
    masked = np.array([m.alpha_mode == "MASK" for m in geometry.materials] or [False])
    cutoff = np.array([m.alpha_cutoff for m in geometry.materials] or [0.5])
    active, start = np.arange(len(origin)), np.zeros(len(origin))
    for _ in range(MAXIMUM_HITS):
        rays = direction[active]
        triangle = scene.first_hit(origin[active] + start[active, None] * rays, rays)
        active, triangle, rays = active[triangle >= 0], triangle[triangle >= 0], rays[triangle >= 0]
        if len(active) == 0:
            break
        corners = geometry.positions[triangle] - origin[active, None]
        weights, along = barycentric(corners, rays)
        start[active] = np.maximum(along, start[active]) * (1.0 + 4e-6) + 1e-7
        material = geometry.material[triangle]
        solid = two_sided[material] | (np.einsum("nk,nk->n", scene.normals[triangle], rays) < 0.0)
        holed = np.flatnonzero(solid & masked[material])
        if len(holed):
            alpha = base_color(geometry, triangle[holed], weights[holed], np.zeros((len(holed), 2, 2)))[:, 3]
            solid[holed] = alpha >= cutoff[material[holed]]
        found[active[solid]], distance[active[solid]] = triangle[solid], along[solid]
        active = active[~solid]
    return found, distance


def surfaces_met(
    geometry: Geometry, triangle: Indices, point: Floats, direction: Floats, path_m: Floats, width_rad: Floats
) -> Hits:
    """Return the surfaces of triangles (n,) at points (n, 3) that rays of direction (n, 3) meet.

    path_m: (n,) length of the whole way from the camera. width_rad: (n,) angle between the rays of neighbouring pixels.
    Mirrored and refracted bodies are shaded as if a camera at the end of the straightened way saw them.
    """
    side = PIXEL_FILTER * np.tan(np.minimum(width_rad, 0.5))[:, None]
    right = np.cross(direction, [0.0, 1.0, 0.0])
    length = np.linalg.norm(right, axis=-1, keepdims=True)
    right = np.where(length > 1e-6, right / np.maximum(length, 1e-6), [1.0, 0.0, 0.0])
    down = np.cross(direction, right)
    beside = np.stack([direction + side * right, direction + side * down], axis=1)
    beside /= np.linalg.norm(beside, axis=-1, keepdims=True)
    area = np.tile(WHOLE_PIXEL, (len(triangle), 1))
    origin = point - path_m[:, None] * direction
    return surface_along(geometry, triangle, origin, direction, beside, area, PIXEL_FILTER, PI / width_rad)
