# SPDX-License-Identifier: Apache-2.0
"""Laying a layer over the plate: differential rendering below water, then `over`.

The plate's radiance is T L_surface + veil. A shadow or a caustic changes L_surface alone, so the receiver's ratio
E_with/E_without multiplies (plate - veil) and leaves the veil (Debevec 1998, with the veil that water adds):

    background = veil + (plate - veil) ratio        composite = layer + (1 - alpha) background

Alpha is premultiplied (Porter & Duff 1984). A veil brighter than the plate is clipped to it, so that haze is never
darkened and nothing turns negative.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.types import Floats, Layer, Tile


def over_tile(plate_linear: Floats, tile: Tile) -> Floats:
    """Return the composite (h, w, 3) of the plate's pixels below one tile, linear, in the plate's type."""
    veil = np.minimum(tile.veil, plate_linear)
    background = veil + (plate_linear - veil) * tile.ratio
    # where the layer does nothing the plate goes through bit for bit, whatever the rounding of veil + (plate - veil)
    background = np.where(tile.ratio == 1.0, plate_linear, background)
    image = tile.radiance + (1.0 - tile.alpha[..., None]) * background
    return image.astype(plate_linear.dtype, copy=False)


def over(plate_linear: Floats, layer: Layer) -> Floats:
    """Return the composite (H, W, 3) of a linear plate and a layer; pixels outside the tiles are copied.

    Raises `ParameterError` where the sizes differ.
    """
    if plate_linear.shape != (layer.height, layer.width, 3):
        raise ParameterError(
            f"over - the plate must be as large as the layer (got {plate_linear.shape[:2]} and "
            f"{(layer.height, layer.width)}) - render the layer at the plate's size"
        )
    image = plate_linear.copy()
    for tile in layer.tiles:
        image[tile.window] = over_tile(plate_linear[tile.window], tile)
    return image


def mean_layer(layers: Sequence[Layer]) -> Layer:
    """Return the mean of layers of one frame at several instants: motion blur by sub-frames.

    Radiance, alpha and ratio are averaged; the distance is the nearest, the veil that of the frames that have one.
    """
    if len(layers) == 1:
        return layers[0]
    height, width = layers[0].height, layers[0].width
    rectangles = merge([(t.column, t.row, *t.alpha.shape[::-1]) for layer in layers for t in layer.tiles])
    tiles = []
    for column, row, w, h in rectangles:
        window = slice(row, row + h), slice(column, column + w)
        stack = [_crop(layer, window) for layer in layers]
        changed = np.stack([np.any(t.ratio != 1.0, axis=-1) for t in stack])[..., None]
        veil = np.stack([t.veil for t in stack])
        tiles.append(
            Tile(
                column=column,
                row=row,
                radiance=np.mean([t.radiance for t in stack], axis=0),
                alpha=np.mean([t.alpha for t in stack], axis=0),
                distance_m=np.min([t.distance_m for t in stack], axis=0),
                ratio=np.mean([t.ratio for t in stack], axis=0),
                veil=(np.where(changed, veil, 0.0).sum(0) / np.maximum(changed.sum(0), 1)).astype(np.float32),
            )
        )
    return Layer(height, width, tuple(tiles))


def merge(rectangles: Sequence[tuple[int, int, int, int]]) -> list[tuple[int, int, int, int]]:
    """Return disjoint rectangles (column, row, width, height) that cover the given ones; overlaps become one."""
    boxes = [(c, r, c + w, r + h) for c, r, w, h in rectangles if w > 0 and h > 0]
    merged: list[tuple[int, int, int, int]] = []
    while boxes:
        box = boxes.pop()
        hit = next((m for m in merged if m[0] < box[2] and box[0] < m[2] and m[1] < box[3] and box[1] < m[3]), None)
        if hit is None:
            merged.append(box)
        else:
            merged.remove(hit)
            boxes.append((min(box[0], hit[0]), min(box[1], hit[1]), max(box[2], hit[2]), max(box[3], hit[3])))
    return [(c0, r0, c1 - c0, r1 - r0) for c0, r0, c1, r1 in sorted(merged)]


def _crop(layer: Layer, window: tuple[slice, slice]) -> Tile:
    """Return what a layer holds inside a window as one tile."""
    row, column = window[0].start, window[1].start
    shape = (window[0].stop - row, window[1].stop - column)
    tile = empty_tile(column, row, *shape)
    for t in layer.tiles:
        r0, c0 = max(t.row, row), max(t.column, column)
        r1 = min(t.row + t.alpha.shape[0], window[0].stop)
        c1 = min(t.column + t.alpha.shape[1], window[1].stop)
        if r0 >= r1 or c0 >= c1:
            continue
        here = slice(r0 - row, r1 - row), slice(c0 - column, c1 - column)
        there = slice(r0 - t.row, r1 - t.row), slice(c0 - t.column, c1 - t.column)
        for name in ("radiance", "alpha", "distance_m", "ratio", "veil"):
            getattr(tile, name)[here] = getattr(t, name)[there]
    return tile


def empty_tile(column: int, row: int, height: int, width: int) -> Tile:
    """Return a tile that changes nothing, float32."""
    return Tile(
        column=column,
        row=row,
        radiance=np.zeros((height, width, 3), np.float32),
        alpha=np.zeros((height, width), np.float32),
        distance_m=np.full((height, width), np.inf, np.float32),
        ratio=np.ones((height, width, 3), np.float32),
        veil=np.zeros((height, width, 3), np.float32),
    )
