# SPDX-License-Identifier: Apache-2.0
"""A picture of diffuse bodies in water, put together from what a spectral model says, to hold against path tracing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.models import SpectralModel

ALBEDO = {1: 0.8, 2: 0.8, 3: 0.5, 4: 0.5, 5: 0.2, 6: 0.3}
"""Of the bodies by their index in the reference samples: five spheres and the floor; 0 is sky, 12 endless water."""
ENDLESS = 12
CAMERA_DEPTH_M = 5.0
HALF_FIELD = np.tan(np.radians(30.0))


@dataclass(frozen=True)
class Scene:
    """Per sample (k, h, w): length of the ray, y of its direction, depth and normal where it ends, albedo, sky or not.

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
    def from_samples(cls, samples: np.ndarray, mixed: np.ndarray) -> Scene:
        g = samples.astype(np.float64)
        index = g[..., 7].astype(int)
        sky, endless = index == 0, index == ENDLESS
        height, width = index.shape[1:]
        row, column = np.mgrid[0:height, 0:width]
        x = HALF_FIELD * (2.0 * (column + 0.5) / width - 1.0)
        y = HALF_FIELD * height / width * (1.0 - 2.0 * (row + 0.5) / height)
        through_centre = y / np.sqrt(x * x + y * y + 1.0)
        up = np.where(sky, through_centre, (g[..., 2] + CAMERA_DEPTH_M) / np.maximum(g[..., 0], 1e-9))
        return cls(
            distance_m=np.where(sky | endless, np.inf, g[..., 0]),
            up=up,
            depth_m=np.where(sky, 0.0, np.maximum(-g[..., 2], 0.0)),
            normal_up=g[..., 5],
            albedo=np.vectorize(lambda i: ALBEDO.get(i, 0.0), otypes=[float])(index),
            sky=sky,
            valid=~mixed,
        )


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
