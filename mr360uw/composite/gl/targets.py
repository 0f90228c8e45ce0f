# SPDX-License-Identifier: Apache-2.0
"""Programs and render targets that the passes of a layer share, kept from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.gl.context import gl_context, program, set_uniforms
from mr360uw.jit import exact
from mr360uw.types import Rectangle

if TYPE_CHECKING:
    import moderngl

BLOCK = 4
"""Pixels along a block. Targets hold numbered items block by block. Twin: blocks.glsl."""
_LANE_COLUMNS = 256
"""Width [texels] of targets that hold numbered items."""


class Targets:
    """Compiled programs by name and defines; float targets by name and channels, which only grow."""

    def __init__(self) -> None:
        self._programs: dict[str, moderngl.Program] = {}
        self._triangles: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._targets: dict[tuple[str, tuple[int, ...]], moderngl.Framebuffer] = {}

    def program(self, name: str, defines: Mapping[str, str | int | float]) -> moderngl.Program:
        """Return the full-screen program of composite/gl/shaders/<name>.frag with defines, compiled once."""
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"composite/gl/shaders/{name}.frag", defines=defines)
        return self._programs[key]

    def target(
        self, name: str, width: int, height: int, channels: tuple[int, ...], types: tuple[str, ...] = ()
    ) -> moderngl.Framebuffer:
        """Return a kept target of at least width x height pixels, one texture for each number of channels.

        A target that has to grow is made anew, and its contents are lost. types: of the textures' numbers; floats
        where none are given.
        """
        target = self._targets.get((name, channels))
        if target is None or target.width < width or target.height < height:
            w, h = width, height
            if target is not None:
                w, h = max(w, target.width), max(h, target.height)
            of = zip(channels, types or ("f4",) * len(channels), strict=True)
            target = gl_context().framebuffer([gl_context().texture((w, h), c, dtype=kind) for c, kind in of])
            self._targets[name, channels] = target
        return target

    def fill(self, target: moderngl.Framebuffer, shader: moderngl.Program, part: Rectangle) -> None:
        """Run a full-screen program on a part of a target; discarded pixels keep their values."""
        if shader not in self._triangles:
            self._triangles[shader] = gl_context().vertex_array(shader, [])
        target.use()
        target.viewport = part
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        self._triangles[shader].render(vertices=3)

    def items(self, shader: moderngl.Program, name: str, count: int, channels: tuple[int, ...]) -> NDArray[np.float32]:
        """Run a full-screen program on `count` numbered items, as blocks.glsl numbers the texels of a kept target.

        Returns the values (count, k) of all its textures, side by side.
        """
        part = Rectangle(0, 0, _LANE_COLUMNS, BLOCK * -(-count // (BLOCK * _LANE_COLUMNS)))
        target = self.target(name, part.width, part.height, channels)
        self.fill(target, shader, part)
        values = np.empty((count, sum(channels)), np.float32)
        for k, first in enumerate(np.cumsum([0, *channels[:-1]])):
            write_lanes(self.read(target, part, k), int(first), values)
        return values

    @staticmethod
    def read(target: moderngl.Framebuffer, part: Rectangle, attachment: int = 0) -> NDArray[np.float32]:
        """Return a part of a texture of a target (h, w, c); wait until it is drawn."""
        textures: Sequence[Any] = target.color_attachments
        channels = textures[attachment].components
        image = np.empty((part.height, part.width, channels), np.float32)
        target.read_into(image, part, channels, attachment=attachment, dtype="f4", alignment=1)
        return image


def bind(shader: moderngl.Program, textures: Mapping[str, Any]) -> None:
    """Bind the textures that a program uses, each to a unit of its own."""
    unit = 0
    for name, texture in textures.items():
        if shader.get(name, None) is not None:  # `in` looks at one name after the other
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
            unit += 1


@exact
def write_lanes(image: Any, first: int, values: Any) -> None:
    """Write the texels of a target's image (h, w, c) into values (n, first + c...), from column `first` on, in the
    order of their numbers: block by block.
    """
    across = image.shape[1] // BLOCK
    for k in range(len(values)):
        block, within = k // (BLOCK * BLOCK), k % (BLOCK * BLOCK)
        row = BLOCK * (block // across) + within // BLOCK
        column = BLOCK * (block % across) + within % BLOCK
        for c in range(image.shape[2]):
            values[k, first + c] = image[row, column, c]
