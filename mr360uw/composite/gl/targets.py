# SPDX-License-Identifier: Apache-2.0
"""Programs and render targets that the passes of a layer share, kept from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.gl.context import gl_context, program, set_uniforms
from mr360uw.types import Floats, Rectangle

if TYPE_CHECKING:
    import moderngl


class Targets:
    """Compiled programs by name and defines; float targets by name, which only grow."""

    def __init__(self) -> None:
        self._programs: dict[str, moderngl.Program] = {}
        self._triangles: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._targets: dict[str, moderngl.Framebuffer] = {}

    def program(self, name: str, defines: Mapping[str, str | int | float]) -> moderngl.Program:
        """Return the full-screen program of composite/gl/shaders/<name>.frag with defines, compiled once."""
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"composite/gl/shaders/{name}.frag", defines=defines)
        return self._programs[key]

    def target(self, name: str, width: int, height: int, channels: tuple[int, ...]) -> moderngl.Framebuffer:
        """Return a kept target of at least width x height pixels, one texture for each number of channels.

        A target that has to grow is made anew, and its contents are lost.
        """
        target = self._targets.get(name)
        if target is None or target.width < width or target.height < height:
            w, h = (width, height) if target is None else (max(width, target.width), max(height, target.height))
            target = gl_context().framebuffer([gl_context().texture((w, h), c, dtype="f4") for c in channels])
            self._targets[name] = target
        return target

    def fill(self, target: moderngl.Framebuffer, shader: moderngl.Program, part: Rectangle) -> None:
        """Run a full-screen program on a part of a target; discarded pixels keep their values."""
        if shader not in self._triangles:
            self._triangles[shader] = gl_context().vertex_array(shader, [])
        target.use()
        target.viewport = part
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        self._triangles[shader].render(vertices=3)

    def draw(self, shader: moderngl.Program, name: str, width: int, height: int, channels: tuple[int, ...]) -> None:
        """Run a full-screen program on width x height pixels of a kept target; discarded pixels are zero."""
        target = self.target(name, width, height, channels)
        part = Rectangle(0, 0, width, height)
        target.use()
        target.clear(viewport=part)
        target.scissor = part
        self.fill(target, shader, part)
        target.scissor = None  # type: ignore[assignment]

    def read(self, name: str, width: int, height: int) -> list[Floats]:
        """Return the images (h, w, c), float32, of a kept target."""
        target = self._targets[name]
        return [
            read_attachment(target, attachment, Rectangle(0, 0, width, height))
            for attachment in range(len(target.color_attachments))
        ]


def read_attachment(target: moderngl.Framebuffer, attachment: int, part: Rectangle) -> Floats:
    """Return a part of one texture of a target, (h, w, c) float32."""
    texture: Any = target.color_attachments[attachment]
    data = target.read(viewport=part, components=texture.components, attachment=attachment, dtype="f4", alignment=1)
    return np.frombuffer(data, np.float32).reshape(part[3], part[2], texture.components)


def bind(shader: moderngl.Program, textures: Mapping[str, Any]) -> None:
    """Bind the textures that a program uses, each to a unit of its own."""
    unit = 0
    for name, texture in textures.items():
        if name in shader:
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
            unit += 1
