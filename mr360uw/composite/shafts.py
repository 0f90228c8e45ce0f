# SPDX-License-Identifier: Apache-2.0
"""Adds light in the water to a layer that is drawn: to its objects what lies before them, to its tiles what lies before
the plate.

    radiance += alpha strength D(distance of the object)        shafts = strength D(distance of the receiver)

D is the deviation from the smooth veil (`shaft_field`). No pixel turns negative by it. Both renderers share
it: it needs the layer's distances alone.

Light before the plate has no edges but those of shadows in the water, which the water blurs, so it is found for blocks
of pixels and read bilinearly between their middles. Without waves it goes with the sun's strength, and stands still as
long as sun, bodies and camera do.

The plate has the shafts of its own waves already: over it only what bodies take away and lamps add is drawn, unless
`on_plate` asks for all.

The frame is divided into cells, and the light in their middles is read from a coarse grid. A cell is drawn where that
light, or that of a cell near it, changes a code by a third of the threshold. A shaft too thin for the coarse grid is
too thin to be seen: what it adds falls with the length of the ray within it, as its width does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import Cache, PartOf, Parts, by_content
from mr360uw.base.color import encode
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.light_sources import casting_bodies, spread_rad, sun_of, sun_up
from mr360uw.composite.receiver.shape import plate_distance
from mr360uw.composite.shading import veil_ahead
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, rectangles_of_mask, tile_of
from mr360uw.medium.medium import Medium
from mr360uw.medium.settings import LEAST_NODES, ShaftSettings
from mr360uw.medium.shafts.shaft_field import FroxelGrid, shaft_field
from mr360uw.medium.shafts.shaft_scene import ShaftScene, shaft_water, unoccluded
from mr360uw.types import CausticStack, Floats, Layer, MediumTable, Rectangle, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def with_shafts(
    shot: Shot, light: ShaftInput, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return a shot's layer and output variables with the light in the water. cache: holds what does not change."""
    before, behind = light.scenes(shot, cache)
    # Find what lies before every covered pixel of the tiles, for unit light where the sun's strength alone changes
    pixels = [np.nonzero(tile.alpha > 0.0) for tile in layer.tiles]
    ends = np.concatenate([np.zeros((3, 0)), *(
        np.stack([i + tile.column + 0.5, j + tile.row + 0.5, tile.distance_m[j, i]])
        for (j, i), tile in zip(pixels, layer.tiles, strict=True)
    )], axis=1).astype(np.float32)  # fmt: skip
    found, places = np.zeros((ends.shape[1], 3), np.float32), by_content(ends)
    for part in before.parts:
        change = cache.of(_change, part.per_unit, light.settings, shot.view, places, cache, keep=2)
        found += change if part.pattern is None else change * part.pattern.sun.irradiance.astype(np.float32)
    # Add it to the objects, whose light it leaves positive
    added = np.float32(light.settings.strength) * found
    parts = np.split(added, np.cumsum([len(rows) for rows, _ in pixels])[:-1]) if pixels else []
    tiles = []
    for tile, at, values in zip(layer.tiles, pixels, parts, strict=True):
        radiance, old = tile.radiance.copy(), tile.radiance[at]
        radiance[at] = np.maximum(old + tile.alpha[at][:, None] * values, np.minimum(old, 0.0))
        tiles.append(replace(tile, radiance=radiance))
    if variables is not None:
        shown = variables.shafts.copy()
        for tile, was in zip(tiles, layer.tiles, strict=True):
            shown[tile.window] += tile.radiance - was.radiance
        variables = replace(variables, shafts=shown)
    return before_plate(shot, light, behind, replace(layer, tiles=tuple(tiles)), cache), variables


