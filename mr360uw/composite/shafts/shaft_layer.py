# SPDX-License-Identifier: Apache-2.0
"""Adds light in the water to a layer that is drawn: to its objects what lies before them, to its tiles what lies before
the plate.

    radiance += alpha strength D(distance of the object)        shafts = strength D(distance of the receiver)

D is the deviation from the smooth veil (`medium.shafts.deviation`). No pixel turns negative by it. Both renderers share
it: it needs the layer's distances alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.lighting.sun import sun_of, sun_up
from mr360uw.composite.over import tile_of
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.shafts.shaft_light import ShaftLight
from mr360uw.composite.shafts.shaft_reach import shaft_pixels
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, rectangles_of_mask
from mr360uw.medium.shafts.beam_share import unoccluded
from mr360uw.medium.shafts.froxels import shaft_field
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import unit
from mr360uw.types import Floats, Layer, Tile

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SPARE_PX = 4096
"""Pixels that a rectangle of the frame must save to be cut in two."""


def with_shafts(
    shot: Shot, light: ShaftLight, layer: Layer, variables: Aovs | None, kept: Cache
) -> tuple[Layer, Aovs | None]:
    """Return a shot's layer and output variables with the light in the water. kept: holds what does not change."""
    before, behind = light.scenes(shot, kept)
    tiles = _before_objects(shot, light, before, layer.tiles, kept)
    if variables is not None:
        shown = variables.shafts.copy()
        for tile, old in zip(tiles, layer.tiles, strict=True):
            shown[tile.window] += tile.radiance - old.radiance
        variables = replace(variables, shafts=shown)
    return _before_plate(shot, light, behind, replace(layer, tiles=tiles), kept), variables


def _before_objects(
    shot: Shot, light: ShaftLight, scene: ShaftScene, tiles: tuple[Tile, ...], kept: Cache
) -> tuple[Tile, ...]:
    covered = [tile.alpha > 0.0 for tile in tiles]
    ends = [tile.distance_m[where] for tile, where in zip(tiles, covered, strict=True)]
    rays = _rays(shot, tiles, covered)
    added = _split(_deviation(shot, light, scene, rays, _joined(ends), kept, objects=True), covered)
    drawn = []
    for tile, where, values in zip(tiles, covered, added, strict=True):
        radiance, old = tile.radiance.copy(), tile.radiance[where]
        radiance[where] = np.maximum(old + tile.alpha[where][:, None] * values, np.minimum(old, 0.0))
        drawn.append(replace(tile, radiance=radiance))
    return tuple(drawn)


def _before_plate(shot: Shot, light: ShaftLight, scene: ShaftScene, layer: Layer, kept: Cache) -> Layer:
    view, settings = shot.view, light.settings
    if scene.dark:
        return layer
    everywhere = settings.on_plate and light.caustics is not None
    marked = (
        np.ones((view.height, view.width), np.bool_) if everywhere
        else shaft_pixels(shot, scene, settings.range_m, settings.threshold, kept)
    )  # fmt: skip
    if not np.any(marked):
        return layer
    parts = [tile.rectangle for tile in layer.tiles] + rectangles_of_mask(marked, _SPARE_PX)
    tiles = [tile_of(layer, part) for part in even_tiles(parts, view.width, view.height)]
    where = [marked[tile.window] & (tile.alpha < 1.0) for tile in tiles]
    rays = _rays(shot, tiles, where)
    values = _split(_deviation(shot, light, scene, rays, _receiver_m(shot, tiles, where, rays, kept), kept), where)
    drawn = []
    for tile, here, change in zip(tiles, where, values, strict=True):
        if not np.any(change):
            drawn.append(tile)
            continue
        shafts = np.zeros_like(tile.radiance)
        shafts[here] = change
        if shot.holdout is not None:
            shafts *= 1.0 - np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)[..., None]
        drawn.append(replace(tile, shafts=shafts))
    return replace(layer, tiles=tuple(drawn))


def _deviation(
    shot: Shot, light: ShaftLight, scene: ShaftScene, rays: Array, end_m: Array, kept: Cache, *, objects: bool = False
) -> Floats:
    """Return the deviation (n, 3) times strength along rays (n, 3), float32. objects: whether they end at objects."""
    settings, sun = light.settings, sun_of(shot)
    end_m = np.minimum(end_m, settings.range_m)
    found = np.zeros((len(rays), 3))
    if len(rays) and not scene.dark:
        grid = light.grid(shot.view.width)
        # beside bright and dark edges the cubic between the grid's nodes overshoots
        if scene.pattern is not None:
            of_sun = shaft_field(replace(scene, lamps=()), grid, rays, kept).radiance(rays, end_m)
            found += np.minimum(of_sun, 0.0) if scene.pattern.caustics is None else of_sun
        if scene.lamps:
            lit = shaft_field(replace(scene, pattern=None), grid, rays, kept).radiance(rays, end_m)
            found += np.maximum(lit, 0.0)
    if objects and settings.whole and sun is not None:
        cosine = rays @ unit(sun.direction)
        found += sun.irradiance * unoccluded(scene.water, cosine, rays[:, 1], end_m, scene.depth_m, sun_up(sun))
    return np.asarray(settings.strength * found, np.float32)


def _receiver_m(shot: Shot, tiles: list[Tile], where: list[Mask], rays: Array, kept: Cache) -> Array:
    """Return the distances (n,) of the receiver in marked pixels, infinite where there is none."""
    if shot.receiver is None:
        return np.full(len(rays), np.inf)
    x, y = _places(tiles, where)
    of_shape = shot.receiver, shot.view.position.tobytes()
    shape = kept.get("shape", of_shape, lambda: ReceiverShape(of_shape[0], shot.view.position))
    distance, _ = shape.meet_along(shot.view, x, y, rays)
    return np.asarray(distance, np.float64)


def _rays(shot: Shot, tiles: tuple[Tile, ...] | list[Tile], where: list[Mask]) -> Array:
    return np.asarray(shot.view.directions(*_places(tiles, where)), np.float64).reshape(-1, 3)


def _places(tiles: tuple[Tile, ...] | list[Tile], where: list[Mask]) -> tuple[Array, Array]:
    """Return the frame coordinates (n,) of the centres of marked pixels of all tiles."""
    marked = [(np.nonzero(mask), tile) for tile, mask in zip(tiles, where, strict=True)]
    x = _joined([at[1] + tile.column + 0.5 for at, tile in marked])
    return x, _joined([at[0] + tile.row + 0.5 for at, tile in marked])


def _joined(arrays: list[Floats]) -> Array:
    return np.concatenate([np.zeros(0), *arrays])


def _split(values: Floats, where: list[Mask]) -> list[Floats]:
    """Return rows (n, 3) divided among the marked pixels of each tile."""
    return np.split(values, np.cumsum([int(mask.sum()) for mask in where])[:-1]) if where else []
