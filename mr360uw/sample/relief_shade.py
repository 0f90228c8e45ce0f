# SPDX-License-Identifier: Apache-2.0
"""Light on the relief of a floor over that on level ground: tilt, cast shadows and the part of the sky that is seen.

The floor that rays meet is level; its relief acts by this factor on its albedo, so it shades but has no outline.

    factor = b lit max(n.s, 0)/s_y + (1 - b) mean_a cos^2 e_a

b: fraction of the floor's irradiance that is the sun's beam, s: direction to the sun in the water, n: normal, lit: 0 in
cast shadow, e_a: elevation of the horizon in the azimuth a, for uniform diffuse light on level ground.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import PI
from mr360uw.types import Floats

_STEPS_M = np.geomspace(0.012, 3.0, 14)
"""Distances [m] at which the horizon is looked for: from one pixel to the shadow of the highest rock at 20 degrees."""
_AZIMUTHS = 8
_PENUMBRA = 0.08
"""Width of a shadow's edge in tangents of elevation: the beam is spread by small angles of 5 degrees."""

Heights = NDArray[np.float32]


def relief_shade(height_m: Floats, tile_m: float, sun: Floats | None, beam: Floats) -> Floats:
    """Return the factor (size, size, 3) of light on a tile of heights (size, size) [m], column = +x, row = +z.

    sun: (3,) direction in the water, None without one. beam: (3,) fraction of the irradiance that is the sun's beam.
    """
    height = height_m.astype(np.float32)
    step = tile_m / len(height)
    open_sky = np.zeros_like(height)
    for k in range(_AZIMUTHS):
        angle = 2.0 * PI * (k + 0.5) / _AZIMUTHS
        open_sky += 1.0 / (1.0 + _horizon(height, (np.cos(angle), np.sin(angle)), step) ** 2) / _AZIMUTHS
    diffuse = open_sky[..., None]
    if sun is None:
        return np.repeat(diffuse, 3, axis=2).astype(np.float64)
    by_x, by_z = (0.5 * (np.roll(height, -1, a) - np.roll(height, 1, a)) / step for a in (1, 0))
    facing = (sun[1] - by_x * sun[0] - by_z * sun[2]) / np.sqrt(1.0 + by_x**2 + by_z**2) / sun[1]
    along = max(float(np.hypot(sun[0], sun[2])), 1e-9)
    horizon = _horizon(height, (float(sun[0]) / along, float(sun[2]) / along), step)
    lit = np.clip(0.5 + (float(sun[1]) / along - horizon) / _PENUMBRA, 0.0, 1.0)
    direct = (lit * np.maximum(facing, 0.0))[..., None]
    return np.asarray(beam * direct + (1.0 - beam) * diffuse, np.float64)


def _horizon(height: Heights, towards: tuple[float, float], step_m: float) -> Heights:
    """Return the tangent (size, size) of the horizon's elevation, 0 or more, in a direction over (x, z)."""
    highest = np.zeros_like(height)
    for distance in _STEPS_M:
        columns, rows = (round(distance * part / step_m) for part in towards)
        if columns or rows:
            away = np.float32(step_m * np.hypot(columns, rows))
            there = np.roll(height, (-rows, -columns), axis=(0, 1))
            np.maximum(highest, (there - height) / away, out=highest)
    return highest
