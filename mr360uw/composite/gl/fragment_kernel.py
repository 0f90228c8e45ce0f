# SPDX-License-Identifier: Apache-2.0
"""Shaded fragments from the device's targets, and their sum over pixels into a tile, each in one compiled pass."""

from __future__ import annotations

from typing import Any

from mr360uw.composite.gl.blocks import BLOCK
from mr360uw.jit import exact


@exact
def take_lanes(image: Any, chosen: Any, first: int, values: Any) -> None:
    """Write the texels (h, w, c) of a target into the rows `chosen` (m,) of values (n, first + c...).

    Texel k in the order of numbers (`blocks.in_lane_order`) goes to row chosen[k], from column `first` on.
    """
    blocks_across = image.shape[1] // BLOCK
    for k in range(len(chosen)):
        block, within = k // (BLOCK * BLOCK), k % (BLOCK * BLOCK)
        row = BLOCK * (block // blocks_across) + within // BLOCK
        column = BLOCK * (block % blocks_across) + within % BLOCK
        for c in range(image.shape[2]):
            values[chosen[k], first + c] = image[row, column, c]


@exact
def sum_behind(
    row: Any, column: Any, first: Any, weight: Any, values: Any, tile_row: int, tile_column: int,
    radiance: Any, alpha: Any, distance: Any,
) -> None:  # fmt: skip
    """Composite the fragments (n,) of pixels (p,) behind a tile, row, column, first and weight as in `Fragments`.

    values: (n, 5) radiance, alpha and distance [m]. A pixel takes the sum of weight alpha times the radiance, and the
    least distance.
    """
    for p in range(len(row)):
        r, c = row[p] - tile_row, column[p] - tile_column
        if r < 0 or c < 0 or r >= alpha.shape[0] or c >= alpha.shape[1]:
            continue
        red, green, blue, cover, nearest = 0.0, 0.0, 0.0, 0.0, distance[r, c]
        for n in range(first[p], first[p + 1] if p + 1 < len(first) else len(weight)):
            share = weight[n] * values[n, 3]
            red += share * values[n, 0]
            green += share * values[n, 1]
            blue += share * values[n, 2]
            cover += share
            nearest = min(nearest, values[n, 4])
        free = 1.0 - alpha[r, c]
        radiance[r, c, 0] += free * red
        radiance[r, c, 1] += free * green
        radiance[r, c, 2] += free * blue
        alpha[r, c] += free * cover
        distance[r, c] = nearest
