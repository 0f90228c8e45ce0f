# SPDX-License-Identifier: Apache-2.0
"""Pixels in which the moving surface can show a body, found on a coarse grid of rays.

One ray a cell meets the surface, filtered to the size of the cell. A body is in reach where the mirrored or refracted
ray comes within a ball around a part of it, widened by `_DEVIATIONS` standard deviations of what the waves that the
filter took turn such rays by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.at_surface.settings import FAINTEST
from mr360uw.composite.at_surface.surface_rays import SeenSurface, cast
from mr360uw.composite.at_surface.water_sides import WaterSides
from mr360uw.composite.shot import PlacedObject
from mr360uw.constants import PI
from mr360uw.medium.lookup import transmittance_lookup
from mr360uw.optics import reflect, refract_clamped
from mr360uw.types import Floats, MediumTable

Mask = NDArray[np.bool_]

_CELLS = 128
"""Rows of the coarse grid."""
_DEVIATIONS = 2.7
"""Standard deviations of slopes along their steeper axis that are looked for: images are fainter than a code value
beyond."""
_LENGTHS_M = np.geomspace(0.01, 1e4, 400)
"""Lengths [m] among which the farthest path is looked up, 4 % apart."""
_MOST_PARTS = 8
"""Balls along the longest side of a body."""
_MIRRORED, _LEAST_BENT, _MOST_BENT = 2.0, 0.5, 3.0
"""Turn of a ray over that of the facet: of mirrored rays exactly, of refracted ones at the least and at the most, which
is reached 5 degrees from the edge of Snell's window."""


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
        radius = placed.mesh.radius_m if parts == 1 else 0.5 * np.hypot(across, extent[axis] / parts)
        radii.append(np.full(parts, placed.scale * radius))
    return np.concatenate(centres), np.concatenate(radii)


def find_reach(sides: WaterSides, objects: tuple[PlacedObject, ...]) -> Mask:
    """Return the pixels (2, H, W) that can show a body mirrored in the surface, and refracted through it."""
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
        found[:, at] = in_reach(sides, seen, *balls_around(objects), PI * step / view.height)
    return np.stack([_pixels(one.reshape(rows, columns), step)[: view.height, : view.width] for one in found])


def in_reach(sides: WaterSides, seen: SeenSurface, centres: Floats, radii: Floats, cell_rad: float) -> Mask:
    """Return whether (2, n) rays, each for a cell of an angle, are in reach of a ball (m,), mirrored and refracted."""
    view, m = sides.wet.view, sides.relative_index
    against = -seen.normal if sides.in_water else seen.normal
    point = seen.distance_m[:, None] * seen.direction
    xx, xz, zz = seen.lost.T
    variance = 0.5 * (xx + zz) + np.hypot(0.5 * (xx - zz), xz)  # along the steeper axis
    spread = _DEVIATIONS * np.sqrt(np.maximum(variance, 0.0))
    mirrored, bent = reflect(seen.direction, against), refract_clamped(seen.direction, against, 1.0 / m)
    to = centres - view.position - point[:, None]  # (n, m, 3)
    away = np.linalg.norm(to, axis=-1)
    # neighbouring rays part all the way from the camera: seen from the surface a cell is wider than from there
    cell = cell_rad * (1.0 + seen.distance_m[:, None] / np.maximum(away, 1e-9))
    size = np.arcsin(np.clip(radii / np.maximum(away, 1e-9), 0.0, 1.0)) + 2.0 * cell
    over, nearest = centres[:, 1] - view.surface_y_m, np.maximum(away - radii, 0.0)
    wet, dry = over - radii < sides.sea.highest_m, over + radii > sides.sea.lowest_m
    first = np.broadcast_to(seen.distance_m[:, None] if sides.in_water else 0.0, away.shape)
    farthest_m = _farthest_m(sides.wet.medium)
    bends, passes = _bending(seen.direction, against, m, spread)
    found = []
    for ray, wide, in_same in ((mirrored, _MIRRORED * spread, True), (bent, bends * spread, False)):
        body_is_wet = in_same == sides.in_water
        cosine = np.einsum("nk,nmk->nm", ray, to) / np.maximum(away, 1e-9)
        near = np.arccos(np.clip(cosine, -1.0, 1.0)) < size + wide[:, None]
        seen_there = (near | (away < radii)) & (wet if body_is_wet else dry)
        seen_there &= (first + nearest if body_is_wet else first) < farthest_m
        found.append(np.any(seen_there, axis=1) & (in_same | passes))
    return np.stack(found)


def _farthest_m(medium: MediumTable | None) -> float:
    """Return the length [m] of a level path in water that leaves `FAINTEST` of the light; infinity without water."""
    if medium is None:
        return np.inf
    left = transmittance_lookup(medium, _LENGTHS_M, 0.0).max(axis=-1)
    return float(_LENGTHS_M[np.argmin(left > FAINTEST)]) if left[-1] <= FAINTEST else np.inf


def _bending(travel: Floats, against: Floats, m: float, spread: Floats) -> tuple[Floats, Mask]:
    """Return the turn (n,) of refracted rays over that of facets, cos/(m cos') - 1, within `spread` (n,) [rad] of the
    mean facet, and whether any facet lets light pass.
    """
    angle = np.arccos(np.clip(-np.einsum("nk,nk->n", travel, against), 0.0, 1.0))
    steeper = np.minimum(angle + spread, 0.5 * PI)
    behind = np.sqrt(np.maximum(1.0 - (np.sin(steeper) / m) ** 2, 0.0))
    turn = np.abs(np.cos(steeper) / np.maximum(m * behind, 1e-6) - 1.0)
    turn = np.where(behind > 0.0, turn, _MOST_BENT)
    return np.clip(turn, _LEAST_BENT, _MOST_BENT), np.sin(np.maximum(angle - spread, 0.0)) < m


def _pixels(cells: Mask, step: int) -> Mask:
    """Return the pixels of marked cells and of those beside them."""
    wide = cells | np.roll(cells, 1, axis=1) | np.roll(cells, -1, axis=1)
    tall = wide.copy()
    tall[1:] |= wide[:-1]
    tall[:-1] |= wide[1:]
    return np.repeat(np.repeat(tall, step, axis=0), step, axis=1)