def _change(
    scene: ShaftScene, settings: ShaftSettings, view: View, ends: PartOf[NDArray[np.float32]], cache: Cache
) -> NDArray[np.float32]:
    """Return `change_along` the rays to ends (3, n)."""
    x, y, end_m = ends.whole.astype(np.float64)
    middle = view.from_middle(np.asarray(view.directions(x, y), np.float64), np.minimum(end_m, settings.range_m))
    rays, end_m = (np.asarray(a, np.float64) for a in middle)
    return change_along(scene, settings, view.width, rays, end_m, cache).astype(np.float32)


_SPARE_PX = 4096
"""Pixels that a rectangle of the frame must save to be cut in two."""
_BLOCKS = 512
"""Blocks around the horizon in wide frames, as many as the columns of the default grid before the plate."""


def before_plate(shot: Shot, light: ShaftInput, scene: ShaftScene, layer: Layer, cache: Cache) -> Layer:
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
            shafts += pixels_of_blocks(blocks, side, rectangle)
        shafts *= where[..., None]
        if shot.holdout is not None:
            shafts *= 1.0 - np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)[..., None]
        drawn.append(replace(tile, shafts=shafts) if np.any(shafts) else tile)
    return replace(layer, tiles=tuple(drawn))


def _in_blocks(
    shot: Shot, light: ShaftInput, part: ShaftScene, marked: Mask, cache: Cache
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


def pixels_of_blocks(change: NDArray[np.float32], side: int, part: Rectangle) -> NDArray[np.float32]:
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


@dataclass(frozen=True, slots=True, eq=False)
class ShaftInput(Parts):
    """Water, waves and settings of shafts.

    medium: of the shot's depth. caustics: of its sun, from the camera's depth to the objects'; None without waves.
    """

    settings: ShaftSettings
    medium: Medium
    caustics: CausticStack | None = None

    def scenes(self, shot: Shot, cache: Cache) -> tuple[ShaftScene, ShaftScene]:
        """Return the scenes of the water before the objects, and of that before the plate. cache: holds the bodies."""
        settings, bodies = self.settings, casting_bodies(shot, cache)
        before = ShaftScene.of(shot.view, self.medium, shot.lights, bodies, self.caustics, spread_rad(shot))
        if settings.on_plate or before.pattern is None or self.caustics is None:
            return before, before
        still = replace(before.pattern, caustics=None)
        return before, replace(before, pattern=None if still.even else still)


def grid_of(settings: ShaftSettings, width: int, part: ShaftScene) -> FroxelGrid:
    """Return the size of the grid of one kind of light for a frame that is `width` pixels wide.

    At most one node for two pixels, of lamps one for each, as a beam is thin at its lamp; half as many where no waves
    make fine shafts.
    """
    most, slices = min(settings.resolution, width // 2), settings.slices
    if part.pattern is None:
        columns = max(2 * most, LEAST_NODES) // 8 * 8
        return FroxelGrid(columns // 2, columns, slices)
    columns = max(most, LEAST_NODES) // 8 * 8
    if part.pattern.caustics is None:
        return FroxelGrid(3 * columns // 16, columns // 4 * 2, max(slices // 2, 2))
    return FroxelGrid(3 * columns // 8, columns, slices)


def change_along(
    scene: ShaftScene, settings: ShaftSettings, width: int, rays: Array, end_m: Array, cache: Cache
) -> Array:
    """Return how light in the water deviates (n, 3) along rays (n, 3) from the camera up to ends (n,) [m].

    Beside bright and dark edges the cubic between the grid's nodes overshoots: bodies add no light of the sun, and
    lamps take none away. width: see `grid_of`.
    """
    found = np.zeros((len(rays), 3))
    for part in scene.parts if len(rays) else ():
        change = shaft_field(part, grid_of(settings, width, part), rays, cache).radiance(rays, end_m)
        if part.pattern is None:
            change = np.maximum(change, 0.0)
        elif part.pattern.caustics is None:
            change = np.minimum(change, 0.0)
        found += change
    return found


_ROWS = 128
"""Cells from pole to pole, 1.4 degrees each."""
_AROUND = 2
"""Cells on every side of one with light that are drawn too."""
_MARGIN = 0.35
"""Fraction of the threshold at which a cell is drawn: between the coarse nodes there may be more."""
_STEP = 1.25
"""Ratio of the steps that the light is rounded to before cells are marked."""
_GRID = FroxelGrid(64, 192, 16)
"""The coarse grid: a sixth of the default one in both directions, half as many slices."""


def shaft_pixels(shot: Shot, scene: ShaftScene, range_m: float, least_codes: float, cache: Cache) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels over whose veil the scene's light may change a code by `least_codes`.

    cache: holds what does not change from frame to frame.
    """
    # between two light samples veil and sun are those of the first, whose mask holds for all frames up to the next
    table, sun = shot.medium, sun_of(shot)
    if shot.between is not None:
        table, sun = shot.between.before.medium, sun_of(shot.between.before)
    parts = tuple(part.per_unit for part in scene.parts)
    of_sun = np.zeros(3) if sun is None else _stepped(sun.irradiance)
    light = tuple(np.ones(3) if part.pattern is None else of_sun for part in parts)
    marked = cache.of(_marked_cells, shot.view, table, parts, light, range_m, least_codes, cache)
    return cache.of(_pixels_of, marked, shot.view.width, shot.view.height)


def _cell_side(height: int) -> int:
    """Return the side [px] of cells of a frame."""
    return max(2 * -(-height // (2 * _ROWS)), 2)


def _pixels_of(cells: NDArray[np.bool_], width: int, height: int) -> NDArray[np.bool_]:
    """Return the mask (H, W) of the pixels of marked cells."""
    side = _cell_side(height)
    return np.repeat(np.repeat(cells, side, axis=0), side, axis=1)[:height, :width]


def _marked_cells(
    view: View,
    table: MediumTable | None,
    parts: tuple[ShaftScene, ...],
    light: tuple[Array, ...],
    range_m: float,
    least_codes: float,
    cache: Cache,
) -> NDArray[np.bool_]:
    """Return the cells (rows, columns) of `shaft_pixels`. table: of the veil. parts: scenes of one kind of light each,
    of a unit; light: (3,) how much of it there is, in steps.
    """
    side = _cell_side(view.height)
    rows, columns = -(-view.height // side), -(-view.width // side)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * side, (np.arange(rows) + 0.5) * side)
    directions = np.asarray(view.directions(x, np.minimum(y, view.height - 0.5)), np.float64).reshape(-1, 3)
    ends, marked = np.full(len(directions), range_m), np.zeros(rows * columns, np.bool_)
    changes = [
        of * cache.of(_radiance, part, directions, ends, cache, keep=2) for part, of in zip(parts, light, strict=True)
    ]
    # Most cells have none of it: the veil is found where there is some
    there = np.flatnonzero(np.any(changes, axis=(0, -1)))
    if len(there):
        veil = np.zeros((len(there), 3)) if table is None else veil_ahead(table, ends[there], directions[there])
        veil = veil * _stepped(np.mean(veil)) / max(float(np.mean(veil)), 1e-30)
        codes = sum((code_change(veil, change[there]) for change in changes), np.zeros(len(there)))
        marked[there] = (codes >= _MARGIN * least_codes) & (codes > 0.0)
    cells = marked.reshape(rows, columns)
    around = np.pad(np.pad(cells, ((0, 0), (_AROUND,) * 2), "wrap"), ((_AROUND,) * 2, (0, 0))).astype(np.uint8)
    reach = np.ones((2 * _AROUND + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(around, reach)[_AROUND:-_AROUND, _AROUND:-_AROUND] > 0)


def _radiance(scene: ShaftScene, directions: Array, ends: Array, cache: Cache) -> Array:
    return shaft_field(scene, _GRID, directions, cache).radiance(directions, ends)


def _stepped(light: ArrayLike) -> Array:
    """Return light (...,) rounded up to a step, so that small changes of it mark the same cells."""
    return np.asarray(_STEP ** np.ceil(np.log(np.maximum(light, 1e-30)) / np.log(_STEP)))


_WAVES = 0.15
"""Most that waves change of the beam's light before an object, as a fraction: a ray crosses many filaments. Over
whales at 4 and 10 m in four waters, 3 and 8 m deep, the 99th percentile is 0.02 to 0.15."""
_SHADOW_M = np.concatenate([[0.0], np.geomspace(0.25, 60.0, 24)])
"""Distances [m] behind a body at which its shadow in the water is looked at."""
_LONGEST_M = 20.0
"""Longest way [m] of a ray through a shadow that is reckoned with: of rays along it."""


def code_change(level: Floats, change: Floats) -> Floats:
    """Return the greatest change (n,) of a channel's 8-bit code where light (n, 3) is added to a level (n, 3).

    Codes are BT.709's, 255 at a radiance of 1. Levels are taken as 0 at least.
    """
    before = np.maximum(level, 0.0)
    return np.asarray(255.0 * np.abs(encode(np.maximum(before + change, 0.0), "bt709") - encode(before, "bt709"))).max(
        axis=-1
    )


def shafts_show(shot: Shot, settings: ShaftSettings, medium: Medium) -> tuple[bool, bool]:
    """Return whether waves may change the light before a shot's objects by `ShaftSettings.least_codes`, and whether
    bodies' shadows in the water may.

    For waves each object is taken as black, as a change shows most on its veil alone, and at its middle. A shadow is
    taken as a cylinder as wide as the mean of the body's two shorter extents, before the veil. Of a whale at six places
    in three waters the true change is 0.1 to 1.5 times as large where it is below 2 codes.
    """
    sun, least = sun_of(shot), settings.least_codes
    if sun is None or least == 0.0:
        return least == 0.0 or settings.on_plate, least == 0.0
    # Rays to the objects' middles, then to places in the shadows of those that cast them
    eye, towards = shot.view.position, sun.direction
    seen, behind, wide = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)]
    for placed in shot.objects:
        middle = (placed.to_world(placed.mesh.center_m) - eye)[None]
        if placed.visible:
            seen.append(middle)
        if placed.casts_shadow:
            behind.append(middle - _SHADOW_M[:, None] * towards)
            wide.append(np.full(len(_SHADOW_M), np.mean(np.sort(placed.mesh.extent_m)[:2]) * placed.scale))
    to, waves = np.concatenate([*seen, *behind]), len(seen) - 1
    distance = np.maximum(np.linalg.norm(to, axis=-1), 1e-9)
    rays = to / distance[:, None]
    # What is at stake: a fraction of the light before an object, all of that within a shadow
    cosine, up = rays @ towards, rays[:, 1]
    sine = np.sqrt(np.maximum(1.0 - cosine[waves:] ** 2, 1e-6))
    half = np.minimum(0.5 * np.concatenate(wide) / sine, 0.5 * _LONGEST_M)
    start = np.concatenate([np.zeros(waves), distance[waves:] - half])
    end = np.concatenate([distance[:waves], distance[waves:] + half])
    depth_m = max(shot.view.surface_y_m - float(eye[1]), 0.0)
    out = np.divide(depth_m, up, out=np.full(len(up), settings.range_m), where=up > 0.0)
    start, end = np.clip([start, end], 0.0, np.minimum(out, settings.range_m))
    change = sun.irradiance * unoccluded(shaft_water(medium), cosine, up, start, end, depth_m, sun_up(sun))
    change[:waves] *= _WAVES
    change[waves:] *= -1.0
    # How far it changes a code of the veil
    shown = np.minimum(distance, settings.range_m)
    shown[waves:] = settings.range_m
    veil = np.zeros((len(rays), 3)) if shot.medium is None else veil_ahead(shot.medium, shown, rays)
    changes = code_change(veil, settings.strength * change) >= least
    return settings.on_plate or bool(np.any(changes[:waves])), bool(np.any(changes[waves:]))
