# SPDX-License-Identifier: Apache-2.0
"""Sun maps: what the bodies of a shot fill along the sun, as shadow.glsl reads it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.composite.gl.upload import MeshBuffers
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject
from mr360uw.gl.context import draw_fullscreen, gl_context, program, set_uniforms, texture_from_array
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

MAXIMUM_SLOTS = 30
"""Bodies that have a map of their own; the shader keeps them as the bits of an integer."""
SLOTS = (64, 128, 256, 512)
"""Texels across a body's map."""
_NARROW_RAD = 0.02
"""The largest slot is for discs below this radius, whose penumbrae near the body are as narrow as its texels."""
_TEXELS_A_PIXEL = 2.0
_MOST_TEXELS_A_PIXEL = 8.0
"""Texels that a pixel is worth: penumbrae narrower than a pixel matter, too, but not much narrower."""
_TEXELS_A_DISC = 7.0
"""Texels across the sun's radius at the distance of a body's width."""
_MOST_TEXELS = 1 << 21
_SUPERSAMPLING = 2
_COLUMNS = 8
_MARGIN = 1.02
_NARROWEST = 1.0 / 16.0
"""Shorter side of a slot's extent, at least, in terms of the longer one."""


def slot_size(casters: Sequence[PlacedObject], pixels_across: float, half_angle_rad: float) -> int:
    """Return the texels across a slot that do for a disc of this radius and bodies at most so many pixels wide."""
    wanted = max(_TEXELS_A_PIXEL * pixels_across, _TEXELS_A_DISC / float(np.tan(half_angle_rad)))
    wanted = min(wanted, _MOST_TEXELS_A_PIXEL * pixels_across, SLOTS[-1] if half_angle_rad < _NARROW_RAD else SLOTS[-2])
    most = np.sqrt(_MOST_TEXELS / min(max(len(casters), 1), MAXIMUM_SLOTS))
    return next(size for size in SLOTS if size >= wanted or 2 * size > most)


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """Targets for so many columns and rows of slots. Framebuffers are kept, too: one that is collected while it is
    bound leaves nothing bound.
    """

    layout: tuple[int, int, int]
    drawn: moderngl.Framebuffer
    atlas: moderngl.Framebuffer


