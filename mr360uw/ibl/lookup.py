# SPDX-License-Identifier: Apache-2.0
"""Equirectangular maps: bilinear lookup by direction, continuous over seam and poles; means, maxima, enlargement.

Twin: lookup.glsl, whose maps are textures of the same 32 rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.sphere import frame_from_direction
from mr360uw.base.texels import between_four, texels_around
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


# Resizes equirectangular maps: means over exact solid angles, maxima, bilinear enlargement.


@shared(keep=32)
def _shares(count: int, source: int, latitude: bool) -> tuple[tuple[int, NDArray[np.float32]], ...]:
    """Return for each of `count` cells the first of `source` samples it covers and their weights, of sum 1."""
    edges = np.arange(source + 1) / source
    cells = []
    for i in range(count):
        low, high = i / count, (i + 1) / count
        first = min(int(low * source), source - 1)
        last = max(first + 1, min(int(np.ceil(high * source - 1e-9)), source))
        bounds = np.clip(edges[first : last + 1], low, high)
        weight = np.diff(-np.sin(np.pi * (0.5 - bounds)) if latitude else bounds)
        cells.append((first, (weight / weight.sum()).astype(np.float32)))
    return tuple(cells)


_SMALL = 1 << 19
"""Samples up to which one sum over blocks is quicker than a loop over cells; the result is the same up to rounding."""


def reduce_map(radiance: ArrayLike, width: int, height: int) -> Floats:
    """Return the (height, width, C) means of an (H, W, C) equirectangular map over exact solid angles.

    A source pixel that straddles two cells is shared by the solid angle in each, so H and W need not be multiples;
    a smaller source is repeated. The sum of value x solid angle is kept.
    """
    image = np.asarray(radiance)
    source_height, source_width, channels = image.shape
    if source_height % height == 0 and source_width % width == 0 and image.size <= _SMALL:
        weight = np.stack([share for _, share in _shares(height, source_height, True)]) / (source_width // width)
        bands = image.reshape(height, source_height // height, source_width * channels)
        rows = weight.astype(image.dtype)[:, None] @ bands
        return rows.reshape(height, width, source_width // width, channels).sum(axis=2)
    rows = np.empty((height, source_width * channels), image.dtype)
    flat = image.reshape(source_height, -1)
    for j, (first, weight) in enumerate(_shares(height, source_height, True)):
        np.dot(weight.astype(image.dtype), flat[first : first + len(weight)], out=rows[j])
    columns = rows.reshape(height, source_width, channels).swapaxes(0, 1).reshape(source_width, -1)
    out = _across(width, source_width).astype(image.dtype) @ columns
    return np.ascontiguousarray(out.reshape(width, height, channels).swapaxes(0, 1))


@shared(keep=8)
def _across(width: int, source_width: int) -> NDArray[np.float32]:
    """Return the shares (width, source_width) that the columns of a map have in those of a narrower one."""
    shares = np.zeros((width, source_width), np.float32)
    for i, (first, weight) in enumerate(_shares(width, source_width, False)):
        shares[i, first : first + len(weight)] = weight
    return shares


def reduce_maximum(values: ArrayLike, width: int, height: int) -> Floats:
    """Return the largest of the (H, W) values in each of (height, width) cells, a pixel in that of its corner."""
    image = np.asarray(values)
    first_row = np.array([first for first, _ in _shares(height, image.shape[0], False)])
    first_column = np.array([first for first, _ in _shares(width, image.shape[1], False)])
    return np.maximum.reduceat(np.maximum.reduceat(image, first_row, axis=0), first_column, axis=1)


def resize_map(values: Floats, width: int, height: int) -> NDArray[np.float32]:
    """Return a small equirectangular map (h, w) bilinearly enlarged to (height, width), closed at the seam."""
    import cv2

    small_height, small_width = values.shape
    x = (np.arange(width, dtype=np.float32) + 0.5) * (small_width / width) - 0.5
    y = (np.arange(height, dtype=np.float32) + 0.5) * (small_height / height) - 0.5
    grid_x, grid_y = np.meshgrid(x % small_width, np.clip(y, 0.0, small_height - 1.0))
    image = np.asarray(values, np.float32)
    return cv2.remap(image, grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
