# SPDX-License-Identifier: Apache-2.0
"""How shading reads a `CausticStack`: along the refracted beam, periodic, filtered by footprint.

A point's ray of the beam is followed up to the mean surface, which gives its place in the map of every plane (the
formula of Thompson et al. 2019 eq. 2 with the division by the sun's y that it needs); the two planes around the point
are mixed. Twin: lookup.glsl.

A pixel of the level with pixels t wide, read bilinearly, is the pattern seen through a box and a tent, of variance
t^2/12 + t^2/6 = t^2/4. A footprint w wide averages with variance w^2/12. So t = w/sqrt(3): the level with t = w blurs
as a footprint of 1.7 w and takes 0.1 to 0.3 of the contrast.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.types import CausticStack, Floats

_NEW_PLANES = 3
"""Planes that a layer of the atlas adds; its first channel is the last plane of the layer before."""


def mip_levels(ratio: Floats) -> list[Floats]:
    """Return a stack (D, size, size, C) and its box-filtered halves down to one pixel; the mean stays."""
    levels = [ratio]
    while levels[-1].shape[1] > 1:
        m = levels[-1]
        rows = m[:, 0::2] + m[:, 1::2]
        levels.append(0.25 * (rows[:, :, 0::2] + rows[:, :, 1::2]))
    return levels


def layer_planes(count: int) -> NDArray[np.int64]:
    """Return the planes (layers, 1, 2 or 4) in the channels of each layer of `count` planes; the last is repeated."""
    first = np.arange(0, max(count - 1, 1), _NEW_PLANES)
    channels = count if count < _NEW_PLANES else _NEW_PLANES + 1
    return np.minimum(first[:, None] + np.arange(channels), count - 1)


def mip_atlas(levels: Sequence[Floats]) -> NDArray[np.float32]:
    """Return levels (D, size, size, C) as the twin reads them, (layers C, 2 size + 2 levels, size + 2, 1, 2 or 4).

    A pixel holds up to four planes, of one colour; colours follow each other as layers. The levels lie below each
    other, each with the pixels of its other side around it, so that one filtered fetch is right at its edges. They
    all lie in level 0 of the texture: drivers may take the level of a fetch from one pixel of each 2 x 2 block.
    """
    count, size, _, colours = levels[0].shape
    planes = layer_planes(count)
    shape = (len(planes), colours, 2 * size + 2 * len(levels), size + 2, planes.shape[1])
    atlas = np.zeros(shape, np.float32)
    top = 0
    for level in levels:
        side = level.shape[1]
        square = atlas[:, :, top : top + side + 2, : side + 2]
        for (layer, channel), plane in np.ndenumerate(planes):
            square[layer, :, 1:-1, 1:-1, channel] = np.moveaxis(level[plane], -1, 0)
        square[:, :, 0], square[:, :, -1] = square[:, :, side], square[:, :, 1]
        square[:, :, :, 0], square[:, :, :, -1] = square[:, :, :, side], square[:, :, :, 1]
        top += side + 2
    return atlas.reshape(-1, *shape[2:])


def plane_steps(depth_m: Floats) -> NDArray[np.float32]:
    """Return (1, steps, 2) of each interval between planes: its depth, and one over its width (0 for one plane)."""
    width = np.diff(depth_m)
    steps = np.stack([depth_m[:-1], 1.0 / width], axis=-1) if len(width) else np.array([[depth_m[0], 0.0]])
    return steps[None].astype(np.float32)


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


def mip_level(footprint_m: ArrayLike, pixel_m: float, last: float) -> Floats:
    """Return the fractional level whose bilinear read averages over a footprint [m], in [0, last]."""
    wanted = np.asarray(footprint_m, np.float64) / (math.sqrt(3.0) * pixel_m)
    return np.clip(np.log2(np.maximum(wanted, 1.0)), 0.0, last)


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
    level = mip_level(footprint, stack.tile_m / stack.ratio.shape[1], len(levels) - 1.0)
    up = d / stack.sun_direction[1]
    u, v = (x + stack.sun_direction[0] * up) / stack.tile_m, (z + stack.sun_direction[2] * up) / stack.tile_m
    above = periodic_trilinear(levels, lower, u, v, level)
    if len(planes) == 1:
        return above
    return above * (1.0 - fraction) + periodic_trilinear(levels, lower + 1, u, v, level) * fraction
