# SPDX-License-Identifier: Apache-2.0
"""Surface stage of a frame: the layer of a shot with its bodies in the moving surface, and whether a scene needs it."""

from __future__ import annotations

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite import Shot
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.at_surface.surface_layer import object_presence
from mr360uw.constants import JUST_BELOW_M
from mr360uw.medium import Medium
from mr360uw.render.backends import Backend
from mr360uw.render.loaded import Loaded
from mr360uw.types import Layer, MediumTable


def with_surface(
    loaded: Loaded, backend: Backend, shot: Shot, layer: Layer, variables: Aovs | None, time_s: float, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return the layer of a shot and its variables with the moving surface; as they are where the plan has none.

    Images of bodies in the surface are in the layer alone, the cut through bodies is in both. cache: holds layers of
    the same backend; a layer stands for all that its shot depends on.
    """
    settings = loaded.scene.surface
    if not loaded.plan.surface.runs or shot.medium is None or shot.view.depth_of(np.zeros(3)) <= 0.0:
        return layer, variables
    if not np.any(object_presence(shot, settings) > 0.0):
        return layer, variables
    sea, at_surface = loaded.scene.sea, _table_at_surface(loaded, shot.medium, time_s, cache)
    if at_surface is None:
        return layer, variables
    from mr360uw.composite.at_surface.surface_layer import with_bodies

    layer, before = cache.of(with_bodies, shot, sea, time_s, at_surface, settings, layer, backend.cache)
    return layer, variables if variables is None or before is None else variables.cut(before)


def _table_at_surface(loaded: Loaded, table: MediumTable, time_s: float, cache: Cache) -> MediumTable | None:
    """Return the table of a frame's water for rays that start at the surface; None without water."""
    medium, still = loaded.surroundings.medium_at(time_s), loaded.surroundings.medium
    if medium is None or still is None:
        return None
    from mr360uw.composite.at_surface.water_sides import table_at_surface

    return cache.of(table_at_surface, table, medium.unit_table, cache.of(_unit_table_below_surface, still))


def _unit_table_below_surface(medium: Medium) -> MediumTable:
    return medium.at_depth(JUST_BELOW_M).unit_table
