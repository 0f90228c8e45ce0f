# SPDX-License-Identifier: Apache-2.0
"""Medium table of a frame: for the camera's depth, its veil scaled to the plate's exposure."""

from __future__ import annotations

from mr360uw.medium.fit.level import fit_level
from mr360uw.render.plate_light import FrameLight
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import MediumTable


def exposed_water(surroundings: Surroundings, light: FrameLight, time_s: float) -> MediumTable | None:
    """Return the table of the water at a time, its veil matched to the plate; None without water."""
    medium = surroundings.medium_at(time_s)
    if medium is None:
        return None
    if light.gain is not None:
        return medium.scaled(light.gain).table
    if light.plate_map is not None:
        return medium.with_map(light.plate_map).table
    return medium.table if light.level is None else medium.scaled(fit_level(medium, light.level)[0]).table
