# SPDX-License-Identifier: Apache-2.0
"""Lays a picture of bodies in the surface behind the bodies of a layer, which it cuts, and beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mr360uw.composite.over import empty_tile, hold_out
from mr360uw.composite.shot import Shot
from mr360uw.composite.snow.splat import rest_of
from mr360uw.composite.tiles import even_tiles, rectangles_of_mask
from mr360uw.types import Floats, Layer, Rectangle, Tile

_SPARE_PX = 4096
"""Pixels that a rectangle of images must save to be cut in two."""


@dataclass(frozen=True, slots=True, eq=False)
class BodiesInSurface:
    """Bodies in the surface and the cut through them, for a whole frame.

    radiance: (H, W, 3) premultiplied, alpha: (H, W). distance_m: (H, W) of the surface, 0 where it is not known. kept:
    (H, W) fraction of the bodies' samples before the surface.
    """

    radiance: Floats
    alpha: Floats
    distance_m: Floats
    kept: Floats


def blank_picture(layer: Layer) -> tuple[Floats, Floats, Floats]:
    """Return radiance, alpha and distance of a frame without images."""
    size = layer.height, layer.width
    return np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)


def laid_over(shot: Shot, layer: Layer, picture: BodiesInSurface) -> Layer:
    """Return a layer with its bodies cut, over the images."""
    tiles = [_over_images(tile, _images_tile(shot, picture, tile.rectangle), picture) for tile in layer.tiles]
    shown = np.any(picture.radiance != 0.0, axis=-1) | (picture.alpha > 0.0)
    parts = even_tiles(rectangles_of_mask(shown, _SPARE_PX), layer.width, layer.height)
    free = rest_of([tile.rectangle for tile in layer.tiles], layer.width, layer.height)
    for part in parts:
        tiles += [_images_tile(shot, picture, both) for one in free if (both := _common(part, one)) is not None]
    return replace(layer, tiles=tuple(tiles))


def _common(a: Rectangle, b: Rectangle) -> Rectangle | None:
    """Return the rectangle that two have in common, if any."""
    column, row = max(a.column, b.column), max(a.row, b.row)
    width = min(a.column + a.width, b.column + b.width) - column
    height = min(a.row + a.height, b.row + b.height) - row
    return Rectangle(column, row, width, height) if min(width, height) > 0 else None


def _images_tile(shot: Shot, picture: BodiesInSurface, part: Rectangle) -> Tile:
    """Return the images in a part of the frame as a tile of their own, behind the shot's mattes."""
    blank = empty_tile(part)
    at = blank.window
    distance = np.where(picture.alpha[at] > 0.0, picture.distance_m[at], np.inf).astype(np.float32)
    tile = replace(blank, radiance=picture.radiance[at].copy(), alpha=picture.alpha[at].copy(), distance_m=distance)
    return hold_out(shot, tile)


def _over_images(tile: Tile, images: Tile, picture: BodiesInSurface) -> Tile:
    kept = picture.kept[tile.window]
    alpha = kept * tile.alpha
    through = 1.0 - alpha
    return replace(
        tile,
        radiance=kept[..., None] * tile.radiance + through[..., None] * images.radiance,
        alpha=alpha + through * images.alpha,
        distance_m=np.where(alpha > 0.0, tile.distance_m, images.distance_m),
    )
