# SPDX-License-Identifier: Apache-2.0
"""Light of an environment integrated over elevation, at the nodes of a table:

    P(a, e) = int_{-pi/2}^e L(a, e') d(a, e') cos e' de'

with d the unit direction at azimuth a and elevation e, L the radiance. An interval of elevations from lo to hi, of an
azimuth da wide, holds an irradiance of n.(P(a, hi) - P(a, lo)) da on a place with the normal n.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from mr360uw.ibl.lookup import lookup_matrix
from mr360uw.types import Environment, Floats

ROWS, COLUMNS = 32, 24
"""Azimuths and steps of elevation of the table."""
NODES = ROWS * (COLUMNS + 1)
_FINER = 2
"""Cells along each side of one of the table over which light is summed: pixels of the map."""
_GLOW, _GLOW_POWER, _GLOW_SIDE = 2.0, 8, np.sqrt(0.5)
"""Glow of `glow_table` over the rest of its sky, power of the cosine to its middle (half as bright at 23 degrees), and
its middle at half height: about the glow around a sun in clear air."""


def sky_table(environment: Environment) -> Floats:
    """Return P (NODES, 3, 3), component and channel, of the environment without its sun."""
    map_ = environment.residual
    light = _lookup(map_.shape) @ map_.reshape(-1, 3)
    return _table_of(np.asarray(light).reshape(_FINER * ROWS, _FINER * COLUMNS, 3))


@functools.cache
def glow_table() -> Floats:
    """Return the upward component of P (NODES, 5) of uniform light and of four skies that glow on one side.

    Each has an irradiance of pi on level ground. What bodies block of them bends where it does in other smooth light.
    """
    d, _ = _directions()
    light = np.ones((*d.shape[:2], 5))
    for k, (x, z) in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))):
        towards = np.maximum(d @ [x * _GLOW_SIDE, _GLOW_SIDE, z * _GLOW_SIDE], 0.0)
        light[..., k + 1] += _GLOW * towards**_GLOW_POWER
    table = _table_of(light)[:, 1].reshape(ROWS, COLUMNS + 1, 5)
    whole = (table[:, -1] - table[:, COLUMNS // 2]).sum(axis=0) * (2.0 * np.pi / ROWS)
    return np.asarray(table * (np.pi / whole)).reshape(NODES, 5)


def _table_of(light: Floats) -> Floats:
    """Return P (NODES, 3, k) of radiances (_FINER ROWS, _FINER COLUMNS, k)."""
    cells = _directions()[1][..., None] * light[:, :, None, :]
    rows = cells.reshape(ROWS, _FINER, *cells.shape[1:]).mean(axis=1)
    table = np.zeros((ROWS, COLUMNS + 1, 3, light.shape[-1]))
    table[:, 1:] = np.cumsum(rows, axis=1)[:, _FINER - 1 :: _FINER]
    return table.reshape(NODES, 3, -1)


@functools.cache
def _lookup(shape: tuple[int, ...]) -> Any:
    """Return the lookup of the cells in maps of a shape (H, W, 3)."""
    return lookup_matrix(shape, _directions()[0].reshape(-1, 3))


@functools.cache
def _directions() -> tuple[Floats, Floats]:
    """Return the middles of the cells, and the same times their solid angle over a row."""
    rows, columns = _FINER * ROWS, _FINER * COLUMNS
    azimuth = (np.arange(rows) + 0.5) * 2.0 * np.pi / rows
    elevation = ((np.arange(columns) + 0.5) / columns - 0.5) * np.pi
    e, a = np.meshgrid(elevation, azimuth)
    d = np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1)
    return d, d * (np.cos(e) * np.pi / columns)[..., None]
