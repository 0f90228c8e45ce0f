# SPDX-License-Identifier: Apache-2.0
"""The viewing circle of omnidirectional stereo: where the rays of an eye's panorama start.

A panorama for one eye cannot be taken from one point: whichever way the head turns, the eye is half the distance
between both beside the middle of the head. Each column is therefore seen from its own point of a circle, a quarter turn
beside its direction (Ishiguro 1992; Peleg 2001, section 2; Google 2015). Here the circle shrinks with the
cosine of the latitude, to a point at the poles, where no column has a direction of its own:

    start = e d x up = e cos(lat) (cos lon, 0, sin lon)        a ray sees start + t d
    d direction of the pixel, up axis of the poles, e half the distance between the eyes, negative for the left one

The start is perpendicular to the ray and linear in it. A point P = (x, y, z) from the middle, in the camera's axes, is
seen at the distance t > 0 that solves (x^2 + z^2)/(t^2 + e^2) + y^2/t^2 = 1, at

    d = (t x + e z, (t^2 + e^2) y/t, t z - e x)/(t^2 + e^2)

so it lies atan(e/t) beside its direction from the middle. Of a point at the height of the camera at distance D that is
asin(e/D): the disparity of both eyes is 2 asin(e/D). Shaders: composite/gl/shaders/eyes.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def ray_starts(direction: ArrayLike, up: ArrayLike, eye_m: float) -> Array:
    """Return where an eye's rays start, (..., 3) [m] from the middle between the eyes, in the axes of the arguments.

    direction: (..., 3) unit. up: (3,) unit, the axis of the frame's poles. eye_m: of the eye to the right of the
    middle, negative to the left.
    """
    return np.asarray(eye_m * np.cross(np.asarray(direction), np.asarray(up)), np.float64)


def seen_direction(point: ArrayLike, eye_m: float) -> Array:
    """Return the unit directions (..., 3) in which an eye sees points (..., 3) [m] from the middle, camera's axes."""
    p, squared = np.asarray(point, np.float64), eye_m * eye_m
    y2 = np.square(p[..., 1])
    over = 0.5 * (np.sum(np.square(p), axis=-1) - squared)
    t2 = np.maximum(over + np.sqrt(np.square(over) + y2 * squared), 1e-24)
    t = np.sqrt(t2)
    level = 1.0 / (t2 + squared)
    x, z = (t * p[..., 0] + eye_m * p[..., 2]) * level, (t * p[..., 2] - eye_m * p[..., 0]) * level
    return np.stack([x, p[..., 1] / t, z], axis=-1)
