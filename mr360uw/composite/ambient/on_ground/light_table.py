# SPDX-License-Identifier: Apache-2.0
"""Sums of an environment's light over elevation, from which ground_kernel.py takes what an interval holds."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.ibl.lookup import lookup_matrix
from mr360uw.types import Environment, Floats

_ROWS, _COLUMNS = 64, 48
"""Azimuths and elevations of the tables over which the ground's blocked light is integrated: pixels of the map."""
_COARSER = 2
"""Pixels across a cell of the sky on which weights are kept: sums are taken of pixels, so light is kept."""
_GLOW, _GLOW_POWER, _GLOW_SIDE = 2.0, 8, np.sqrt(0.5)
"""Glow of `glow_table` over the rest of its sky, power of the cosine to its middle (half as bright at 23 degrees), and
its middle at half height: about the glow around a sun in clear air."""


def light_table(environment: Environment) -> NDArray[np.float64]:
    """Return P of ground_kernel.py of the environment without its sun, and of a radiance of 1."""
    light, map_ = np.ones((_ROWS, _COLUMNS, 4)), environment.residual
    light[..., :3] = (_lookup(map_.shape) @ map_.reshape(-1, 3)).reshape(_ROWS, _COLUMNS, 3)
    return table_of(light)


def table_of(light: Floats) -> NDArray[np.float64]:
    """Return P (azimuths, elevations + 1, 3, k) of ground_kernel.py of radiances (azimuths, elevations, k)."""
    table = np.zeros((_ROWS, _COLUMNS + 1, 3, light.shape[-1]))
    table[:, 1:] = np.cumsum(_directions()[1][..., None] * light[:, :, None, :], axis=1)
    return table


def level_table(table: Floats, *, up: bool) -> Floats:
    """Return Q of sky_weights.py, (azimuths, elevations + 1, k), of a table P (..., 3, k).

    up: of the light from above the horizon; else from below, elevations downwards.
    """
    half = _COLUMNS // 2
    along = (table[:, half:, 1] if up else table[:, half::-1, 1])[:, ::_COARSER]
    along = along.reshape(-1, _COARSER, *along.shape[1:]).mean(axis=1)
    return np.asarray(along - along[:, :1])


@functools.cache
def glow_table() -> Floats:
    """Return Q (azimuths, elevations + 1, 5) of uniform light and of four skies that glow on one side.

    Each has an irradiance of pi on level ground. What bodies block of them bends where it does in other smooth light.
    """
    d, _ = _directions()
    light = np.ones((_ROWS, _COLUMNS, 5))
    for k, (x, z) in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))):
        towards = np.maximum(d @ [x * _GLOW_SIDE, _GLOW_SIDE, z * _GLOW_SIDE], 0.0)
        light[..., k + 1] += _GLOW * towards**_GLOW_POWER
    table = level_table(table_of(light), up=True)
    return np.asarray(table * len(table) / (2.0 * table[:, -1].sum(axis=0)))


@functools.cache
def _lookup(shape: tuple[int, ...]) -> Any:
    """Return the lookup of a table's cells in maps of a shape (H, W, 3)."""
    return lookup_matrix(shape, _directions()[0].reshape(-1, 3))


@functools.cache
def _directions() -> tuple[Floats, Floats]:
    """Return the middles (_ROWS, _COLUMNS, 3) of a table's cells, and the same times their solid angle over a row."""
    azimuth = (np.arange(_ROWS) + 0.5) * 2.0 * np.pi / _ROWS
    elevation = ((np.arange(_COLUMNS) + 0.5) / _COLUMNS - 0.5) * np.pi
    e, a = np.meshgrid(elevation, azimuth)
    d = np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1)
    return d, d * (np.cos(e) * np.pi / _COLUMNS)[..., None]
