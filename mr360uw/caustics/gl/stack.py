# SPDX-License-Identifier: Apache-2.0
"""A stack of caustic maps in textures, as lookup.glsl reads it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import mip_levels
from mr360uw.caustics.gl.atlas import layer_planes, mip_atlas, plane_steps
from mr360uw.gl.context import texture_array_from_array, texture_from_array
from mr360uw.types import CausticStack

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
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


def upload(stack: CausticStack) -> GlCausticStack:
    """Return a stack on the device, with its mip levels."""
    ratio = np.asarray(stack.ratio, np.float32)
    grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
    stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
    if stack.soft is not None:
        stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
    texture = texture_array_from_array(mip_atlas(*stacks))
    return on_device(texture, stack.depth_m, stack.tile_m, stack.sun_direction, softened=stack.softened)


def on_device(
    texture: moderngl.TextureArray, depth_m: Array, tile_m: float, sun_in_water: Array, *, softened: bool
) -> GlCausticStack:
    """Return the stack whose atlas is a texture."""
    # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return GlCausticStack(texture, texture_from_array(plane_steps(depth_m)), depth_m, tile_m, sun_in_water, softened)
