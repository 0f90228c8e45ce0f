# SPDX-License-Identifier: Apache-2.0
"""Composites a layer over the plate: differential rendering below water, then `over`.

The formula stands in `tile_blend`. Holdout mattes keep parts of the plate in front of the objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.parameters import checked
from mr360uw.base.tile_blend import blended
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles
from mr360uw.errors import ParameterError
from mr360uw.types import Floats, Layer, Rectangle, Tile


def hold_out(shot: Shot, tile: Tile) -> Tile:
    """Return a tile with the shot's mattes applied to the objects and to the receiver's ratio.

    A distance matte hides the objects behind it. It leaves the receiver, whose distances are of the same surfaces.
    """
    if not shot.has_mattes:
        return tile
    kept = np.ones(tile.alpha.shape, np.float32)
    if shot.holdout is not None:
        kept -= np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)
    plate_kept = kept
    ratio = 1.0 + plate_kept[..., None] * (tile.ratio - 1.0)
    if shot.holdout_distance_m is not None:
        kept = kept * _not_behind(shot, tile, shot.holdout_distance_m)
    return replace(
        tile,
        radiance=tile.radiance * kept[..., None],
        alpha=tile.alpha * kept,
        distance_m=np.where(kept > 0.0, tile.distance_m, np.inf).astype(np.float32),
        ratio=ratio.astype(np.float32),
        shafts=None if tile.shafts is None else tile.shafts * plate_kept[..., None],
    )


def _not_behind(shot: Shot, tile: Tile, holdout_distance_m: Floats) -> NDArray[Any]:
    """Return the fraction (h, w) of a tile's objects that distances (H, W) [m] of the shot do not hide."""
    shown = tile.distance_m < holdout_distance_m[tile.window]
    if shot.holdout_beside is not None:
        beside_m, share = (values[tile.window] for values in shot.holdout_beside)
        return (np.float32(1.0) - share) * shown + share * (tile.distance_m < beside_m)
    return _softened(shown, np.isfinite(tile.distance_m)) if shot.holdout_soft else shown


def _softened(shown: NDArray[np.bool_], body: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the fraction (h, w) of the pixels of objects that is shown, of each and its eight neighbours.

    body: pixels of objects; the others tell nothing of what is in front of these.
    """
    import cv2

    part, whole = (cv2.blur(one.astype(np.float32), (3, 3)) for one in (shown & body, body))
    return np.asarray(part / np.maximum(whole, np.float32(1.0 / 9.0)), np.float32)


@checked
def over_tile(plate_linear: Floats, tile: Tile) -> Floats:
    """Return the composite of the plate's pixels below one tile.

    Tiles cover what a layer changes: all other pixels stay the plate's. Where a tile changes nothing the plate is
    copied bit for bit.

    Parameters
    ----------
    plate_linear : ndarray
        The plate's pixels (h, w, 3) below the tile, linear.
    tile : Tile
        Of a layer.

    Returns
    -------
    ndarray
        Linear pixels (h, w, 3) in the plate's type.

    See Also
    --------
    uw.composite.render_layer : Makes the tiles.
    uw.types.Tile : Fields of a tile.
    uw.render_frame : Makes the whole picture.

    Notes
    -----
    L' = layer + (1 - alpha) (veil + (plate - veil) ratio + shafts): over of Porter & Duff 1984, the plate changed by
    differential rendering (Debevec 1998).

    Examples
    --------
    >>> result = uw.render_frame(plate, scene, backend="reference")
    >>> tile = result.layer.tiles[0]
    >>> uw.composite.over_tile(plate[tile.window], tile).shape == tile.radiance.shape
    True
    """
    return blended(plate_linear, tile)


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
    for tile in layer.laid().tiles:
        image[tile.window] = blended(plate_linear[tile.window], tile)
    return image


def mean_layer(layers: Sequence[Layer]) -> Layer:
    """Return the mean of layers of one frame at several instants: motion blur by sub-frames.

    Radiance, alpha, ratio and shafts are averaged over all layers, the veil over those that change the pixel; the
    distance is the least.
    """
    if len(layers) == 1:
        return layers[0]
    height, width, layers = layers[0].height, layers[0].width, [layer.laid() for layer in layers]
    tiles = []
    for rectangle in even_tiles([t.rectangle for layer in layers for t in layer.tiles], width, height):
        stack = [tile_of(layer, rectangle) for layer in layers]
        changed = np.stack([np.any(t.ratio != 1.0, axis=-1) for t in stack])[..., None]
        veil = np.stack([t.veil for t in stack])
        filled = [t.shafts for t in stack if t.shafts is not None]
        mean = {name: np.mean([getattr(t, name) for t in stack], axis=0) for name in ("radiance", "alpha", "ratio")}
        mean["distance_m"] = np.min([t.distance_m for t in stack], axis=0)
        mean["veil"] = (np.where(changed, veil, 0.0).sum(0) / np.maximum(changed.sum(0), 1)).astype(np.float32)
        shafts = np.asarray(np.sum(filled, axis=0) / np.float32(len(stack))) if filled else None
        tiles.append(Tile(rectangle.column, rectangle.row, **mean, shafts=shafts))
    return Layer(height, width, tuple(tiles))


def tile_of(layer: Layer, part: Rectangle) -> Tile:
    """Return the part of a layer's tiles inside a rectangle as one tile, a copy; what none covers changes nothing."""
    column, row = part.column, part.row
    tile = empty_tile(part, bare=layer.ground is not None)
    names = ["radiance", "alpha", "distance_m", "shafts", *(["ratio", "veil"] if layer.ground is None else [])]
    if any(t.shafts is not None for t in layer.tiles):
        tile = replace(tile, shafts=np.zeros_like(tile.radiance))
    for t in layer.tiles:
        r0, c0 = max(t.row, row), max(t.column, column)
        r1 = min(t.row + t.alpha.shape[0], row + part.height)
        c1 = min(t.column + t.alpha.shape[1], column + part.width)
        if r0 >= r1 or c0 >= c1:
            continue
        here = slice(r0 - row, r1 - row), slice(c0 - column, c1 - column)
        there = slice(r0 - t.row, r1 - t.row), slice(c0 - t.column, c1 - t.column)
        for name in names:
            if (values := getattr(t, name)) is not None:
                getattr(tile, name)[here] = values[there]
    return tile


def empty_tile(part: Rectangle, *, bare: bool = False) -> Tile:
    """Return a tile that changes nothing, float32. bare: `Layer.ground` stands for its ratio and veil, which take no
    memory and cannot be written.
    """
    size = part.height, part.width
    radiance, alpha = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    ratio, veil = (np.broadcast_to(np.float32(value), (*size, 3)) for value in (1.0, 0.0))
    if not bare:
        ratio, veil = ratio.copy(), veil.copy()
    return Tile(part.column, part.row, radiance, alpha, np.full(size, np.inf, np.float32), ratio, veil)
