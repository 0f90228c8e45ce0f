# SPDX-License-Identifier: Apache-2.0
"""The fixed directions in which bodies look for ambient light."""

from __future__ import annotations

import functools

import numpy as np

from mr360uw.sphere import unit
from mr360uw.types import Environment, Floats

COUNT = 512
"""Directions over the whole sphere. One of those above a surface carries at most 0.8 % of its irradiance, about one
8-bit code value; twice as many double the set-up time."""
SOLID_ANGLE = 4.0 * np.pi / COUNT
"""Solid angle [sr] that each direction stands for."""
_BESIDE_SKY = 0.1
"""Sine of the depression below which no pixel of `blurred` holds light of a sky above a level horizon."""


@functools.cache
def directions() -> Floats:
    """Return unit directions (COUNT, 3) that cover the sphere evenly: a spherical Fibonacci lattice (Keinert 2015)."""
    k = np.arange(COUNT) + 0.5
    height, angle = 1.0 - 2.0 * k / COUNT, k * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - height * height)
    return np.stack([level * np.cos(angle), height, level * np.sin(angle)], axis=-1)


def blurred(environment: Environment) -> Floats:
    """Return the environment without its sun, (H/2, W/2, 3): its pixels are about as wide as a direction's share."""
    map_ = np.asarray(environment.residual, np.float64)
    rows, columns = map_.shape[0] // 2, map_.shape[1] // 2
    return map_[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))


def seen_by_camera(away: Floats, direction: Floats) -> Floats:
    """Return unit directions (n, 3) in which a camera sees the places of level ground that others see.

    away: (n, 3) of the places from the camera; direction: (n, 3) in which the others see them, down. Of ground far off,
    which the camera sees beside its sky in one pixel of the environment, that nearer by is taken.
    """
    from_camera, down = unit(away), unit(direction)[:, 1:2]
    highest = np.minimum(from_camera[:, 1:2], np.maximum(down, -_BESIDE_SKY))
    level = from_camera[:, [0, 2]] * np.sqrt((1.0 - highest**2) / np.maximum(1.0 - from_camera[:, 1:2] ** 2, 1e-12))
    return np.stack([level[:, 0], highest[:, 0], level[:, 1]], axis=-1)
