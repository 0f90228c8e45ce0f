# SPDX-License-Identifier: Apache-2.0
"""Lays pictures of snow over and under the tiles of a layer, and fills the rest of the frame with tiles of snow."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.over import empty_tile
from mr360uw.composite.shot import Shot
from mr360uw.composite.snow.splat import SnowPicture
from mr360uw.jit import exact
from mr360uw.types import Layer, Rectangle, Tile


def merged(shot: Shot, layer: Layer, before: SnowPicture, behind: SnowPicture, kept: Cache) -> Layer:
    """Return a layer with snow before its bodies and behind them; pictures are used up. kept: what frames share.

    Mattes without distances hide snow as they hide bodies, of which they know no more.
    """
    if shot.holdout is not None:
        left = (1.0 - np.clip(shot.holdout, 0.0, 1.0)).astype(np.float32)
        for picture in (before, behind):
            picture.radiance[...] *= left[..., None]
            picture.alpha[...] *= left
    tiles = [_with_snow(tile, before, behind) for tile in layer.tiles]
    whole = Rectangle(0, 0, layer.width, layer.height)
    blank = kept.of(_blank, whole)
    for part in rest_of([tile.rectangle for tile in layer.tiles], layer.width, layer.height):
        at = slice(part.row, part.row + part.height), slice(part.column, part.column + part.width)
        alpha = before.alpha[at]
        if np.any(alpha):
            clear = blank.distance_m[at], blank.ratio[at], blank.veil[at]
            tiles.append(Tile(part.column, part.row, before.radiance[at], alpha, *clear))
    return Layer(layer.height, layer.width, tuple(tiles))


def _blank(whole: Rectangle) -> Tile:
    return _read_only(empty_tile(whole))


def rest_of(parts: Sequence[Rectangle], width: int, height: int) -> list[Rectangle]:
    """Return disjoint rectangles of all pixels of a frame that are outside of some, which do not cross the seam."""
    edges = sorted({0, height, *(p.row for p in parts), *(p.row + p.height for p in parts)})
    rest = []
    for top, bottom in itertools.pairwise(edges):
        column = 0
        for p in sorted(p for p in parts if p.row <= top and bottom <= p.row + p.height):
            if p.column > column:
                rest.append(Rectangle(column, top, p.column - column, bottom - top))
            column = p.column + p.width
        if column < width:
            rest.append(Rectangle(column, top, width - column, bottom - top))
    return rest


def _with_snow(tile: Tile, before: SnowPicture, behind: SnowPicture) -> Tile:
    """Return a tile with the snow before its bodies over them, over the snow behind them."""
    at = tile.window
    radiance, alpha = np.empty(tile.radiance.shape, np.float32), np.empty(tile.alpha.shape, np.float32)
    _lay(
        before.radiance[at], before.alpha[at], tile.radiance, tile.alpha, behind.radiance[at], behind.alpha[at],
        radiance, alpha,
    )  # fmt: skip
    return replace(tile, radiance=radiance, alpha=alpha)


@exact
def _lay(
    front: Any, front_alpha: Any, body: Any, body_alpha: Any, back: Any, back_alpha: Any, radiance: Any, alpha: Any
) -> None:
    """Write `front` over `body` over `back`, premultiplied."""
    for j in range(alpha.shape[0]):
        for i in range(alpha.shape[1]):
            clear, through = np.float32(1.0) - front_alpha[j, i], np.float32(1.0) - body_alpha[j, i]
            for c in range(3):
                radiance[j, i, c] = front[j, i, c] + clear * (body[j, i, c] + through * back[j, i, c])
            covered = body_alpha[j, i] + through * back_alpha[j, i]
            alpha[j, i] = front_alpha[j, i] + clear * covered


def _read_only(tile: Tile) -> Tile:
    for values in (tile.distance_m, tile.ratio, tile.veil):
        values.flags.writeable = False
    return tile
