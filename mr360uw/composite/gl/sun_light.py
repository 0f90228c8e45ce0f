# SPDX-License-Identifier: Apache-2.0
"""Sun of a shot on the device: slots of the shadow atlas and uniforms of sun.glsl."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.composite.gl.caster_grid import CELLS, HALF_BITS, make_caster_grid
from mr360uw.composite.gl.shadow_atlas import Atlas, LightFrame
from mr360uw.composite.lighting.sun import sun_of, sun_up, widest_half_angle
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.sphere import basis
from mr360uw.types import Floats, Sun

MAXIMUM_SLOTS = 2 * HALF_BITS
"""Most slots of the sun; the last holds all further bodies. The shader keeps slots as the bits of an integer."""
_STEPS = 64.0
"""Slots are drawn along the sun's direction rounded to 1/64 in each component, within 0.8 degrees of it, so that those
of bodies at rest stay valid while the sun's track moves a little. Twice as large: redrawn twice as often."""


def sun_defines(shot: Shot) -> frozenset[str]:
    """Return the shader switches of a shot's sun."""
    sun = sun_of(shot)
    if sun is None:
        return frozenset()
    has = {
        "SUN": True, "SHADOW": len(shot.casters) > 0, "CAUSTICS": shot.caustics is not None,
        "SOFT": shot.caustics is not None and shot.caustics.softened,
        "HALO": widest_half_angle(shot) > sun.half_angle_rad,
    }  # fmt: skip
    return frozenset(name for name, there in has.items() if there)


def sun_frames(shot: Shot) -> list[LightFrame]:
    """Return the light frames of the sun, one for each body."""
    sun, casters = sun_of(shot), shot.casters
    if sun is None or not casters:
        return []
    axes, _ = _axes_and_slope(sun)
    groups: list[tuple[PlacedObject, ...]] = [(placed,) for placed in casters[: MAXIMUM_SLOTS - 1]]
    if len(casters) >= MAXIMUM_SLOTS:
        groups.append(casters[MAXIMUM_SLOTS - 1 :])
    return [LightFrame(group, axes) for group in groups]


def sun_uniforms(shot: Shot) -> dict[str, Any]:
    """Return the uniforms of `Sun` in sun.glsl."""
    sun = sun_of(shot)
    if sun is None:
        return {"sun__direction": (0.0, 1.0, 0.0), "sun__casters": 0}
    axes, slope = _axes_and_slope(sun)
    return {
        "sun__irradiance": sun.irradiance,
        "sun__direction": sun.direction,
        "sun__up": sun_up(sun),
        "sun__half_angle": sun.half_angle_rad,
        "sun__halo_angle": widest_half_angle(shot),
        "sun__axes": axes.T,
        "sun__slope": slope,
        "sun__casters": min(len(shot.casters), MAXIMUM_SLOTS),
    }


def sun_grid(shot: Shot, atlas: Atlas, first_row: int) -> tuple[dict[str, Any], Floats]:
    """Return the uniforms of the grid of bodies that may occlude the sun, and its rows (n, texels, 4) of `casters`.

    first_row: of those rows.
    """
    sun = sun_of(shot)
    if sun is None or not shot.casters:
        return {}, np.zeros((0, *atlas.table.shape[1:]))
    slots = atlas.table[: min(len(shot.casters), MAXIMUM_SLOTS)]
    _, slope = _axes_and_slope(sun)
    spread = float(np.tan(widest_half_angle(shot)) + np.linalg.norm(slope))
    grid = make_caster_grid(np.append(slots[:, 0], slots[:, 1, :2], axis=1), spread)
    rows = np.zeros((len(grid.table), *atlas.table.shape[1:]))
    rows[:, : grid.table.shape[1]] = grid.table
    uniforms = {
        "sun__grid_low": grid.low,
        "sun__grid_scale": grid.scale,
        "sun__grid_last": tuple(float(count - 1) for count in CELLS),
        "sun__grid_steps": (1.0, float(CELLS[0]), float(CELLS[0] * CELLS[1])),
        "sun__grid_radius": grid.radius_m,
        "sun__grid_row": first_row,
    }
    return uniforms, rows


def _axes_and_slope(sun: Sun) -> tuple[Floats, Floats]:
    """Return the axes (3, 3) of the sun's slots, and the slope (2,) of its direction in them, across over along."""
    axes = basis(np.round(_STEPS * np.asarray(sun.direction)))
    across, along = (axes @ sun.direction)[:2], float(axes[2] @ sun.direction)
    return axes, across / along
