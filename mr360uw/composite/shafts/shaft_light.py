# SPDX-License-Identifier: Apache-2.0
"""What the shafts of a shot depend on beside the shot itself, their scenes before and behind its objects, and where
they show in a picture of 8 bits.

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

from mr360uw.cache import Cache, Parts, shared
from mr360uw.color import encode
from mr360uw.composite.lighting.blockers import casting_bodies
from mr360uw.composite.lighting.sun import spread_rad, sun_in, sun_of, sun_up
from mr360uw.composite.lighting.surfaces import veil_ahead
from mr360uw.composite.shot import Shot
from mr360uw.medium.medium import Medium
from mr360uw.medium.shafts.froxels import FroxelGrid, shaft_field
from mr360uw.medium.shafts.settings import LEAST_NODES, ShaftSettings
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.medium.shafts.shaft_water import ShaftWater, unoccluded
from mr360uw.sphere import unit
from mr360uw.types import CausticStack, Floats, Lamp, MediumTable, View

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ShaftLight(Parts):
    """Water, waves and settings of shafts.

    medium: of the shot's depth. caustics: of its sun, from the camera's depth to the objects'; None without waves.
    """

    settings: ShaftSettings
    medium: Medium
    caustics: CausticStack | None = None

    def scenes(self, shot: Shot, cache: Cache) -> tuple[ShaftScene, ShaftScene]:
        """Return the scenes of the water before the objects, and of that before the plate. cache: holds the bodies."""
        settings, bodies = self.settings, casting_bodies(shot, cache)
        lamps = tuple(light for light in shot.lights if isinstance(light, Lamp))
        before = ShaftScene.of(shot.view, self.medium, sun_of(shot), bodies, self.caustics, lamps, spread_rad(shot))
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
        table, sun = shot.between.before.medium, sun_in(shot.between.before.lights)
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
    ends = np.full(len(directions), range_m)
    veil = np.zeros((len(ends), 3)) if table is None else veil_ahead(table, ends, directions)
    veil = veil * _stepped(np.mean(veil)) / max(float(np.mean(veil)), 1e-30)
    changes = [
        of * cache.of(_radiance, part, directions, ends, cache, keep=2) for part, of in zip(parts, light, strict=True)
    ]
    codes = sum((code_change(veil, change) for change in changes), np.zeros(len(veil)))
    marked = ((codes >= _MARGIN * least_codes) & (codes > 0.0)).reshape(rows, columns)
    around = np.pad(np.pad(marked, ((0, 0), (_AROUND,) * 2), "wrap"), ((_AROUND,) * 2, (0, 0))).astype(np.uint8)
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


def waves_show(shot: Shot, light: ShaftLight) -> bool:
    """Return whether waves may change the light before a shot's objects by `ShaftSettings.least_codes`.

    Each object is taken as black, as a change shows most on its veil alone, and at its middle.
    """
    sun, settings = sun_of(shot), light.settings
    if settings.least_codes == 0.0 or settings.on_plate:
        return True
    if sun is None or not shot.visible:
        return False
    to = np.array([placed.to_world(placed.mesh.center_m) for placed in shot.visible]) - shot.view.position
    distance = np.maximum(np.linalg.norm(to, axis=-1), 1e-9)
    rays, end = to / distance[:, None], np.minimum(distance, settings.range_m)
    beam = _beam_before(shot, light, rays, end)
    return _shows(shot, light, rays, end, _WAVES * beam)


def bodies_show(shot: Shot, light: ShaftLight) -> bool:
    """Return whether a body's shadow in the water may change a code by `ShaftSettings.least_codes`.

    The shadow is taken as a cylinder as wide as the mean of the body's two shorter extents, before the veil. Of a whale
    at six places in three waters the true change is 0.1 to 1.5 times as large where it is below 2 codes.
    """
    sun, settings = sun_of(shot), light.settings
    if settings.least_codes == 0.0:
        return True
    if sun is None or not shot.casters:
        return False
    towards = unit(sun.direction)
    middle = np.array([placed.to_world(placed.mesh.center_m) for placed in shot.casters]) - shot.view.position
    wide = np.array([np.mean(np.sort(placed.mesh.extent_m)[:2]) * placed.scale for placed in shot.casters])
    to = (middle[:, None] - _SHADOW_M[:, None] * towards).reshape(-1, 3)
    distance = np.maximum(np.linalg.norm(to, axis=-1), 1e-9)
    rays = to / distance[:, None]
    sine = np.sqrt(np.maximum(1.0 - (rays @ towards) ** 2, 1e-6))
    half = np.minimum(0.5 * np.repeat(wide, len(_SHADOW_M)) / sine, 0.5 * _LONGEST_M)
    ends = np.clip(np.concatenate([distance - half, distance + half]), 0.0, settings.range_m)
    near, far = np.split(_beam_before(shot, light, np.tile(rays, (2, 1)), ends), 2)
    return _shows(shot, light, rays, np.full(len(rays), settings.range_m), near - far)


def _shows(shot: Shot, light: ShaftLight, rays: Floats, end_m: Floats, change: Floats) -> bool:
    """Return whether a change (n, 3) of light before the veil of rays (n, 3) of lengths (n,) changes a code enough."""
    veil = np.zeros((len(rays), 3)) if shot.medium is None else veil_ahead(shot.medium, end_m, rays)
    return bool(np.max(code_change(veil, light.settings.strength * change)) >= light.settings.least_codes)


def _beam_before(shot: Shot, light: ShaftLight, rays: Floats, end_m: Floats) -> Floats:
    """Return the beam's light scattered once (n, 3) on rays (n, 3) from the camera up to ends (n,) [m]."""
    sun = sun_of(shot)
    assert sun is not None
    depth_m = float(shot.view.depth_of(np.zeros(3)))
    end_m = np.minimum(end_m, np.where(rays[:, 1] > 0.0, depth_m / np.maximum(rays[:, 1], 1e-9), np.inf))
    ways = np.stack([rays @ unit(sun.direction), rays[:, 1], end_m]).astype(np.float64)
    beam = _unit_beam(light.medium, ways.tobytes(), depth_m, sun_up(sun))
    return np.asarray(np.asarray(sun.irradiance, np.float64) * beam)


@shared(keep=4)
def _unit_beam(medium: Medium, ways: bytes, depth_m: float, up: float) -> Floats:
    """Return `unoccluded` (n, 3) of a medium. ways: of float64 (3, n), cosine to the sun, height and end of the rays.

    Kept, as cameras and bodies mostly stand still while the strength of the sun changes.
    """
    cosine, height, end_m = np.frombuffer(ways).reshape(3, -1)
    return unoccluded(ShaftWater.of(medium), cosine, height, end_m, depth_m, up)
