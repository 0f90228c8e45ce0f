# SPDX-License-Identifier: Apache-2.0
"""Sun maps: what the bodies of a shot fill along the sun, as shadow.glsl reads it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.composite.gl_upload import MeshBuffers
from mr360uw.composite.mesh import Mesh
from mr360uw.composite.shot import PlacedObject
from mr360uw.gl.context import draw_fullscreen, gl_context, program, set_uniforms, texture_from_array
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

MAXIMUM_SLOTS = 30
"""Bodies that have a map of their own; the shader keeps them as the bits of an integer."""
_COLUMNS = 8


class SunMaps:
    """Draws every body into a slot of one texture; keeps the targets."""

    def __init__(self) -> None:
        self._bodies = program(vertex="composite/sun_map.vert", fragment="composite/sun_map.frag")
        self._resolve = program(fragment="composite/sun_columns.frag")
        # framebuffers are kept too: one that is collected while it is bound leaves nothing bound
        self._kept: tuple[moderngl.Texture, moderngl.Framebuffer, moderngl.Texture, moderngl.Framebuffer] | None = None

    def draw(
        self, casters: Sequence[PlacedObject], axes: Floats, slot_size: int, buffers: Callable[[Mesh], MeshBuffers]
    ) -> tuple[moderngl.Texture, moderngl.Texture]:
        """Return the textures `sun_map` and `casters` of shadow.glsl; the last slot takes all bodies beyond it.

        axes: (3, 3) rows across, across and along the sun.
        """
        context = gl_context()
        groups = [[placed] for placed in casters[: MAXIMUM_SLOTS - 1]]
        if len(casters) >= MAXIMUM_SLOTS:
            groups.append(list(casters[MAXIMUM_SLOTS - 1 :]))
        columns, rows = min(max(len(groups), 1), _COLUMNS), max(-(-len(groups) // _COLUMNS), 1)
        size = (columns * slot_size, rows * slot_size)
        if self._kept is None or self._kept[0].size != size:
            drawn, filled = context.texture(size, 2, dtype="f4"), context.texture(size, 4, dtype="f4")
            filled.filter = (context.LINEAR, context.LINEAR)
            filled.repeat_x = filled.repeat_y = False
            self._kept = drawn, context.framebuffer([drawn]), filled, context.framebuffer([filled])
        drawn, target, filled, resolved = self._kept
        target.use()
        target.viewport = (0, 0, *size)
        target.clear(-1e9, -1e9, 0.0, 0.0)
        table = np.zeros((max(len(groups), 1), 2, 4))
        for number, group in enumerate(groups):
            slot = number % _COLUMNS, number // _COLUMNS
            target.viewport = (slot[0] * slot_size, slot[1] * slot_size, slot_size, slot_size)
            box = self._draw_bodies(target, group, axes, buffers)
            table[number] = (*box[:3], 0.0), (*box[3:], *slot)
        entries = texture_from_array(table)
        drawn.use(0)
        entries.use(1)
        set_uniforms(self._resolve, drawn=0, casters=1, slot_size=slot_size, slot_columns=columns)
        context.disable(context.DEPTH_TEST | context.BLEND)
        draw_fullscreen(resolved, self._resolve)
        return filled, entries

    def _draw_bodies(
        self,
        target: moderngl.Framebuffer,
        group: Sequence[PlacedObject],
        axes: Floats,
        buffers: Callable[[Mesh], MeshBuffers],
    ) -> tuple[float, float, float, float, float]:
        """Draw bodies into the viewport: the largest of (top, -bottom) along the sun.

        Returns (centre across, half the size across, lowest and highest along the sun), five numbers [m].
        """
        context = gl_context()
        matrices = [axes @ placed.world_from_object[:3] for placed in group]
        points = np.concatenate(
            [p.mesh.hull.reshape(-1, 3) @ m[:, :3].T + m[:, 3] for p, m in zip(group, matrices, strict=True)]
        )
        low, high = points.min(axis=0), points.max(axis=0)
        x, y = (0.5 * (low + high)[:2]).tolist()
        half = 0.51 * float(max(high[:2] - low[:2]))
        for placed, matrix in zip(group, matrices, strict=True):
            mesh = buffers(placed.mesh)
            opaque = mesh.ranges["BLEND"][0]
            if opaque == 0:
                continue
            sun_from_object = np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])
            set_uniforms(self._bodies, sun_from_object=sun_from_object.T, slot=(x, y, 1.0 / half, 1.0 / half))
            vertex_array = context.vertex_array(self._bodies, [(mesh.corners, "3f 4x", "corner")])
            with context.scope(target, context.BLEND):
                context.blend_func = (context.ONE, context.ONE)
                context.blend_equation = context.MAX  # type: ignore[assignment]
                vertex_array.render(context.TRIANGLES, vertices=3 * opaque)
                context.blend_equation = context.FUNC_ADD  # type: ignore[assignment]
        return x, y, half, float(low[2]), float(high[2])
