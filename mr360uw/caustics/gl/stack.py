# SPDX-License-Identifier: Apache-2.0
"""A stack of caustic maps in textures, as lookup.glsl reads it."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import mip_levels
from mr360uw.caustics.gl.atlas import layer_planes, mip_atlas, plane_steps
from mr360uw.gl.context import texture_array_from_array, texture_from_array
from mr360uw.types import CausticStack, Floats

Array = NDArray[np.floating[Any]]


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

    def take_back(self, stack: GlCausticStack) -> None:
        """Free the texture of a stack as soon as nothing refers to the stack."""
        weakref.finalize(stack, self._free.append, stack.texture).atexit = False


@dataclass(frozen=True, slots=True, weakref_slot=True)
class GlCausticStack:
    """A `CausticStack` on the GPU, as lookup.glsl reads it.

    texture: the mip_atlas. plane_depth: its plane_steps. depth_m: (planes,) on the host. sun_direction: (3,) in the
    water. softened: whether the last layers hold the pattern of light that the water has turned, in one colour.
    """

    texture: moderngl.TextureArray
    plane_depth: moderngl.Texture
    depth_m: Array
    tile_m: float
    sun_direction: Array
    softened: bool = False

    def download(self) -> CausticStack:
        """Return the stack as an array."""
        width, height, layers = self.texture.size
        size, planes = width - 2, layer_planes(len(self.depth_m))
        data = np.frombuffer(self.texture.read(alignment=1), np.float32)
        level = data.reshape(layers, height, width, -1)[:, 1 : size + 1, 1:-1]
        sharp = len(level) - len(planes) * self.softened
        maps = _of_layers(level[:sharp], planes, len(self.depth_m))
        soft = _of_layers(level[sharp:], planes, len(self.depth_m)) if self.softened else None
        ratio = np.broadcast_to(maps, (*maps.shape[:3], 3))
        return CausticStack(ratio, self.depth_m, self.tile_m, self.sun_direction, soft)


def _of_layers(level: Array, planes: NDArray[np.int64], count: int) -> Array:
    """Return maps (count, size, size, C) of layers (layers C, size, size, 1, 2 or 4)."""
    size = level.shape[1]
    maps = np.zeros((count, size, size, len(level) // len(planes)))
    for layer, held in zip(level.reshape(len(planes), -1, *level.shape[1:]), planes, strict=True):
        maps[held] = layer.transpose(3, 1, 2, 0)
    return maps


def upload(stack: CausticStack, room: AtlasRoom | None = None) -> GlCausticStack:
    """Return a stack on the device, with its mip levels. room: None takes new memory."""
    ratio = np.asarray(stack.ratio, np.float32)
    grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
    stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
    if stack.soft is not None:
        stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
    room = AtlasRoom() if room is None else room
    texture = room.filled(*stacks)
    held = on_device(texture, stack.depth_m, stack.tile_m, stack.sun_direction, softened=stack.softened)
    room.take_back(held)
    return held


def on_device(
    texture: moderngl.TextureArray, depth_m: Array, tile_m: float, sun_in_water: Array, *, softened: bool
) -> GlCausticStack:
    """Return the stack whose atlas is a texture."""
    # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return GlCausticStack(texture, texture_from_array(plane_steps(depth_m)), depth_m, tile_m, sun_in_water, softened)
