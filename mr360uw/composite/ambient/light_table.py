# SPDX-License-Identifier: Apache-2.0
"""Sums of an environment's light over elevation, from which ground_kernel.py takes what an interval holds."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from mr360uw.ibl.lookup import environment_lookup
from mr360uw.types import Environment, Floats

_ROWS, _COLUMNS = 64, 48
"""Azimuths and elevations of the tables over which the ground's blocked light is integrated: pixels of the map."""


def light_table(environment: Environment) -> NDArray[np.float64]:
    """Return P of ground_kernel.py of the environment without its sun, and of a radiance of 1."""
    d, weighted = _directions()
    light = np.ones((_ROWS, _COLUMNS, 4))
    light[..., :3] = environment_lookup(environment.residual, d)
    table = np.zeros((_ROWS, _COLUMNS + 1, 3, 4))
    table[:, 1:] = np.cumsum(weighted[..., None] * light[:, :, None, :], axis=1)
    return table


@functools.cache
def _directions() -> tuple[Floats, Floats]:
    """Return the middles (_ROWS, _COLUMNS, 3) of a table's cells, and the same times their solid angle over a row."""
    azimuth = (np.arange(_ROWS) + 0.5) * 2.0 * np.pi / _ROWS
    elevation = ((np.arange(_COLUMNS) + 0.5) / _COLUMNS - 0.5) * np.pi
    e, a = np.meshgrid(elevation, azimuth)
    d = np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1)
    return d, d * (np.cos(e) * np.pi / _COLUMNS)[..., None]
