# SPDX-License-Identifier: Apache-2.0
"""Named passes and the textures they reuse from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import moderngl

from mr360uw.errors import ParameterError
from mr360uw.gl.context import gl_context, program, set_uniforms

Textures = Mapping[str, moderngl.Texture | moderngl.TextureArray]


class Passes:
    """Runs shaders caustics/gl/NAME.frag into float textures that are kept by name."""

    def __init__(self) -> None:
        self._textures: dict[str, moderngl.Texture] = {}
        self._programs: dict[str, moderngl.Program] = {}
        self._targets: dict[tuple[int, ...], moderngl.Framebuffer] = {}
        self._empty: dict[str, moderngl.VertexArray] = {}

    def __getitem__(self, name: str) -> moderngl.Texture:
        return self._textures[name]

    def texture(self, name: str, width: int, height: int, components: int = 1) -> moderngl.Texture:
        """Return the float texture of a name, made anew where its shape has changed."""
        texture = self._textures.get(name)
        if texture is None or (*texture.size, texture.components) != (width, height, components):
            limit = int(gl_context().info["GL_MAX_TEXTURE_SIZE"])
            if max(width, height) > limit:
                raise ParameterError(
                    f"size - is beyond this OpenGL's textures (got {width // 2}) - choose up to {limit // 2}"
                )
            texture = gl_context().texture((width, height), components, dtype="f4")
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._textures[name] = texture
            self._targets.clear()
        return texture

    def target(self, textures: Sequence[moderngl.Texture]) -> moderngl.Framebuffer:
        """Return the framebuffer of some of the kept textures."""
        key = tuple(texture.glo for texture in textures)
        if key not in self._targets:
            self._targets[key] = gl_context().framebuffer(list(textures))
        return self._targets[key]

    def fill(self, targets: Sequence[moderngl.Texture], name: str, inputs: Textures, **uniforms: Any) -> None:
        """Run a full-screen pass into textures; capital uniforms are the shader's #defines."""
        self.draw(self.target(targets), name, inputs, **uniforms)

    def draw(
        self,
        target: moderngl.Framebuffer,
        name: str,
        inputs: Textures,
        *,
        vertex: str | None = None,
        geometry: str | None = None,
        vertices: int = 3,
        mode: int = moderngl.TRIANGLES,
        **uniforms: Any,
    ) -> None:
        """Run caustics/gl/NAME.frag over a full screen, or over `vertices` of a vertex shader, which add up."""
        defines = {key: value for key, value in uniforms.items() if key.isupper()}
        key = f"{name} {vertex} {geometry} {defines}"
        if key not in self._programs:
            self._programs[key] = program(
                vertex=vertex, geometry=geometry, fragment=f"caustics/gl/{name}.frag", defines=defines
            )
            self._empty[key] = gl_context().vertex_array(self._programs[key], [])
        shader = self._programs[key]
        for unit, (sampler, texture) in enumerate(inputs.items()):
            texture.use(unit)
            set_uniforms(shader, **{sampler: unit})
        set_uniforms(shader, **{k: v for k, v in uniforms.items() if not k.isupper()})
        target.use()
        context = gl_context()
        if vertex is not None:
            context.enable(moderngl.BLEND | moderngl.PROGRAM_POINT_SIZE)
            context.blend_func = moderngl.ONE, moderngl.ONE
        self._empty[key].render(mode, vertices)
        if vertex is not None:
            context.disable(moderngl.BLEND | moderngl.PROGRAM_POINT_SIZE)
