# SPDX-License-Identifier: Apache-2.0
"""A stack of caustic maps in textures, as caustic_lookup.glsl reads it."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import mip_levels
from mr360uw.caustics.gl.atlas import mip_atlas, plane_steps
from mr360uw.gl.context import texture_array_from_array, texture_from_array
from mr360uw.types import CausticStack, Floats


class AtlasRoom:
    """Memory of one context for the atlases of stacks: an array, and the textures of stacks that are no longer used.

    Getting pages of memory takes the processor ten times as long as writing them.
    """

    def __init__(self) -> None:
        self._free: list[moderngl.TextureArray] = []
        self._atlas: NDArray[np.float32] | None = None

    def filled(self, *stacks: Sequence[Floats]) -> moderngl.TextureArray:
        """Return a texture of the `mip_atlas` of stacks."""
        self._atlas = mip_atlas(*stacks, room=self._atlas)
        count, height, width, channels = self._atlas.shape
        if self._free:
            texture = self._free.pop()
            if (texture.size, texture.components) == ((width, height, count), channels):
                texture.write(self._atlas, alignment=1)
                return texture
            self._free.clear()  # of another size
        return texture_array_from_array(self._atlas)

    def take_back(self, stack: StackTextures) -> None:
        """Free the texture of a stack as soon as nothing refers to the stack."""
        weakref.finalize(stack, self._free.append, stack.ratio).atexit = False


@dataclass(frozen=True, slots=True, weakref_slot=True)
class StackTextures:
    """A `CausticStack` on the device. ratio: its `mip_atlas`. plane_depth: its `plane_steps`."""

    ratio: moderngl.TextureArray
    plane_depth: moderngl.Texture


def upload(stack: CausticStack, room: AtlasRoom | None = None) -> StackTextures:
    """Return a stack's textures, with its mip levels. room: None takes new memory."""
    ratio = np.asarray(stack.ratio, np.float32)
    grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
    stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
    if stack.soft is not None:
        stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
    room = AtlasRoom() if room is None else room
    texture = room.filled(*stacks)
    # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    held = StackTextures(texture, texture_from_array(plane_steps(stack.depth_m)))
    room.take_back(held)
    return held
