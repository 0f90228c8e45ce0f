# SPDX-License-Identifier: Apache-2.0
"""Bilinear lookup of environment maps by direction: periodic across the seam, continuous over the poles.

Twin: lookup.glsl, whose maps are textures of the same 32 rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.sphere import frame_from_direction
from mr360uw.texels import between_four, texels_around
from mr360uw.types import Floats

Indices = NDArray[np.int64]


def environment_texel(map_: Floats, column: NDArray[np.int64], row: NDArray[np.int64]) -> Floats:
    """Return the map's (H, W, 3) pixels at columns -1 to W and rows -1 to H (...,), as (..., 3).

    The columns close at the seam. A row beyond a pole is the row before it, half a turn away.
    """
    height, width = map_.shape[:2]
    over_pole = (row < 0) | (row >= height)
    column = np.where(over_pole, column + width // 2, column) % width
    return map_[np.clip(row, 0, height - 1), column]


def environment_lookup(map_: Floats, direction: ArrayLike) -> Floats:
    """Return the map's (H, W, 3) value in `direction` (..., 3): bilinear between pixel centres.

    Beyond the centre of the first or last row the neighbour is the same row half a turn away, as over a pole.
    """
    i, j, fx, fy = _between(map_.shape, direction)
    a, b, c, d = environment_texel(map_, np.stack([i, i + 1, i, i + 1]), np.stack([j, j, j + 1, j + 1]))
    return np.asarray(between_four(a, b, c, d, fx, fy))


def lookup_matrix(shape: tuple[int, ...], direction: ArrayLike) -> Any:
    """Return the sparse matrix (n, H W) that `environment_lookup` in directions (n, 3) is for maps of a shape (H, W,
    ...), float64: for directions in which many maps are looked up.
    """
    from scipy.sparse import csr_matrix

    height, width = shape[:2]
    i, j, fx, fy = _between(shape, direction)
    number = np.arange(height * width, dtype=np.float64).reshape(height, width)
    texels = environment_texel(number, np.stack([i, i + 1, i, i + 1]), np.stack([j, j, j + 1, j + 1]))
    weights = [across * along for along in (1.0 - fy, fy) for across in (1.0 - fx, fx)]
    rows = np.repeat(np.arange(len(i)), 4)
    columns = np.moveaxis(texels, 0, -1).ravel().astype(np.int64)
    values: Any = np.concatenate(weights, axis=-1).ravel()
    return csr_matrix((values, (rows, columns)), shape=(len(i), height * width))


def _between(shape: tuple[int, ...], direction: ArrayLike) -> tuple[Indices, Indices, Floats, Floats]:
    """Return `texels_around` directions (..., 3) in a map of a shape."""
    x, y = frame_from_direction(direction, shape[1], shape[0])
    return texels_around(x - 0.5, y - 0.5)


def glossy_lookup(levels: Floats, level_roughness: Floats, direction: ArrayLike, roughness: ArrayLike) -> Floats:
    """Return the GGX-filtered radiance (..., 3) in `direction` at `roughness` (...,), linear between levels.

    levels: (L, H, W, 3). Roughness outside `level_roughness` (L,) takes the nearest level.
    """
    position = np.interp(np.asarray(roughness, np.float64), level_roughness, np.arange(len(level_roughness)))
    lower = np.minimum(position.astype(np.int64), max(len(level_roughness) - 2, 0))
    fraction = (position - lower)[..., None]
    result = np.zeros((*np.broadcast_shapes(np.shape(direction)[:-1], position.shape), 3))
    for k in range(len(level_roughness)):
        weight = np.where(lower[..., None] == k, 1.0 - fraction, 0.0) + np.where(
            lower[..., None] + 1 == k, fraction, 0.0
        )
        if np.any(weight > 0.0):
            result = result + weight * environment_lookup(levels[k], direction)
    return result
