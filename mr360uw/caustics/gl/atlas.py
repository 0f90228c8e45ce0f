# SPDX-License-Identifier: Apache-2.0
"""Layout of a caustic stack in textures: planes in channels, mip levels below each other. Read by atlas_level.glsl."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_NEW_PLANES = 3
"""New planes per layer of the atlas, in channels 1 to 3; channel 0 repeats the last plane of the layer before.

Two neighbouring planes then always share a texel.
"""


def layer_planes(count: int) -> NDArray[np.int64]:
    """Return the planes (layers, 1, 2 or 4) in the channels of each layer of `count` planes; the last is repeated."""
    first = np.arange(0, max(count - 1, 1), _NEW_PLANES)
    channels = count if count < _NEW_PLANES else _NEW_PLANES + 1
    return np.minimum(first[:, None] + np.arange(channels), count - 1)


def mip_atlas(levels: Sequence[Floats]) -> NDArray[np.float32]:
    """Return levels (D, size, size, C) in the texture's layout, (layers C, 2 size + 2 levels, size + 2, 1, 2 or 4).

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
