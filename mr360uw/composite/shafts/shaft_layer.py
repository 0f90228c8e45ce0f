# SPDX-License-Identifier: Apache-2.0
"""Adds light in the water to a layer that is drawn: to its objects what lies before them, to its tiles what lies before
the plate.

    radiance += alpha strength D(distance of the object)        shafts = strength D(distance of the receiver)

D is the deviation from the smooth veil (`medium.shafts.deviation`). No pixel turns negative by it. Both renderers share
it: it needs the layer's distances alone.

Light before the plate has no edges but those of shadows in the water, which the water blurs, so it is found for blocks
of pixels and read bilinearly between their middles. Without waves it goes with the sun's strength, and stands still as
long as sun, bodies and camera do.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, by_content
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.over import tile_of
from mr360uw.composite.receiver.shape import plate_distance
from mr360uw.composite.shafts.shaft_light import ShaftLight, change_along, shaft_pixels
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, rectangles_of_mask
from mr360uw.medium.shafts.settings import ShaftSettings
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.types import Floats, Layer, Rectangle, Tile, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def with_shafts(
    shot: Shot, light: ShaftLight, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return a shot's layer and output variables with the light in the water. cache: holds what does not change."""
    before, behind = light.scenes(shot, cache)
    tiles = _before_objects(shot, light, before, layer.tiles, cache)
    if variables is not None:
        shown = variables.shafts.copy()
        for tile, old in zip(tiles, layer.tiles, strict=True):
            shown[tile.window] += tile.radiance - old.radiance
        variables = replace(variables, shafts=shown)
    return before_plate(shot, light, behind, replace(layer, tiles=tiles), cache), variables


def _before_objects(
    shot: Shot, light: ShaftLight, scene: ShaftScene, tiles: tuple[Tile, ...], cache: Cache
) -> tuple[Tile, ...]:
    covered = [tile.alpha > 0.0 for tile in tiles]
    pixels = [np.nonzero(where) for where in covered]
    x = _joined([at[1] + np.float32(tile.column + 0.5) for at, tile in zip(pixels, tiles, strict=True)])
    y = _joined([at[0] + np.float32(tile.row + 0.5) for at, tile in zip(pixels, tiles, strict=True)])
    end_m = _joined([tile.distance_m[where] for tile, where in zip(tiles, covered, strict=True)])
    found = _added(shot, light, scene, np.stack([x, y, end_m]), cache)
    added = np.split(found, np.cumsum([len(at[0]) for at in pixels])[:-1]) if tiles else []
    drawn = []
    for tile, where, values in zip(tiles, covered, added, strict=True):
        radiance, old = tile.radiance.copy(), tile.radiance[where]
        radiance[where] = np.maximum(old + tile.alpha[where][:, None] * values, np.minimum(old, 0.0))
        drawn.append(replace(tile, radiance=radiance))
    return tuple(drawn)


def _added(
    shot: Shot, light: ShaftLight, scene: ShaftScene, ends: NDArray[np.float32], cache: Cache
) -> NDArray[np.float32]:
    """Return what lies before objects (n, 3), times strength. ends: (3, n) column, row and distance [m] of each."""
    settings = light.settings
    found, places = np.zeros((ends.shape[1], 3), np.float32), by_content(ends)
    for part in scene.parts:
        change = cache.of(_change, part.per_unit, settings, shot.view, places, cache, keep=2)
        found += change if part.pattern is None else change * part.pattern.sun.irradiance.astype(np.float32)
    return np.float32(settings.strength) * found


def _change(
    scene: ShaftScene, settings: ShaftSettings, view: View, ends: PartOf[NDArray[np.float32]], cache: Cache
) -> NDArray[np.float32]:
    """Return `change_along` the rays to ends (3, n)."""
    x, y, end_m = ends.whole.astype(np.float64)
    middle = view.from_middle(np.asarray(view.directions(x, y), np.float64), np.minimum(end_m, settings.range_m))
    rays, end_m = (np.asarray(a, np.float64) for a in middle)
    return change_along(scene, settings, view.width, rays, end_m, cache).astype(np.float32)


def _joined(arrays: list[Floats]) -> NDArray[np.float32]:
    return np.concatenate([np.zeros(0, np.float32), *arrays]).astype(np.float32)


_SPARE_PX = 4096
"""Pixels that a rectangle of the frame must save to be cut in two."""
_BLOCKS = 512
"""Blocks around the horizon in wide frames, as many as the columns of the default grid before the plate."""


