# SPDX-License-Identifier: Apache-2.0
"""Bilinear lookup of environment maps by direction: periodic across the seam, continuous over the poles.

Twin: lookup.glsl, whose maps are textures of the same 32 rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.shapes import common_shape
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


# Reflectance of a GGX surface under a uniform sky, F0 A + B: the second half of the split sum.
#
#     A = int f/F cos (1 - (1 - v.h)^5),   B = int f/F cos (1 - v.h)^5   over the hemisphere of l
#
# f = GGX with the height-correlated Smith masking (Heitz 2014 eq. 99) and the Fresnel factor of Schlick 1994.
# `split_sum` is a quotient of polynomials fitted to the integral (Karis 2013): rms error .014 of
# A + B and .003 of B, within .04 and .015 where n.v > .1; B vanishes at n.v = 1 as it must, or every dark dielectric
# would look hazy. (The widely used fit of Karis 2014 is off by up to .47 for rough metals.)
# Twin: splitsum.glsl.

Array = NDArray[np.float64]


def split_sum(roughness: ArrayLike, n_dot_v: ArrayLike) -> tuple[Array, Array]:
    """Return (A, B) for perceptual roughness (alpha = roughness^2) and n.v, each (...,) in [0, 1]."""
    common_shape(roughness=roughness, n_dot_v=n_dot_v)
    r = np.asarray(roughness, np.float64)
    v = np.asarray(n_dot_v, np.float64)
    white = (1.004 + v * (0.1061 - v * (0.1398 + 0.1248 * v))
             + r * (-2.549 + v * (0.1271 + 0.4051 * v) + r * (2.37 - 0.5209 * v - 0.5446 * r)))  # fmt: skip
    white = white / (1.0 + v * (0.05538 - 0.209 * v) + r * (-2.2 + 0.2572 * v + 1.505 * r))
    b = 0.9969 + v * (-1.096 + 1.0529 * v) + r * (-1.0901 + 0.0253 * v + 0.484 * r)
    b = b / (1.0 + v * (0.0215 + 7.8124 * v) + r * (-0.292 - 13.4496 * v + 8.9049 * r))
    x = 1.0 - v
    b = np.maximum(x * x * x * b, 0.0)
    return np.minimum(white, 1.0) - b, b
