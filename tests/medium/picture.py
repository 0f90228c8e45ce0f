# SPDX-License-Identifier: Apache-2.0
"""A picture of diffuse bodies in water, put together from what a spectral model says, to hold against path tracing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.models import SpectralModel

CAMERA_DEPTH_M = 5.0
HALF_FIELD = np.tan(np.radians(30.0))
FLOOR_Y, FLOOR_ALBEDO = -12.0, 0.3
RAYS = 4
"""Rays along either side of a pixel."""


@dataclass(frozen=True)
class Scene:
    """Per ray (k, h, w): length, y of its direction, depth and normal where it ends, albedo, sky or not.

    valid: (h, w) pixels that show one body only.
    """

    distance_m: np.ndarray
    up: np.ndarray
    depth_m: np.ndarray
    normal_up: np.ndarray
    albedo: np.ndarray
    sky: np.ndarray
    valid: np.ndarray

    @classmethod
    def of(cls, spheres: np.ndarray, height: int, width: int) -> Scene:
        """Return what a camera 60 degrees wide looking along -z sees of spheres (x, y, z, radius, albedo) and a floor.

        Coordinates have their origin on the surface above the camera, y up.
        """
        row, column = (np.arange(n * RAYS) + 0.5 for n in (height, width))
        x, y = np.meshgrid(
            HALF_FIELD * (2.0 * column / (width * RAYS) - 1.0),
            HALF_FIELD * height / width * (1.0 - 2.0 * row / (height * RAYS)),
        )
        d = np.stack([x, y, -np.ones_like(x)], axis=-1)
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        origin = np.array([0.0, -CAMERA_DEPTH_M, 0.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [np.where(d[..., 1] < 0.0, (FLOOR_Y - origin[1]) / d[..., 1], np.inf)]
            for sphere in spheres:
                along = d @ (sphere[:3] - origin)
                square = sphere[3] ** 2 - np.sum((sphere[:3] - origin) ** 2) + along**2
                ends.append(np.where(square > 0.0, along - np.sqrt(square), np.inf))
        distance = np.min(ends, axis=0)
        body = np.where(np.isfinite(distance), np.argmin(ends, axis=0), -1)
        sky = body < 0
        end = origin + np.where(sky, 0.0, distance)[..., None] * d
        normal_up, albedo = np.ones_like(x), np.where(sky, 0.0, FLOOR_ALBEDO)
        for number, sphere in enumerate(spheres, 1):
            on = body == number
            normal_up[on], albedo[on] = ((end[..., 1] - sphere[1]) / sphere[3])[on], sphere[4]

        def rays(image: np.ndarray) -> np.ndarray:
            return image.reshape(height, RAYS, width, RAYS).transpose(1, 3, 0, 2).reshape(-1, height, width)

        depth = np.where(sky, 0.0, -end[..., 1])
        return cls(*(rays(v) for v in (distance, d[..., 1], depth, normal_up, albedo, sky)), np.ptp(rays(body), 0) == 0)


def render(scene: Scene, model: SpectralModel) -> np.ndarray:
    """Return the picture (h, w, n) under a sky of radiance 1 (irradiance pi), without a change of refractive index."""
    s = ray_in_water(scene.distance_m, CAMERA_DEPTH_M, scene.up)
    light = np.pi * model.irradiance(scene.depth_m, scene.normal_up)
    body = scene.albedo[..., None] / np.pi * light + scene.sky[..., None]
    veil = np.pi * model.inscatter(s, CAMERA_DEPTH_M, scene.up)
    return np.mean(veil + body * np.exp(-model.extinction * s[..., None]), axis=0)


def relative_rms(picture: np.ndarray, truth: np.ndarray, scene: Scene) -> float:
    """Return the rms over wavelengths of (rms of the difference over rms of the truth) of each."""
    difference, reference = (picture - truth)[scene.valid], truth[scene.valid]
    return float(np.sqrt(np.mean(np.mean(difference**2, axis=0) / np.mean(reference**2, axis=0))))
