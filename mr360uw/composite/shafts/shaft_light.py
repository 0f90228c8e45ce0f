# SPDX-License-Identifier: Apache-2.0
"""What the shafts of a shot depend on beside the shot itself, and their scenes before and behind its objects.

The plate has the shafts of its own waves already: over it only what bodies take away and lamps add is drawn, unless
`on_plate` asks for all.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Parts
from mr360uw.composite.lighting.blockers import casting_bodies
from mr360uw.composite.lighting.sun import spread_rad, sun_of
from mr360uw.composite.shot import Shot
from mr360uw.medium.medium import Medium
from mr360uw.medium.shafts.froxels import FroxelGrid, shaft_field
from mr360uw.medium.shafts.settings import LEAST_NODES, ShaftSettings
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.types import CausticStack, Lamp

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
        still = dataclasses.replace(before.pattern, caustics=None)
        return before, dataclasses.replace(before, pattern=None if still.even else still)


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
