# SPDX-License-Identifier: Apache-2.0
"""Light in the water before the plate: shadows of bodies and beams of lamps over what a shot shows behind its objects.

It has no edges but those of shadows in the water, which the water blurs, so it is found for blocks of pixels and read
bilinearly between their middles. Without waves it goes with the sun's strength, and stands still as long as sun, bodies
and camera do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, by_content
from mr360uw.composite.over import tile_of
from mr360uw.composite.receiver.shape import plate_distance
from mr360uw.composite.shafts.code_change import shaft_pixels
from mr360uw.composite.shafts.shaft_light import ShaftLight, change_along
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, rectangles_of_mask
from mr360uw.medium.shafts.settings import ShaftSettings
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.types import Layer, Rectangle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
        np.ones((view.height, view.width), np.bool_) if waves
        else shaft_pixels(shot, scene, settings.range_m, settings.least_codes / max(settings.strength, 1e-9), cache)
    )  # fmt: skip
    if not np.any(marked):
        return layer
    found = [_Blocks.of(shot, light, part, marked, cache) for part in scene.parts]
    of_layer = tuple(tile.rectangle for tile in layer.tiles)
    drawn = []
    for part in cache.of(_cut, of_layer, by_content(marked)):
        tile = tile_of(layer, part)
        where = marked[tile.window] & (tile.alpha < 1.0)
        if not np.any(where):
            drawn.append(tile)
            continue
        shafts = settings.strength * sum(blocks.pixels(part) for blocks in found) * where[..., None]
        if shot.holdout is not None:
            shafts *= 1.0 - np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)[..., None]
        drawn.append(replace(tile, shafts=shafts) if np.any(shafts) else tile)
    return replace(layer, tiles=tuple(drawn))


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """What one kind of light changes in blocks of side x side pixels. change: (rows, columns, 3)."""

    change: NDArray[np.float32]
    side: int

    @classmethod
    def of(cls, shot: Shot, light: ShaftLight, part: ShaftScene, marked: Mask, cache: Cache) -> _Blocks:
        """Return the blocks of marked pixels (H, W) and those beside them."""
        # a lamp's beam is thin at the lamp
        side = 1 if part.pattern is None else max(shot.view.width // _BLOCKS, 1)
        some = np.pad(marked[::side, ::side], ((0, 0), (1, 1)), "wrap").astype(np.uint8)
        near = cv2.dilate(some, np.ones((3, 3), np.uint8))[:, 1:-1] > 0
        ends = PartOf(shot, shot.view, shot.receiver, shot.holdout_distance_m)
        change = cache.of(_change, ends, light.settings, part.per_unit, near, side, cache, keep=2)
        return cls(change if part.pattern is None else change * part.pattern.sun.irradiance.astype(np.float32), side)

    def pixels(self, part: Rectangle) -> NDArray[np.float32]:
        """Return the pixels (h, w, 3) of a rectangle, bilinear between the middles of blocks, periodic in columns."""
        side = self.side
        first_row, first_column = part.row // side - 1, part.column // side - 1
        row = np.arange(first_row, (part.row + part.height - 1) // side + 2)
        column = np.arange(first_column, (part.column + part.width - 1) // side + 2)
        near = self.change[np.clip(row, 0, len(self.change) - 1)[:, None], column % self.change.shape[1]]
        if side > 1:
            near = cv2.resize(near, None, fx=side, fy=side, interpolation=cv2.INTER_LINEAR)
        top, left = part.row - first_row * side, part.column - first_column * side
        return np.asarray(near[top : top + part.height, left : left + part.width], np.float32)


def _cut(of_layer: tuple[Rectangle, ...], marked: PartOf[Mask]) -> list[Rectangle]:
    """Return the tiles of a layer with those of marked pixels (H, W)."""
    height, width = marked.whole.shape
    return even_tiles([*of_layer, *rectangles_of_mask(marked.whole, _SPARE_PX)], width, height)


def _change(
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
