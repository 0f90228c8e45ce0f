# SPDX-License-Identifier: Apache-2.0
"""A stack of caustic maps in textures for caustic_lookup.glsl: planes in channels, mip levels below each other."""

from __future__ import annotations

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
    planes = layer_planes(count)
    colours = [levels[0].shape[3] for levels in stacks]
    shape = (len(planes) * sum(colours), 2 * size + 2 * len(stacks[0]), size + 2, planes.shape[1])
    atlas, first = (scratch if scratch is not None and scratch.shape == shape else np.zeros(shape, np.float32)), 0
    for levels, of_stack in zip(stacks, colours, strict=True):
        top = 0
        for level in levels:
            write_level(level, planes, atlas[first : first + len(planes) * of_stack], top)
            top += level.shape[1] + 2
        first += len(planes) * of_stack
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


def plane_steps(depth_m: Floats) -> NDArray[np.float32]:
    """Return (1, steps, 2) of each interval between planes: its depth, and one over its width (0 for one plane)."""
    width = np.diff(depth_m)
    steps = np.stack([depth_m[:-1], 1.0 / width], axis=-1) if len(width) else np.array([[depth_m[0], 0.0]])
    return steps[None].astype(np.float32)


@dataclass(frozen=True, slots=True, weakref_slot=True, eq=False)
class StackTextures:
    """A `CausticStack` on the device. ratio: its `mip_atlas`. plane_depth: its `plane_steps`."""

    ratio: moderngl.TextureArray
    plane_depth: moderngl.Texture


class AtlasScratch:
    """Memory for the atlases of stacks, and textures of stacks that nobody holds any more, to be written over: getting
    pages of either takes the processor ten times as long as writing them.
    """

    def __init__(self) -> None:
        self._atlas: NDArray[np.float32] | None = None
        self._lent: list[tuple[weakref.ref[StackTextures], moderngl.TextureArray]] = []

    def filled(self, *stacks: Sequence[Floats]) -> moderngl.TextureArray:
        """Return a texture of the `mip_atlas` of stacks."""
        self._atlas = mip_atlas(*stacks, scratch=self._atlas)
        free = [texture for holder, texture in self._lent if holder() is None]
        self._lent = [(holder, texture) for holder, texture in self._lent if holder() is not None]
        layers, height, width, channels = self._atlas.shape
        for texture in free:
            if (*texture.size, texture.components) == (width, height, layers, channels):
                texture.write(self._atlas, alignment=1)
                return texture
        return texture_array_from_array(self._atlas)

    def lend(self, textures: StackTextures) -> StackTextures:
        """Return textures whose atlas is written over when they are held no more."""
        self._lent.append((weakref.ref(textures), textures.ratio))
        return textures


def upload(stack: CausticStack, scratch: AtlasScratch | None = None) -> StackTextures:
    """Return a stack's textures, with its mip levels. scratch: None takes new memory."""
    ratio = np.asarray(stack.ratio, np.float32)
    grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
    stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
    if stack.soft is not None:
        stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
    scratch = AtlasScratch() if scratch is None else scratch
    texture = scratch.filled(*stacks)
    # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return scratch.lend(StackTextures(texture, texture_from_array(plane_steps(stack.depth_m))))
