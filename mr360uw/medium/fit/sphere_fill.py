# SPDX-License-Identifier: Apache-2.0
"""Fills the unknown parts of a map of the sphere from its known ones, as smoothly as can be.

    minimise over u:  integral of  w (u - v)^2 + l^2 |grad u|^2 + e u^2        (Laplace's equation where w = 0)

v, w: values and how far they are known; l: length over which values that are known are smoothed; e: so small that it
only decides where nothing is known, for 0.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SMOOTHED = 0.5
"""l in pixels of the equator."""
_NOTHING = 1e-7
"""e: a millionth of what a pixel that is known counts."""


def filled(values: Array, weight: Array) -> Array:
    """Return an equirectangular map (h, w, k) that follows values where weights (h, w) of 0 to 1 say they are known."""
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    height, width, channels = values.shape
    area, stiffness = _sphere(height, width)
    known = weight.ravel() * area
    solve = splu((stiffness + diags(known + _NOTHING * area)).tocsc(), permc_spec="MMD_AT_PLUS_A")
    return np.asarray(solve.solve(known[:, None] * values.reshape(-1, channels)).reshape(values.shape))


@functools.lru_cache(maxsize=2)
def _sphere(height: int, width: int) -> tuple[Array, Any]:
    """Return the areas (n,) of pixels, of 1 at the equator, and the sparse matrix (n, n) of l^2 |grad u|^2."""
    from scipy.sparse import coo_matrix

    number = np.arange(height * width).reshape(height, width)
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    edge = np.cos(np.pi * (0.5 - np.arange(1, height) / height))
    across = np.broadcast_to(1.0 / np.cos(latitude)[:, None], (height, width))  # height over width of a pixel
    pairs = [
        (number, np.roll(number, -1, axis=1), across),
        (number[:-1], number[1:], np.broadcast_to(edge[:, None], (height - 1, width))),
    ]
    one, other = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
    weight = _SMOOTHED**2 * np.concatenate([pair[2].ravel() for pair in pairs])
    rows, columns = np.concatenate([one, other, one, other]), np.concatenate([one, other, other, one])
    matrix = coo_matrix((np.concatenate([weight, weight, -weight, -weight]), (rows, columns)))
    return np.repeat(np.cos(latitude), width), matrix.tocsr()