class SunMaps:
    """Draws every body into a slot of one texture; keeps the targets."""

    def __init__(self) -> None:
        stages = {"vertex": "composite/gl/shaders/sun_map.vert", "fragment": "composite/gl/shaders/sun_map.frag"}
        self._bodies = {masked: program(**stages, defines={"MASKED": 1} if masked else {}) for masked in (False, True)}
        self._columns = program(fragment="composite/gl/shaders/sun_columns.frag")
        self._kept: _Kept | None = None

    def draw(
        self, casters: Sequence[PlacedObject], axes: Floats, size: int, buffers: Callable[[Mesh], MeshBuffers]
    ) -> tuple[moderngl.Texture, moderngl.Texture]:
        """Return the textures `sun_map` and `casters` of shadow.glsl; the last slot takes all bodies beyond it.

        axes: (3, 3) rows across, across and along the sun. size: texels across a slot.
        """
        groups = [[placed] for placed in casters[: MAXIMUM_SLOTS - 1]]
        if len(casters) >= MAXIMUM_SLOTS:
            groups.append(list(casters[MAXIMUM_SLOTS - 1 :]))
        columns, rows = min(max(len(groups), 1), _COLUMNS), max(-(-len(groups) // _COLUMNS), 1)
        kept = self._targets(columns, rows, size)
        kept.drawn.use()
        kept.drawn.viewport = (0, 0, *kept.drawn.size)
        kept.drawn.clear(-1e9, -1e9, 0.0, 0.0)
        table = np.zeros((max(len(groups), 1), 2, 4))
        side = _SUPERSAMPLING * size
        for number, group in enumerate(groups):
            column, row = number % _COLUMNS, number // _COLUMNS
            kept.drawn.viewport = (column * side, row * side, side, side)
            center, half, reach = self._draw_bodies(kept.drawn, group, axes, buffers)
            table[number] = (*center, *half), (*reach, column * size, row * size)
        entries = texture_from_array(table)
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        kept.drawn.color_attachments[0].use(0)  # type: ignore[union-attr]
        entries.use(1)
        set_uniforms(self._columns, drawn=0, casters=1, slot_size=size, slot_columns=columns)
        kept.atlas.viewport = (0, 0, columns * size, rows * size)
        draw_fullscreen(kept.atlas, self._columns)
        atlas = kept.atlas.color_attachments[0]
        atlas.build_mipmaps(0, size.bit_length() - 3)  # type: ignore[union-attr]
        atlas.filter = (gl_context().LINEAR_MIPMAP_NEAREST, gl_context().LINEAR)  # type: ignore[union-attr]
        return atlas, entries  # type: ignore[return-value]

    def _targets(self, columns: int, rows: int, size: int) -> _Kept:
        if self._kept is None or self._kept.layout != (columns, rows, size):
            context, width, height = gl_context(), columns * size, rows * size
            atlas = context.texture((width, height), 4, dtype="f4")
            atlas.repeat_x = atlas.repeat_y = False
            drawn = context.texture((_SUPERSAMPLING * width, _SUPERSAMPLING * height), 2, dtype="f4")
            framebuffers = (context.framebuffer([texture]) for texture in (drawn, atlas))
            self._kept = _Kept((columns, rows, size), *framebuffers)
        return self._kept

    def _draw_bodies(
        self,
        target: moderngl.Framebuffer,
        group: Sequence[PlacedObject],
        axes: Floats,
        buffers: Callable[[Mesh], MeshBuffers],
    ) -> tuple[Floats, Floats, Floats]:
        """Draw bodies into the viewport: the largest of (top, -bottom) along the sun.

        Returns the centre across, half the size across, and the lowest and highest along the sun, two numbers each [m].
        """
        matrices = [axes @ placed.world_from_object[:3] for placed in group]
        points = np.concatenate(
            [p.mesh.hull.reshape(-1, 3) @ m[:, :3].T + m[:, 3] for p, m in zip(group, matrices, strict=True)]
        )
        low, high = points.min(axis=0), points.max(axis=0)
        center, half = 0.5 * (low + high)[:2], 0.5 * _MARGIN * (high - low)[:2]
        half = np.maximum(half, _NARROWEST * half.max())
        for placed, matrix in zip(group, matrices, strict=True):
            for masked, mode in ((False, "OPAQUE"), (True, "MASK")):
                self._draw_body(
                    target, buffers(placed.mesh), mode, self._bodies[masked], matrix, (*center, *(1.0 / half))
                )
        return center, half, np.array([low[2], high[2]])

    def _draw_body(
        self,
        target: moderngl.Framebuffer,
        mesh: MeshBuffers,
        mode: str,
        shader: moderngl.Program,
        matrix: Floats,
        slot: tuple[float, ...],
    ) -> None:
        context = gl_context()
        first, count = mesh.ranges[mode]  # type: ignore[index]
        if count == 0:
            return
        for unit, name in enumerate(("triangles", "materials", "store")):
            if name in shader:
                getattr(mesh, name).use(unit)
                set_uniforms(shader, **{name: unit})
        sun_from_object = np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])
        set_uniforms(shader, sun_from_object=sun_from_object.T, slot=slot)
        vertex_array = context.vertex_array(shader, [(mesh.corners, "3f 4x", "corner")])
        with context.scope(target, context.BLEND):
            context.blend_func = (context.ONE, context.ONE)
            context.blend_equation = context.MAX  # type: ignore[assignment]
            vertex_array.render(context.TRIANGLES, vertices=3 * count, first=3 * first)
            context.blend_equation = context.FUNC_ADD  # type: ignore[assignment]
