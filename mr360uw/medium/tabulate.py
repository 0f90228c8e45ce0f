# SPDX-License-Identifier: Apache-2.0
"""A medium baked into the tables that a pixel reads: its cost does not depend on the number of wavelengths."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.lookup import table_coordinate
from mr360uw.types import MediumTable

if TYPE_CHECKING:
    from mr360uw.medium.medium import Medium

Array = NDArray[np.float64]

VEIL_SIZE = (129, 40)
ATTENUATION_SIZE = (64, 96)
DEPTH_SIZE = 256
"""Nodes over (up, distance), (depth, distance) and depth; chosen by the error against direct sums over wavelength."""

_FARTHEST = 1e4
"""The last node stands for infinity; it is evaluated at this many table lengths."""
_STEP = 1e-4
"""Relative step of one-sided derivatives."""


def lengths(count: int, length_m: float) -> Array:
    """Return the distances (count,) whose table coordinates are uniform; the last is large, not infinite."""
    t = np.arange(count) / (count - 1)
    return length_m * np.append(t[:-1] / (1.0 - t[:-1]), _FARTHEST)


def medium_table(medium: Medium, length_m: float) -> MediumTable:
    """Return the tables of a medium, its veil without factor; colours in them are within the gamut."""
    return MediumTable(
        camera_depth_m=medium.camera_depth_m,
        length_m=length_m,
        veil=_veil(medium, length_m).astype(np.float32),
        attenuation=_attenuation(medium, length_m).astype(np.float32),
        diffuse=_diffuse(medium, length_m).astype(np.float32),
        beam=_along_beam(medium, medium.model.extinction, length_m).astype(np.float32),
        unscattered=_along_beam(medium, medium.model.attenuation, length_m).astype(np.float32),
    )


def _veil(medium: Medium, length_m: float) -> Array:
    up = np.linspace(-1.0, 1.0, VEIL_SIZE[0])[:, None]
    s = np.broadcast_to(lengths(VEIL_SIZE[1], length_m), VEIL_SIZE)
    out = medium.camera_depth_m / np.maximum(up, 1e-9)
    inside = np.clip(s, _STEP * length_m, np.where(up > 0.0, out, np.inf))

    def smooth(s: Array) -> Array:
        return medium.unit_veil(s, np.broadcast_to(up, s.shape)) / -np.expm1(-s / length_m)[..., None]

    # no ray asks beyond the surface, but the cells it cuts do: carry on in a straight line over two of them
    t, t_out = table_coordinate(s, length_m), table_coordinate(out, length_m)
    before = (1.0 - _STEP) * np.minimum(out, s[:, -1:])
    at_surface = smooth(np.concatenate([before, before / (1.0 - _STEP)], axis=1))
    slope = (at_surface[:, 1] - at_surface[:, 0])[:, None] / (t_out - table_coordinate(before, length_m))[..., None]
    beyond = np.where(up > 0.0, np.clip(t - t_out, 0.0, 2.0 / (VEIL_SIZE[1] - 1)), 0.0)
    return smooth(inside) + beyond[..., None] * np.where((beyond > 0.0)[..., None], slope, 0.0)


def _attenuation(medium: Medium, length_m: float) -> Array:
    depth = np.minimum(lengths(ATTENUATION_SIZE[0], length_m), medium.deepest_m)[:, None]
    s = np.maximum(lengths(ATTENUATION_SIZE[1], length_m), _STEP * length_m)[None, :]
    return -medium.transmittance_log(s, depth) / s[..., None]


def _diffuse(medium: Medium, length_m: float) -> Array:
    camera = medium.camera_depth_m
    step = _STEP * (length_m + camera)
    depth = np.minimum(lengths(DEPTH_SIZE, length_m), medium.deepest_m)
    depth = np.where(np.abs(depth - camera) > step, depth, camera + step)
    return -(medium.ambient_log(depth) - medium.ambient_log(np.array(camera))) / (depth - camera)[:, None]


def _along_beam(medium: Medium, extinction: Array, length_m: float) -> Array:
    path = np.maximum(lengths(DEPTH_SIZE, length_m), _STEP * length_m)
    return -medium.beam_log(path, extinction) / path[:, None]
