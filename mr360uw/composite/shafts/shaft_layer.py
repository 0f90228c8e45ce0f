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

from mr360uw.cache import Cache, PartOf, by_content
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.shafts.plate_shafts import before_plate
from mr360uw.composite.shafts.shaft_light import ShaftLight, change_along
from mr360uw.composite.shot import Shot
from mr360uw.medium.shafts.settings import ShaftSettings
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.types import Floats, Layer, Tile

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
    ends = [tile.distance_m[where] for tile, where in zip(tiles, covered, strict=True)]
    rays = _rays(shot, tiles, covered)
    added = _split(_added(shot, light, scene, rays, _joined(ends), cache), covered)
    drawn = []
    for tile, where, values in zip(tiles, covered, added, strict=True):
        radiance, old = tile.radiance.copy(), tile.radiance[where]
        radiance[where] = np.maximum(old + tile.alpha[where][:, None] * values, np.minimum(old, 0.0))
        drawn.append(replace(tile, radiance=radiance))
    return tuple(drawn)


def _added(shot: Shot, light: ShaftLight, scene: ShaftScene, rays: Array, end_m: Array, cache: Cache) -> Floats:
    """Return what lies before objects (n, 3) at ends (n,) [m] of rays (n, 3), times strength, float32."""
    settings = light.settings
    end_m = np.minimum(end_m, settings.range_m)
    rays, end_m = (np.asarray(a, np.float64) for a in shot.view.from_middle(rays, end_m))
    found, ends = np.zeros((len(rays), 3)), np.column_stack([rays, end_m])
    for part in scene.parts:
        change = cache.of(_change, part.per_unit, light.settings, shot.view.width, by_content(ends), cache, keep=2)
        found += change if part.pattern is None else change * part.pattern.sun.irradiance
    return np.asarray(settings.strength * found, np.float32)


def _change(scene: ShaftScene, settings: ShaftSettings, width: int, ends: PartOf[Array], cache: Cache) -> Array:
    """Return `change_along` rays. ends: (n, 4) their directions and lengths."""
    return change_along(scene, settings, width, ends.whole[:, :3], ends.whole[:, 3], cache)


def _rays(shot: Shot, tiles: tuple[Tile, ...], where: list[Mask]) -> Array:
    return np.asarray(shot.view.directions(*_places(tiles, where)), np.float64).reshape(-1, 3)


def _places(tiles: tuple[Tile, ...], where: list[Mask]) -> tuple[Array, Array]:
    """Return the frame coordinates (n,) of the centres of marked pixels of all tiles."""
    marked = [(np.nonzero(mask), tile) for tile, mask in zip(tiles, where, strict=True)]
    x = _joined([at[1] + tile.column + 0.5 for at, tile in marked])
    return x, _joined([at[0] + tile.row + 0.5 for at, tile in marked])


def _joined(arrays: list[Floats]) -> Array:
    return np.concatenate([np.zeros(0), *arrays])


def _split(values: Floats, where: list[Mask]) -> list[Floats]:
    """Return rows (n, 3) divided among the marked pixels of each tile."""
    return np.split(values, np.cumsum([int(mask.sum()) for mask in where])[:-1]) if where else []
