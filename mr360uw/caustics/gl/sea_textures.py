# SPDX-License-Identifier: Apache-2.0
"""Textures that surface.frag reads: a table of waves, or fields that were summed on the processor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.sea.gerstner import Waves
from mr360uw.caustics.settings import Sea


def wave_table(waves: Waves, tile_m: float, time_s: float) -> NDArray[np.float32]:
    """Return the (2, n, 4) table that gerstner.glsl reads: cycles and tiles instead of radians and metres."""
    table = np.zeros((2, len(waves.amplitude_m), 4))
    table[0, :, :2] = waves.wave_vector * (tile_m / (2.0 * np.pi))
    table[0, :, 2] = np.remainder((waves.phase_rad - waves.angular_frequency * time_s) / (2.0 * np.pi), 1.0)
    table[0, :, 3] = waves.amplitude_m / tile_m
    direction = waves.wave_vector / np.linalg.norm(waves.wave_vector, axis=1, keepdims=True)
    table[1, :, :2] = (waves.steepness * waves.amplitude_m)[:, None] * direction / tile_m
    return table.astype(np.float32)


def field_image(sea: Sea, grid: int, time_s: float) -> NDArray[np.float32]:
    """Return the (2 grid, grid, 4) image of a sea's fields, lengths in tiles."""
    f = sea.grid_fields(grid, time_s)
    lengths = [f.height / sea.tile_m, f.shift_x / sea.tile_m, f.shift_z / sea.tile_m]
    first = np.stack([*lengths, f.slope_x], axis=-1)
    second = np.stack([f.slope_z, f.strain_xx, f.strain_zz, f.strain_xz], axis=-1)
    return np.concatenate([first, second]).astype(np.float32)
