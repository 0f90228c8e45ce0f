# SPDX-License-Identifier: Apache-2.0
"""Irradiance maps by nine spherical harmonics (Ramamoorthi 2001, equations 5 to 8).

    E(n) = sum_lm A_l L_lm Y_lm(n),   L_lm = int L(d) Y_lm(d) dd,   A_0, A_1, A_2 = pi, 2 pi/3, pi/4

Smooth, a few percent off under a sun, and negative there on the far side: the exact integral (`cosine`) is as fast.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.sphere import directions, row_solid_angle
from mr360uw.types import Floats

_COSINE_BANDS = np.pi * np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 0.25, 0.25, 0.25, 0.25, 0.25])


@functools.cache
def _harmonics(columns: int, rows: int) -> NDArray[np.float64]:
    """Return the nine real harmonics of order 0 to 2 in the directions of a map, (H, W, 9)."""
    x, y, z = np.moveaxis(directions(columns, rows), -1, 0)
    one = np.ones_like(x)
    basis = [
        0.282095 * one, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
        0.315392 * (3.0 * z * z - 1.0), 1.092548 * x * z, 0.546274 * (x * x - y * y),
    ]  # fmt: skip
    return np.stack(basis, axis=-1)


def harmonic_irradiance(radiance: ArrayLike) -> Floats:
    """Return the irradiance map (32, 64, 3), in radiance x sr, of a radiance map (H, W, 3)."""
    image = np.asarray(radiance, np.float64)
    height, width = image.shape[:2]
    basis = _harmonics(width, height) * row_solid_angle(width, height)[:, None, None]
    harmonics = np.tensordot(basis, image, ([0, 1], [0, 1]))
    return (_harmonics(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS) @ (_COSINE_BANDS[:, None] * harmonics)).astype(np.float32)
