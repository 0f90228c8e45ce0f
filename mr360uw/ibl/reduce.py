# SPDX-License-Identifier: Apache-2.0
"""Resizes equirectangular maps: means over exact solid angles, maxima, bilinear enlargement."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.types import Floats


@functools.lru_cache(maxsize=32)
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


@functools.lru_cache(maxsize=8)
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
