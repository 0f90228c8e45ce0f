# SPDX-License-Identifier: Apache-2.0
"""Published ways of drawing shallow water that are not physics: for comparison, and for their look.

Depth-blended albedo: the floor takes on the water's colour with depth, A' = A exp(-k d) + W (1 - exp(-k d)), and the
water itself is clear. Nothing is lost on the slanted way to the camera, and no light is scattered.

Thresholded reflection: where the mirrored ray is within an angle of the sun, the surface adds gain times the sun's
irradiance as radiance, all or nothing. No energy is conserved, and Fresnel's reflectance has no part in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import reflect
from mr360uw.types import Floats, Sun

Array = NDArray[np.float64]


def blended_albedo(albedo: Floats, depth_m: float, per_m: Floats, color: Floats) -> Array:
    """Return the albedo (..., 3) of a floor at a depth. per_m: k (3,) [1/m]. color: W (3,) in [0, 1]."""
    own = np.exp(-np.asarray(per_m, np.float64) * depth_m)
    return np.asarray(albedo * own + color * (1.0 - own))


def thresholded_reflection(directions: Array, normal: Array, sun: Sun, threshold_rad: float) -> Array:
    """Return the part (H, W) in [0, 1] of pixels whose mirrored rays are within an angle of the sun.

    directions: (H, W, 3) of the rays. normal: (H, W, 3) of the surface that they meet, zero where they meet none. The
    edge is drawn over the pixel that it crosses, by the change of the angle from pixel to pixel.
    """
    met = np.any(normal != 0.0, axis=-1)
    mirrored = reflect(directions, normal)
    angle = np.arccos(np.clip(mirrored @ sun.direction, -1.0, 1.0))
    slopes = [np.gradient(angle, axis=axis) for axis in (0, 1) if angle.shape[axis] > 1]
    change = np.sqrt(sum((slope**2 for slope in slopes), np.zeros(angle.shape)))
    part = np.clip(0.5 + (threshold_rad - angle) / np.maximum(change, 1e-9), 0.0, 1.0)
    return np.where(met, part, 0.0)
