# SPDX-License-Identifier: Apache-2.0
"""Parts of a picture from above: the floor behind the first surface, and what that surface mirrors.

Both follow the ray through a pixel's centre at its first meeting with the waves; light that meets further waves is in
the picture alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import fresnel, reflect, refract_clamped
from mr360uw.surface import SurfacePicture
from mr360uw.surface.intersection import sigma_at
from mr360uw.surface.tracing.stage_arrays import RayStage, disc_of
from mr360uw.surface.tracing.sun_in_waves import glitter
from mr360uw.types import View

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FloorSeen:
    """The floor in n pixels. mask: (H, W) which. place: (n, 3) [m] in the world. footprint_m: (n,) of a pixel there.
    veil: (n, 3) radiance that the water adds, through the surface.
    """

    mask: NDArray[np.bool_]
    place: Array
    footprint_m: Array
    veil: Array


def floor_through_waves(
    stage: RayStage, view: View, seen: SurfacePicture, directions: Array, origins: Array
) -> FloorSeen:
    """Return the floor where a camera in the air sees it on the refracted rays of pixels.

    directions, origins: (H, W, 3) of the pixels' rays.
    """
    mask = seen.surface & (seen.in_water_m > 0.0) & np.isfinite(seen.in_water_m)
    d, normal, distance, wet = directions[mask], seen.normal[mask], seen.distance_m[mask], seen.in_water_m[mask]
    bent = refract_clamped(d, normal, 1.0 / stage.refractive_index)
    place = origins[mask] + distance[:, None] * d + wet[:, None] * bent
    footprint = view.pixel_m + view.pixel_rad * (distance + wet / stage.refractive_index)
    cosine = np.clip(-np.sum(d * normal, axis=-1), 0.0, 1.0)
    through = (1.0 - fresnel(cosine, stage.refractive_index)) / stage.refractive_index**2
    _, veil = stage.water.along(wet, np.minimum(bent[:, 1], 0.0), from_camera=False)
    veil = np.asarray(veil * stage.water.about_sun(bent))
    return FloorSeen(mask, place, footprint, through[:, None] * veil)


def floor_radiance(stage: RayStage, view: View, seen: SurfacePicture, directions: Array, origins: Array) -> Array:
    """Return the radiance (H, W, 3) that leaves the floor towards the camera, before the water; zero without floor."""
    out = np.zeros(directions.shape)
    wet = floor_through_waves(stage, view, seen, directions, origins)
    x, z = wet.place[:, 0], wet.place[:, 2]
    out[wet.mask] = stage.floor_light.radiance(stage.floor, x, z, wet.footprint_m, False)
    dry, distance = seen.floor, seen.distance_m[seen.floor]
    place = origins[dry] + distance[:, None] * directions[dry]
    footprint = view.pixel_m + view.pixel_rad * distance
    out[dry] = stage.floor_light.radiance(stage.floor, place[:, 0], place[:, 2], footprint, True)
    return out


def reflected_radiance(stage: RayStage, view: View, seen: SurfacePicture, directions: Array) -> Array:
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
        disc, _ = disc_of(stage.sun)
        seen_sun = glitter(disc, d, normal, lost, 1.0, stage.refractive_index)
        light = light + seen_sun[:, None] * np.array([disc.red, disc.green, disc.blue])
    out[met] = light
    return out
