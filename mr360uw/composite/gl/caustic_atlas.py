# SPDX-License-Identifier: Apache-2.0
"""A stack of caustic maps in textures for caustic_lookup.glsl: planes in channels, mip levels below each other."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import mip_levels
from mr360uw.gl.context import texture_array_from_array, texture_from_array
from mr360uw.jit import exact
from mr360uw.types import CausticStack, Floats

_NEW_PLANES = 3
"""New planes per layer of the atlas, in channels 1 to 3; channel 0 repeats the last plane of the layer before.

Two neighbouring planes then always share a texel.
"""


@functools.cache
def layer_planes(count: int) -> NDArray[np.int64]:
    """Return the planes (layers, 1, 2 or 4) in the channels of each layer of `count` planes; the last is repeated."""
    first = np.arange(0, max(count - 1, 1), _NEW_PLANES)
    channels = count if count < _NEW_PLANES else _NEW_PLANES + 1
    return np.minimum(first[:, None] + np.arange(channels), count - 1)


def mip_atlas(*stacks: Sequence[Floats], scratch: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
    """Return the levels (D, size, size, C) of stacks in the texture's layout, (layers C, 2 size + 2 levels, size + 2,
    1, 2 or 4).

    A pixel holds up to four planes, of one colour; colours follow each other as layers, and stacks after each other.
    The levels lie below each other, each with the pixels of its other side around it, so that one filtered fetch is
    right at its edges. They all lie in level 0 of the texture: drivers may take the level of a fetch from one pixel of
    each 2 x 2 block. scratch: an earlier atlas, written over if its shape fits: pages of new memory take longer to get
    than to fill.
    """
    count, size = stacks[0][0].shape[:2]
    planes, colours = layer_planes(count), 0
    for levels in stacks:
        colours += levels[0].shape[3]
    shape = (len(planes) * colours, 2 * size + 2 * len(stacks[0]), size + 2, planes.shape[1])
    atlas, first = (scratch if scratch is not None and scratch.shape == shape else np.zeros(shape, np.float32)), 0
    for levels in stacks:
        top, layers = 0, len(planes) * levels[0].shape[3]
        for level in levels:
            write_level(level, planes, atlas[first : first + layers], top)
            top += level.shape[1] + 2
        first += layers
    return atlas


@exact
def write_level(level: Floats, planes: NDArray[np.int64], atlas: NDArray[np.float32], top: int) -> None:
    """Write a level (D, side, side, C) with its border of one pixel into layers of an atlas, from row `top` on."""
    side, colours = level.shape[1], level.shape[3]
    for layer in range(planes.shape[0]):
        for colour in range(colours):
            for row in range(side + 2):
                j = side - 1 if row == 0 else row - 1 if row <= side else 0
                out = atlas[layer * colours + colour, top + row]
                for k in range(planes.shape[1]):
                    line = level[planes[layer, k], j]
                    for i in range(side):
                        out[i + 1, k] = line[i, colour]
                    out[0, k], out[side + 1, k] = out[side, k], out[1, k]


@dataclass(frozen=True, slots=True, weakref_slot=True, eq=False)
class StackTextures:
    """A `CausticStack` on the device. ratio: its `mip_atlas`. plane_depth: (1, steps, 2) of each interval between its
    planes: its depth, and one over its width (0 for one plane).
    """

    ratio: moderngl.TextureArray
    plane_depth: moderngl.Texture


class AtlasScratch:
    """Memory for the atlases of stacks, and textures of stacks that nobody holds any more, to be written over: getting
    pages of either takes the processor ten times as long as writing them.
    """

    def __init__(self) -> None:
        self.atlas: NDArray[np.float32] | None = None
        self.lent: list[tuple[weakref.ref[StackTextures], moderngl.TextureArray]] = []


def upload(stack: CausticStack, scratch: AtlasScratch | None = None) -> StackTextures:
    """Return a stack's textures, with its mip levels. scratch: None takes new memory."""
    # One colour for all three where they are the same, and the light that has turned
    ratio = np.asarray(stack.ratio, np.float32)
    grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
    stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
    if stack.soft is not None:
        stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
    scratch = AtlasScratch() if scratch is None else scratch
    scratch.atlas = mip_atlas(*stacks, scratch=scratch.atlas)
    # Into a texture of the same size that nobody holds any more, or a new one
    layers, height, width, channels = scratch.atlas.shape
    lent, texture = scratch.lent, None
    scratch.lent = []
    for holder, free in lent:
        if holder() is not None:
            scratch.lent.append((holder, free))
        elif texture is None and (*free.size, free.components) == (width, height, layers, channels):
            texture = free
    if texture is None:
        texture = texture_array_from_array(scratch.atlas)
    else:
        texture.write(scratch.atlas, alignment=1)
    # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    depth = np.asarray(stack.depth_m, np.float64)
    inverse = 1.0 / np.diff(depth) if len(depth) > 1 else np.zeros(1)
    steps = np.stack([depth[: len(inverse)], inverse], axis=-1)[None].astype(np.float32)
    textures = StackTextures(texture, texture_from_array(steps))
    scratch.lent.append((weakref.ref(textures), texture))
    return textures
