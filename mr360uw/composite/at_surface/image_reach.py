# SPDX-License-Identifier: Apache-2.0
"""Pixels in which the moving surface can show a body, found on a coarse grid of rays.

One ray a cell meets the surface, filtered to the size of the cell. A body is in reach where the mirrored or refracted
ray comes within a ball around a part of it, widened by `_DEVIATIONS` standard deviations of what the waves that the
filter took turn such rays by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.at_surface.settings import FAINTEST
from mr360uw.composite.at_surface.surface_rays import SeenSurface, cast
from mr360uw.composite.at_surface.water_sides import WaterSides
from mr360uw.composite.shot import PlacedObject
from mr360uw.constants import PI
from mr360uw.medium.lookup import transmittance_lookup
from mr360uw.optics import reflect, refract_clamped
from mr360uw.types import Floats

Mask = NDArray[np.bool_]

_CELLS = 128
"""Rows of the coarse grid."""
_DEVIATIONS = 3.0
"""Standard deviations of slopes that are looked for: 1 in 90 facets is steeper."""
_MOST_PARTS = 8
"""Balls along the longest side of a body."""
_MIRRORED, _BENT_BELOW, _BENT_ABOVE = 2.0, 3.0, 0.5
"""Turn of a ray over that of the facet: of mirrored rays exactly; of refracted ones at the most up to 5 degrees from
the edge of Snell's window, and at grazing incidence from above."""


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Pixels (H, W) that can show a body mirrored in the surface, and refracted through it."""

    mirrored: Mask
    refracted: Mask


def balls_around(objects: tuple[PlacedObject, ...]) -> tuple[Floats, Floats]:
    """Return centres (m, 3) in the world and radii (m,) [m] of balls that hold the bodies."""
    centres: list[Floats] = [np.zeros((0, 3))]
    radii: list[Floats] = [np.zeros(0)]
    for placed in objects:
        extent, axis = placed.mesh.extent_m, int(np.argmax(placed.mesh.extent_m))
        across = np.linalg.norm(np.delete(extent, axis))
        parts = int(np.clip(np.ceil(extent[axis] / max(float(across), 1e-9)), 1, _MOST_PARTS))
        middle = np.tile(placed.mesh.center_m, (parts, 1))
        middle[:, axis] += extent[axis] * ((np.arange(parts) + 0.5) / parts - 0.5)
        centres.append(placed.to_world(middle))
        radii.append(np.full(parts, 0.5 * placed.scale * np.hypot(across, extent[axis] / parts)))
    return np.concatenate(centres), np.concatenate(radii)


def find_reach(sides: WaterSides, objects: tuple[PlacedObject, ...]) -> Reach:
    """Return where the surface can show bodies."""
    view = sides.wet.view
    step = max(view.height // _CELLS, 1)
    rows, columns = -(-view.height // step), -(-view.width // step)
    y, x = (k.ravel() for k in np.mgrid[0:rows, 0:columns] * step + 0.5 * step)
    sign = 1.0 if sides.in_water else -1.0
    towards = sign * view.directions(x, y)[:, 1] > -PI * step / view.height
    at = np.flatnonzero(towards)
    seen = cast(sides, x[at], y[at], float(step))
    met = np.isfinite(seen.distance_m)
    at, seen = at[met], seen.of(met)
    found = np.zeros((2, rows * columns), bool)
    if len(at):
        found[:, at] = _in_reach(sides, seen, *balls_around(objects), PI * step / view.height)
    return Reach(*(_pixels(one.reshape(rows, columns), step)[: view.height, : view.width] for one in found))


def _in_reach(sides: WaterSides, seen: SeenSurface, centres: Floats, radii: Floats, cell_rad: float) -> Mask:
    """Return whether (2, n) rays are in reach of a ball, mirrored and refracted."""
    view, m = sides.wet.view, sides.relative_index
    against = -seen.normal if sides.in_water else seen.normal
    point = seen.distance_m[:, None] * seen.direction
    spread = _DEVIATIONS * np.sqrt(np.maximum(seen.lost[:, 0] + seen.lost[:, 2], 0.0))
    mirrored, bent = reflect(seen.direction, against), refract_clamped(seen.direction, against, 1.0 / m)
    to = centres - view.position - point[:, None]  # (n, m, 3)
    away = np.linalg.norm(to, axis=-1)
    size = np.arcsin(np.clip(radii / np.maximum(away, 1e-9), 0.0, 1.0)) + 2.0 * cell_rad
    over, nearest = centres[:, 1] - view.surface_y_m, np.maximum(away - radii, 0.0)
    wet, dry = over - radii < sides.sea.highest_m, over + radii > sides.sea.lowest_m
    first = np.broadcast_to(seen.distance_m[:, None] if sides.in_water else 0.0, away.shape)
    bends = _BENT_BELOW if sides.in_water else _BENT_ABOVE
    found = []
    for ray, turn, in_same in ((mirrored, _MIRRORED, True), (bent, bends, False)):
        body_is_wet = in_same == sides.in_water
        cosine = np.einsum("nk,nmk->nm", ray, to) / np.maximum(away, 1e-9)
        near = np.arccos(np.clip(cosine, -1.0, 1.0)) < size + turn * spread[:, None]
        seen_there = (near | (away < radii)) & (wet if body_is_wet else dry)
        if sides.wet.medium is not None:
            path = first + nearest if body_is_wet else first
            seen_there &= transmittance_lookup(sides.wet.medium, path, 0.0).max(axis=-1) > FAINTEST
        found.append(np.any(seen_there, axis=1))
    return np.stack(found)


def _pixels(cells: Mask, step: int) -> Mask:
    """Return the pixels of marked cells and of those beside them."""
    wide = cells | np.roll(cells, 1, axis=1) | np.roll(cells, -1, axis=1)
    tall = wide.copy()
    tall[1:] |= wide[:-1]
    tall[:-1] |= wide[1:]
    return np.repeat(np.repeat(tall, step, axis=0), step, axis=1)
