# SPDX-License-Identifier: Apache-2.0
"""Programs and targets that the passes of a layer share and keep from frame to frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.composite.tiles import Rectangle
from mr360uw.gl.context import draw_fullscreen, gl_context, program, set_uniforms
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl


class Targets:
    """Compiled programs by name and defines; float targets by name, which only grow."""

    def __init__(self) -> None:
        self._programs: dict[str, moderngl.Program] = {}
        self._targets: dict[str, moderngl.Framebuffer] = {}

    def program(self, name: str, defines: dict[str, int], **stages: str) -> moderngl.Program:
        """Return the program of composite/<name>.frag with defines and further stages, compiled once."""
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"composite/{name}.frag", defines=defines, **stages)
        return self._programs[key]

    def draw(
        self,
        shader: moderngl.Program,
        name: str,
        width: int,
        height: int,
        channels: tuple[int, ...],
        part: Rectangle | None = None,
    ) -> moderngl.Texture:
        """Run a full-screen program on width x height pixels of a kept target, or a part of them.

        What it discards is zero. Returns the first of the target's textures, which may be larger.
        """
        target = self._targets.get(name)
        if target is None or target.width < width or target.height < height:
            w, h = (width, height) if target is None else (max(width, target.width), max(height, target.height))
            target = gl_context().framebuffer([gl_context().texture((w, h), c, dtype="f4") for c in channels])
            self._targets[name] = target
        part = part or (0, 0, width, height)
        target.use()
        target.viewport = (0, 0, width, height)
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        target.clear(viewport=part)
        target.scissor = part
        draw_fullscreen(target, shader)
        target.scissor = None  # type: ignore[assignment]
        image: Any = target.color_attachments[0]
        return image

    def read(self, name: str, width: int, height: int) -> list[Floats]:
        """Return the images (h, w, c), float32, of a kept target."""
        target = self._targets[name]
        images = []
        for attachment, texture in enumerate(target.color_attachments):
            c = texture.components
            data = target.read(
                viewport=(0, 0, width, height), components=c, attachment=attachment, dtype="f4", alignment=1
            )
            images.append(np.frombuffer(data, np.float32).reshape(height, width, c))
        return images


def bind(shader: moderngl.Program, textures: dict[str, Any]) -> None:
    """Bind the textures that a program uses, each to a unit of its own."""
    unit = 0
    for name, texture in textures.items():
        if name in shader:
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
            unit += 1
