# SPDX-License-Identifier: Apache-2.0
"""How shading reads a `CausticStack`: along the refracted beam, periodic, filtered by footprint.

A point between two planes lies on one ray of the beam; the ray is followed to both planes and the two ratios are mixed
(formula of Thompson et al. 2019 eq. 2 with the division by the sun's y that it needs). Twin: lookup.glsl.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.types import CausticStack, Floats


def mip_levels(ratio: Floats) -> list[NDArray[np.float64]]:
    """Return a stack (D, size, size, 3) and its box-filtered halves down to one pixel; the mean stays."""
    levels = [np.asarray(ratio, np.float64)]
    while levels[-1].shape[1] > 1:
        m = levels[-1]
        levels.append(0.25 * (m[:, 0::2, 0::2] + m[:, 1::2, 0::2] + m[:, 0::2, 1::2] + m[:, 1::2, 1::2]))
    return levels


def mip_atlas(levels: Sequence[Floats]) -> NDArray[np.float32]:
    """Return the levels below each other in one image a plane, (D, 2 size, size, 3): level k starts at its own row.

    Software drivers take the level of a fetch from one pixel for its whole 2 x 2 block, so the twin keeps all levels in
    level 0 of a texture.
    """
    planes, size = levels[0].shape[:2]
    atlas = np.zeros((planes, 2 * size, size, 3), np.float32)
    row = 0
    for level in levels:
        side = level.shape[1]
        atlas[:, row : row + side, :side] = level
        row += side
    return atlas


def _periodic_bilinear(level: Floats, plane: NDArray[np.int64], u: Floats, v: Floats) -> Floats:
    size = level.shape[1]
    x, y = u * size - 0.5, v * size - 0.5
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - i)[..., None], (y - j)[..., None]
    i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
    return (level[plane, j0, i0] * (1 - fx) + level[plane, j0, i1] * fx) * (1 - fy) + (
        level[plane, j1, i0] * (1 - fx) + level[plane, j1, i1] * fx
    ) * fy


def periodic_trilinear(
    levels: Sequence[Floats], plane: NDArray[np.int64], u: Floats, v: Floats, level: Floats
) -> Floats:
    """Return values (..., 3) of mip levels (D, size, size, 3) at tile coordinates (u, v) and fractional `level`.

    All arguments (...,) have one shape; `plane` holds integers below D.
    """
    result = np.zeros((*u.shape, 3))
    for k, image in enumerate(levels):
        weight = np.maximum(1.0 - np.abs(level - k), 0.0)
        here = weight > 0.0
        if np.any(here):
            result[here] += weight[here][:, None] * _periodic_bilinear(image, plane[here], u[here], v[here])
    return result


def caustic_lookup(
    stack: CausticStack,
    levels: Sequence[Floats],
    x_m: ArrayLike,
    depth_m: ArrayLike,
    z_m: ArrayLike,
    footprint_m: ArrayLike,
) -> Floats:
    """Return the irradiance ratio (..., 3) at world (x, z) and a depth below the mean surface.

    levels: `mip_levels(stack.ratio)`. footprint_m: width [m] to average the ratio over; it picks the level.
    Depths outside the stack take its first or last plane, followed along the beam.
    """
    x, d, z, footprint = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (x_m, depth_m, z_m, footprint_m)))
    planes = stack.depth_m
    position = np.interp(d, planes, np.arange(len(planes)))
    lower = np.minimum(position.astype(np.int64), max(len(planes) - 2, 0))
    fraction = (position - lower)[..., None]
    texel = stack.tile_m / stack.ratio.shape[1]
    level = np.clip(np.log2(np.maximum(footprint / texel, 1.0)), 0.0, len(levels) - 1.0)

    def at_plane(plane: np.ndarray) -> np.ndarray:
        along = (d - planes[plane]) / stack.sun_direction[1]
        u = (x + stack.sun_direction[0] * along) / stack.tile_m
        v = (z + stack.sun_direction[2] * along) / stack.tile_m
        return periodic_trilinear(levels, plane, u, v, level)

    upper_plane = np.minimum(lower + 1, len(planes) - 1)
    return at_plane(lower) * (1.0 - fraction) + at_plane(upper_plane) * fraction
