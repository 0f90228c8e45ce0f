# SPDX-License-Identifier: Apache-2.0
"""Sun of a shot on the device: slots of the shadow atlas and uniforms of sun.glsl."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.composite.gl.shadow_atlas import LightFrame
from mr360uw.composite.lighting.sun import sun_of, sun_up, widest_half_angle
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.sphere import basis

MAXIMUM_SLOTS = 30
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
    axes = basis(np.round(_STEPS * np.asarray(sun.direction)))
    groups: list[tuple[PlacedObject, ...]] = [(placed,) for placed in casters[: MAXIMUM_SLOTS - 1]]
    if len(casters) >= MAXIMUM_SLOTS:
        groups.append(casters[MAXIMUM_SLOTS - 1 :])
    return [LightFrame(group, axes) for group in groups]


def sun_uniforms(shot: Shot) -> dict[str, Any]:
    """Return the uniforms of `Sun` in sun.glsl."""
    sun = sun_of(shot)
    if sun is None:
        return {"sun__direction": (0.0, 1.0, 0.0), "sun__casters": 0}
    axes = basis(np.round(_STEPS * np.asarray(sun.direction)))
    across, along = (axes @ sun.direction)[:2], float(axes[2] @ sun.direction)
    return {
        "sun__irradiance": sun.irradiance,
        "sun__direction": sun.direction,
        "sun__up": sun_up(sun),
        "sun__half_angle": sun.half_angle_rad,
        "sun__halo_angle": widest_half_angle(shot),
        "sun__axes": axes.T,
        "sun__slope": across / along,
        "sun__casters": min(len(shot.casters), MAXIMUM_SLOTS),
    }
