# SPDX-License-Identifier: Apache-2.0
"""Parts of a picture from above: the floor behind the first surface, and what that surface mirrors.

Both follow the ray through a pixel's centre at its first meeting with the waves; light that meets further waves is in
the picture alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import fresnel, reflect, refract_clamped
from mr360uw.surface import SurfacePicture
from mr360uw.surface.intersection import sigma_at
from mr360uw.surface.ray_tree import Stage
from mr360uw.surface.slopes import Facets
from mr360uw.types import View

Array = NDArray[np.float64]


def floor_radiance(stage: Stage, view: View, seen: SurfacePicture, directions: Array, origins: Array) -> Array:
    """Return the radiance (H, W, 3) that leaves the floor towards the camera, before the water; zero without floor.

    directions, origins: (H, W, 3) of the pixels' rays.
    """
    out = np.zeros(directions.shape)
    wet = seen.surface & (seen.in_water_m > 0.0) & np.isfinite(seen.in_water_m)
    for mask, dry in ((wet, False), (seen.floor, True)):
        if not np.any(mask):
            continue
        d, distance = directions[mask], seen.distance_m[mask]
        place, footprint = origins[mask] + distance[:, None] * d, view.pixel_m + view.pixel_rad * distance
        if not dry:
            bent = refract_clamped(d, seen.normal[mask], 1.0 / stage.refractive_index)
            place = place + seen.in_water_m[mask, None] * bent
            footprint = footprint + view.pixel_rad * seen.in_water_m[mask] / stage.refractive_index
        out[mask] = stage.floor_light.radiance(stage.floor, place[:, 0], place[:, 2], footprint, dry)
    return out


def reflected_radiance(stage: Stage, view: View, seen: SurfacePicture, directions: Array) -> Array:
    """Return the radiance (H, W, 3) of sky and sun that the surface mirrors towards the camera, once."""
    out = np.zeros(directions.shape)
    met = seen.surface & ~np.array(seen.camera_in_water)
    if not np.any(met):
        return out
    d, normal, distance = directions[met], seen.normal[met], seen.distance_m[met]
    spread = view.pixel_rad
    sigma = np.array([sigma_at(view.pixel_m, spread, t, up) for t, up in zip(distance, d[:, 1], strict=True)])
    lost = stage.sea.unresolved(stage.sea.level_of(sigma))
    cosine = np.clip(-np.sum(d * normal, axis=-1), 0.0, 1.0)
    blur = np.hypot(spread, 2.0 * np.sqrt(np.maximum(lost[:, 0] + lost[:, 2], 0.0)))
    light = fresnel(cosine, stage.refractive_index)[:, None] * stage.dome.look(reflect(d, normal), blur)
    if stage.sun is not None and stage.sun.direction[1] > 0.0:
        light = light + Facets(d, normal, lost, from_below=False).sunlight(stage.sun, stage.refractive_index)
    out[met] = light
    return out
