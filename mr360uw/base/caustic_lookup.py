# SPDX-License-Identifier: Apache-2.0
"""Caustic lookup: reads a `CausticStack` along the refracted beam, periodic, filtered by footprint.

A point's ray of the beam is followed up to the mean surface, which gives its place in the map of every plane (Thompson
et al. 2019 eq. 2, with the division by the sun's y that it lacks). The two planes around the point are interpolated.
Twin: caustic_lookup.glsl.

Mip level: pixels t wide, read bilinearly, blur with variance t^2/12 + t^2/6 = t^2/4 (a box and a tent). A footprint w
wide averages with variance w^2/12. The two are equal at t = w/sqrt(3), which is the level read. At t = w the blur would
be that of a footprint 1.7 w wide, and 0.1 to 0.3 of the contrast would be lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.texels import between_four
from mr360uw.jit import exact, inlined
from mr360uw.types import CausticStack, Floats

_between_four = inlined(between_four)


def mip_levels(ratio: Floats) -> list[Floats]:
    """Return a stack (D, size, size, C) and its box-filtered halves down to one pixel; the mean is unchanged."""
    levels = [ratio]
    while levels[-1].shape[1] > 1:
        m = levels[-1]
        rows = m[:, 0::2] + m[:, 1::2]
        levels.append(0.25 * (rows[:, :, 0::2] + rows[:, :, 1::2]))
    return levels


def levels_of(stack: CausticStack | None) -> tuple[list[Floats], list[Floats]]:
    """Return the `mip_levels` of a stack's light that has not turned, and of the rest, none where it has none."""
    if stack is None:
        return [], []
    return mip_levels(stack.ratio), [] if stack.soft is None else mip_levels(stack.soft)


@exact
def _add_bilinear(image: Any, plane: Any, u: Any, v: Any, weight: Any, result: Any) -> None:
    """Add `weight` (n,) times values of an image (D, size, size, C), periodic and bilinear, to `result` (n, k)."""
    size, channels = image.shape[1], image.shape[3]
    for n in range(len(u)):
        if weight[n] > 0.0:
            x, y = u[n] * size - 0.5, v[n] * size - 0.5
            i, j = int(np.floor(x)), int(np.floor(y))
            fx, fy, p = x - i, y - j, plane[n]
            i0, i1, j0, j1 = i % size, (i + 1) % size, j % size, (j + 1) % size
            for c in range(result.shape[1]):
                k = c % channels
                result[n, c] += weight[n] * _between_four(
                    image[p, j0, i0, k], image[p, j0, i1, k], image[p, j1, i0, k], image[p, j1, i1, k], fx, fy
                )


def periodic_trilinear(
    levels: Sequence[Floats], plane: NDArray[np.int64], u: Floats, v: Floats, level: Floats
) -> Floats:
    """Return values (..., k) of mip levels (D, size, size, C) at tile coordinates (u, v) and fractional `level`; k is
    3, or C where that is more.

    All arguments (...,) have one shape; `plane` holds integers below D.
    """
    result = np.zeros((u.size, max(levels[0].shape[3], 3)))
    for k, image in enumerate(levels):
        weight = np.maximum(1.0 - np.abs(level - k), 0.0)
        if np.any(weight > 0.0):
            _add_bilinear(image, plane.ravel(), u.ravel(), v.ravel(), weight.ravel(), result)
    return result.reshape(*u.shape, result.shape[1])


def mip_level(footprint_m: ArrayLike, pixel_m: float, last: float) -> Floats:
    """Return the fractional level whose bilinear read averages over a footprint [m], in [0, last]."""
    wanted = np.asarray(footprint_m, np.float64) / (math.sqrt(3.0) * pixel_m)
    return np.clip(np.log2(np.maximum(wanted, 1.0)), 0.0, last)


def soft_caustic_lookup(
    stack: CausticStack,
    levels: Sequence[Floats],
    soft_levels: Sequence[Floats],
    x_m: ArrayLike,
    depth_m: ArrayLike,
    z_m: ArrayLike,
    footprint_m: ArrayLike,
    unturned: ArrayLike,
) -> Floats:
    """Return the irradiance ratio (..., 3) of a beam of which a fraction `unturned` (..., 3) has not turned.

    soft_levels: `mip_levels(stack.soft)`, of the rest. The other arguments are those of `caustic_lookup`.
    """
    sharp = caustic_lookup(stack, levels, x_m, depth_m, z_m, footprint_m)
    soft = caustic_lookup(stack, soft_levels, x_m, depth_m, z_m, footprint_m)
    return soft + (sharp - soft) * np.asarray(unturned, np.float64)


def along_beam(stack: CausticStack, x_m: Floats, depth_m: Floats, z_m: Floats) -> tuple[Floats, Floats]:
    """Return where the beam through points (...) crosses the mean surface, in tiles along x and z."""
    up = depth_m / stack.sun_direction[1]
    return (x_m + stack.sun_direction[0] * up) / stack.tile_m, (z_m + stack.sun_direction[2] * up) / stack.tile_m


_DARK = 0.02
"""Light over the mean that is added to denominators: what is darker shows no edge."""


def mean_slopes(sums: Floats) -> Floats:
    """Return the mean slope x, z of light and the radius of a disc as wide as its spread (..., 3), of sums (..., 4) of
    `CausticStack.slopes`.

        mean m = sum(w s) / sum(w)        spread v = sum(w |s|^2) / sum(w) - |m|^2

    A disc of radius r has the variance r^2/4 along each axis, so r = sqrt(2 v).
    """
    light, mean_x, mean_z, square = np.moveaxis(sums, -1, 0)
    inverse = 1.0 / (light + _DARK)
    mean_x, mean_z = mean_x * inverse, mean_z * inverse
    spread = square * inverse - mean_x * mean_x - mean_z * mean_z
    return np.stack([mean_x, mean_z, np.sqrt(2.0 * np.maximum(spread, 0.0))], axis=-1)


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
    u, v = along_beam(stack, x, d, z)
    above = periodic_trilinear(levels, lower, u, v, level)
    if len(planes) == 1:
        return above
    return above * (1.0 - fraction) + periodic_trilinear(levels, lower + 1, u, v, level) * fraction