def before_plate(shot: Shot, light: ShaftLight, scene: ShaftScene, layer: Layer, cache: Cache) -> Layer:
    """Return a layer with `Tile.shafts` of a scene of the water before the plate, and tiles where it has none yet.

    cache: holds what does not change from frame to frame.
    """
    view = shot.view
    if scene.dark:
        return layer
    waves = scene.pattern is not None and scene.pattern.caustics is not None
    settings = light.settings
    marked = (
        cache.of(_everywhere, view.height, view.width) if waves
        else shaft_pixels(shot, scene, settings.range_m, settings.least_codes / max(settings.strength, 1e-9), cache)
    )  # fmt: skip
    if not np.any(marked):
        return layer
    found: dict[int, NDArray[np.float32]] = {}
    for part in scene.parts:
        blocks, side = _in_blocks(shot, light, part, marked, cache)
        found[side] = found.get(side, np.float32(0.0)) + np.float32(settings.strength) * blocks
    of_layer = tuple(tile.rectangle for tile in layer.tiles)
    drawn = []
    for rectangle in cache.of(_cut, of_layer, marked):
        tile = tile_of(layer, rectangle)
        where = marked[tile.window] & (tile.alpha < 1.0)
        if not np.any(where):
            drawn.append(tile)
            continue
        shafts: Floats = np.zeros((*where.shape, 3), np.float32)
        for side, blocks in found.items():
            shafts += _pixels(blocks, side, rectangle)
        shafts *= where[..., None]
        if shot.holdout is not None:
            shafts *= 1.0 - np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)[..., None]
        drawn.append(replace(tile, shafts=shafts) if np.any(shafts) else tile)
    return replace(layer, tiles=tuple(drawn))


def _in_blocks(
    shot: Shot, light: ShaftLight, part: ShaftScene, marked: Mask, cache: Cache
) -> tuple[NDArray[np.float32], int]:
    """Return what one kind of light changes in blocks of side x side pixels (rows, columns, 3), and the side.

    marked: (H, W) pixels whose blocks are found, with those beside them.
    """
    # a lamp's beam is thin at the lamp
    side = 1 if part.pattern is None else max(shot.view.width // _BLOCKS, 1)
    near = cache.of(_blocks_near, marked, side, keep=2)
    ends = PartOf(shot, shot.view, shot.receiver, shot.holdout_distance_m)
    change = cache.of(_change_in_blocks, ends, light.settings, part.per_unit, near, side, cache, keep=2)
    return change if part.pattern is None else change * part.pattern.sun.irradiance.astype(np.float32), side


def _everywhere(height: int, width: int) -> Mask:
    return np.ones((height, width), np.bool_)


def _blocks_near(marked: Mask, side: int) -> Mask:
    """Return the blocks with marked pixels (H, W) and those beside them."""
    some = np.pad(marked[::side, ::side], ((0, 0), (1, 1)), "wrap").astype(np.uint8)
    return np.asarray(cv2.dilate(some, np.ones((3, 3), np.uint8))[:, 1:-1] > 0)


def _pixels(change: NDArray[np.float32], side: int, part: Rectangle) -> NDArray[np.float32]:
    """Return the pixels (h, w, 3) of a rectangle, bilinear between the middles of blocks, periodic in columns."""
    first_row, first_column = part.row // side - 1, part.column // side - 1
    row = np.arange(first_row, (part.row + part.height - 1) // side + 2)
    column = np.arange(first_column, (part.column + part.width - 1) // side + 2)
    near = change[np.clip(row, 0, len(change) - 1)[:, None], column % change.shape[1]]
    if side > 1:
        near = cv2.resize(near, None, fx=side, fy=side, interpolation=cv2.INTER_LINEAR)
    top, left = part.row - first_row * side, part.column - first_column * side
    return np.asarray(near[top : top + part.height, left : left + part.width])


def _cut(of_layer: tuple[Rectangle, ...], marked: Mask) -> list[Rectangle]:
    """Return the tiles of a layer with those of marked pixels (H, W)."""
    height, width = marked.shape
    return even_tiles([*of_layer, *rectangles_of_mask(marked, _SPARE_PX)], width, height)


def _change_in_blocks(
    ends: PartOf[Shot], settings: ShaftSettings, scene: ShaftScene, near: Mask, side: int, cache: Cache
) -> NDArray[np.float32]:
    """Return what one kind of light changes before a shot's plate in marked blocks, (rows, columns, 3)."""
    shot = ends.whole
    row, column = np.nonzero(near)
    x, y = (column + 0.5) * side, np.minimum((row + 0.5) * side, shot.view.height - 0.5)
    rays = np.asarray(shot.view.directions(x, y), np.float64)
    end_m = np.minimum(plate_distance(shot, x, y, rays, cache), settings.range_m)
    rays, end_m = (np.asarray(a, np.float64) for a in shot.view.from_middle(rays, end_m))
    blocks = np.zeros((*near.shape, 3), np.float32)
    blocks[row, column] = change_along(scene, settings, shot.view.width, rays, end_m, cache)
    return blocks
