# SPDX-License-Identifier: Apache-2.0
"""Heights of a sea over places instead of rest positions: the texture that rays are intersected with.

A ray that asks for the height above a place would have to look for the particle there at every step. The atlas has it
at the points of every level, found once by Newton's method, with the slopes, which are exact. In between it is linear.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.errors import GlError
from mr360uw.gl.context import gl_context, program, set_uniforms, texture_from_array
from mr360uw.surface.sampled_sea import SampledSea

if TYPE_CHECKING:
    import moderngl

_EDGE = 2
"""Texels of border of a level, both sides."""


class HeightAtlas:
    """Atlas of the last sea. textures: height and slopes; shift of the particles."""

    def __init__(self) -> None:
        self._program = program(fragment="surface/gl/shaders/heights.frag")
        self._coefficients: moderngl.Texture | None = None
        self._sea: SampledSea | None = None
        self._target: moderngl.Framebuffer | None = None

    def of(self, sea: SampledSea) -> dict[str, Any]:
        """Return the textures `heights` and `shifts` of a sea, and the `coefficients` that they are of."""
        width = int(sea.size[0]) + _EDGE
        height = int(np.sum(sea.size + _EDGE))
        if self._target is None or self._target.size != (width, height):
            self._target, self._sea = _target(width, height), None
        if self._sea is not sea:
            self._draw(sea, self._target)
            self._sea = sea
        heights, shifts = self._target.color_attachments
        return {"heights": heights, "shifts": shifts, "coefficients": self._coefficients}

    def _draw(self, sea: SampledSea, target: moderngl.Framebuffer) -> None:
        width, rows = int(sea.size[0]), np.concatenate([[0], np.cumsum(sea.size)]).tolist()
        image = np.zeros((rows[-1], width, 3), np.float32)
        for first, size, row in zip(sea.start.tolist(), sea.size.tolist(), rows[:-1], strict=True):
            image[row : row + size, :size] = sea.coefficients[first : first + size**2].reshape(size, size, 3)
        self._coefficients = texture_from_array(image)
        self._coefficients.use(0)
        triangle = gl_context().vertex_array(self._program, [])
        target.use()
        top = 0
        for row, size in zip(rows[:-1], sea.size.tolist(), strict=True):
            set_uniforms(self._program, coefficients=0, first_row=row, points=size, tile_m=sea.tile_m, top=float(top))
            target.viewport = 0, top, size + _EDGE, size + _EDGE
            triangle.render(vertices=3)
            top += size + _EDGE


def _target(width: int, height: int) -> moderngl.Framebuffer:
    context = gl_context()
    limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
    if max(width, height) > limit:
        raise GlError(
            f"sea - its shortest waves need more points than this OpenGL's textures hold (got {width - _EDGE}) - "
            "take a smaller tile or backend='reference'"
        )
    textures = [context.texture((width, height), components, dtype="f4") for components in (4, 2)]
    for texture in textures:
        texture.filter = (context.LINEAR, context.LINEAR)
    return context.framebuffer(textures)
