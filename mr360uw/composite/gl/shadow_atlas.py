# SPDX-License-Identifier: Apache-2.0
"""Shadow atlas: a square slot of columns along the light for each body, traced by shadow.glsl.

Each slot is drawn from a `LightFrame`: bodies, and axes in which the light's rays are parallel. For the sun these are
orthogonal axes along its direction; for a lamp they follow the projective map of lamps.glsl. A slot of the sun holds
heights above the lowest point of its bodies, about their middle: bodies that move without turning keep it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.cache import Cache, PartOf
from mr360uw.composite.ambient.form_factors import rounded
from mr360uw.composite.gl.device import MeshBuffers, bind
from mr360uw.composite.mesh.material import AlphaMode
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject
from mr360uw.gl.context import draw_fullscreen, float_texture, gl_context, program, set_uniforms, texture_from_array
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

SLOTS = (64, 128, 256, 512)
"""Texels across a slot."""
ROW_TEXELS = 6
"""Texels of a row of the atlas' table: extents, and for lamps the axes; see lamps.glsl."""
_NARROW_RAD = 0.02
"""Angular radius of a light below which the largest slots are used: its penumbrae are as narrow as their texels."""
_TEXELS_A_PIXEL = 2.0
_MOST_TEXELS_A_PIXEL = 8.0
"""Least and most texels for a pixel of the frame: penumbrae somewhat narrower than a pixel still matter."""
_TEXELS_A_DISC = 7.0
"""Texels across the light's radius at the distance of a body's width."""
_MOST_TEXELS = 1 << 21
"""Texels of all slots together: bounds the memory."""
_SUPERSAMPLING = 2
"""Texels drawn along each side of a column."""
_LEVELS = 16
"""Levels of which the target is kept."""
_COLUMNS = 8
"""Slots in a row of the atlas."""
_MARGIN = 1.02
"""Factor on the extent of the bodies in a slot, which keeps its border empty."""
_NARROWEST = 1.0 / 16.0
"""Least ratio of the shorter side of a slot's extent to the longer one."""


@dataclass(frozen=True, slots=True, eq=False)
class LightFrame:
    """Projection of one slot. bodies: drawn over each other. axes: (3, 3) rows across, across and along, in the world.

    For the sun `along` points to it. For a lamp: origin (3,) [m] in the world, `along` pointing away from it, and
    middle_m, the distance [m] at which lengths are metres; bodies nearer than nearest_m cast no shadow. face: the slot
    is a face of a cube, 90 degrees wide, whatever its bodies' extents.
    """

    bodies: tuple[PlacedObject, ...]
    axes: Floats
    origin: Floats | None = None
    middle_m: float = 0.0
    nearest_m: float = 0.0
    face: bool = False

    @property
    def drawn(self) -> tuple[object, ...]:
        """All that decides what is drawn of it."""
        if self.origin is None:
            return *((body.mesh, self.matrix(body)) for body in self.bodies), self.axes
        return (
            *((body.mesh, body.world_from_object) for body in self.bodies),
            self.axes,
            self.origin,
            self.middle_m,
            self.nearest_m,
        )

    @property
    def start(self) -> Floats:
        """Place (3,) [m] in the world from which the bodies are drawn: the lamp, or for the sun the first body."""
        return self.bodies[0].world_from_object[:3, 3] if self.origin is None else self.origin

    def matrix(self, placed: PlacedObject) -> Floats:
        """Return the (3, 4) transform from a body to the axes about `start`, before any projection."""
        shift = rounded(placed.world_from_object[:3, 3] - self.start, placed.mesh.radius_m * placed.scale)
        return self.axes @ np.column_stack([placed.world_from_object[:3, :3], shift])

    def placed(self, extents: Floats) -> Floats:
        """Return extents (6,) about `start` as the shaders take them: for the sun about the world's origin."""
        if self.origin is not None:
            return extents
        x, y, z = self.axes @ self.start
        return extents + np.array([x, y, 0.0, 0.0, z, z])

    def extents(self) -> Floats:
        """Return the bodies' extents (6,): centre across, half size across, ends along; two numbers each."""
        points = np.concatenate(
            [body.mesh.hull.reshape(-1, 3) @ m[:, :3].T + m[:, 3] for body in self.bodies for m in [self.matrix(body)]]
        )
        if self.origin is not None:
            points = self._projected(points)
        low, high = points.min(axis=0), points.max(axis=0)
        center, half = 0.5 * (low + high)[:2], 0.5 * _MARGIN * (high - low)[:2]
        if self.face:
            center, half = np.zeros(2), np.full(2, self.middle_m)
        half = np.maximum(half, _NARROWEST * half.max())
        return np.concatenate([center, half, [low[2], high[2]]])

    def _projected(self, points: Floats) -> Floats:
        z = np.maximum(points[:, 2], self.nearest_m)
        return (
            np.stack([points[:, 0], points[:, 1], np.full(len(z), self.middle_m)], axis=-1)
            * (self.middle_m / z)[:, None]
        )


def slot_size(slots: int, pixels_across: float, half_angle_rad: float) -> int:
    """Return the texels across a slot for a light of this radius and bodies at most `pixels_across` pixels wide."""
    wanted = max(_TEXELS_A_PIXEL * pixels_across, _TEXELS_A_DISC / max(float(np.tan(half_angle_rad)), 1e-6))
    wanted = min(wanted, _MOST_TEXELS_A_PIXEL * pixels_across, SLOTS[-1] if half_angle_rad < _NARROW_RAD else SLOTS[-2])
    most = np.sqrt(_MOST_TEXELS / max(slots, 1))
    return next(size for size in SLOTS if size >= wanted or 2 * size > most)


class ShadowAtlas:
    """Draws atlases; the last one is cached. buffers: returns the device's copy of a mesh."""

    def __init__(self, cache: Cache, buffers: Callable[[Mesh], MeshBuffers]) -> None:
        self._cache, self._buffers = cache, buffers
        self._shaders: dict[tuple[object, ...], moderngl.Program] = {}

    def of(self, frames: Sequence[LightFrame], size: int) -> tuple[moderngl.Texture, Floats]:
        """Return the atlas of frames in slots of `size` texels, and its table (slots, ROW_TEXELS, 4), whose first two
        texels are filled.
        """
        if not frames:
            return self._cache.of(_nothing)
        texture, drawn = self._cache.of(self._draw, PartOf(frames, *(frame.drawn for frame in frames)), size)
        extents = [frame.placed(of_frame) for frame, of_frame in zip(frames, drawn, strict=True)]
        return texture, _table(extents, size)

    def _shader(self, make: Callable[..., moderngl.Program], *switches: object) -> moderngl.Program:
        """Return a shader, compiled when it is first used."""
        if (make, *switches) not in self._shaders:
            self._shaders[make, *switches] = make(*switches)
        return self._shaders[make, *switches]

    def _draw(self, drawn_of: PartOf[Sequence[LightFrame]], size: int) -> tuple[moderngl.Texture, list[Floats]]:
        """Return the columns of all slots, and the extents (6,) of each about the start of its frame."""
        frames = drawn_of.whole
        columns, rows = min(len(frames), _COLUMNS), -(-len(frames) // _COLUMNS)
        drawn = self._cache.of(_target, columns * size, rows * size)
        texture = float_texture(columns * size * 3 // 2, rows * size, 4)
        texture.repeat_x = texture.repeat_y = False
        texture.filter = (gl_context().LINEAR, gl_context().LINEAR)
        atlas = gl_context().framebuffer([texture])
        clear = self._cache.of(_target, columns * size, rows * size, True) if translucent(frames) else None
        drawn.clear(-1e9, -1e9, 0.0, 0.0, viewport=(0, 0, *drawn.size))
        side, extents = _SUPERSAMPLING * size, [frame.extents() for frame in frames]
        for number, (frame, of_frame) in enumerate(zip(frames, extents, strict=True)):
            column, row = number % _COLUMNS, number // _COLUMNS
            slot, viewport = (*of_frame[:2], *(1.0 / of_frame[2:4])), (column * side, row * side, side, side)
            self._draw_frame(drawn, frame, viewport, slot)
            if clear is not None:
                clear.clear(1.0, 1.0, 1.0, 1.0, viewport=viewport)
                self._draw_frame(clear, frame, viewport, slot, passed=True)
        entries = texture_from_array(_table(extents, size))
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        shader = self._shader(_column_shader, clear is not None)
        passed = {} if clear is None else {"passed": clear.color_attachments[0]}
        bind(shader, {"drawn": drawn.color_attachments[0], "casters": entries, **passed})
        set_uniforms(shader, slot_size=size, slot_columns=columns)
        atlas.viewport = (0, 0, columns * size, rows * size)
        draw_fullscreen(atlas, shader)
        self._add_levels(atlas, columns * size, rows * size, size)
        return texture, extents

    def _add_levels(self, atlas: moderngl.Framebuffer, width: int, height: int, size: int) -> None:
        """Draw the means of 2 x 2, 4 x 4, ... columns (height, width) beside them, down to 4 texels across a slot."""
        shader, source = self._shader(_level_shader), atlas
        for level in range(1, size.bit_length() - 2):
            part = width >> level, height >> level
            halved = self._cache.of(_level, *part, keep=_LEVELS)
            for target, side, corner in ((halved, 2, (0, 0)), (atlas, 1, (width, height - 2 * part[1]))):
                bind(shader, {"source": source.color_attachments[0]})
                set_uniforms(shader, side=side, corner=corner)
                target.viewport = (*corner, *part)
                draw_fullscreen(target, shader)
                source = halved

    def _draw_frame(
        self,
        target: moderngl.Framebuffer,
        frame: LightFrame,
        viewport: tuple[int, int, int, int],
        slot: tuple[float, ...],
        *,
        passed: bool = False,
    ) -> None:
        """Draw bodies into the viewport: the largest of (top, -bottom) along the light, or what light they let through,
        the product over their surfaces.
        """
        context = gl_context()
        target.use()
        target.viewport = viewport
        source, equation = (context.ZERO, context.FUNC_ADD) if passed else (context.ONE, context.MAX)
        for placed in frame.bodies:
            mesh = self._buffers(placed.mesh)
            light_from_object = np.concatenate([frame.matrix(placed), [[0.0, 0.0, 0.0, 1.0]]])
            for mode, (first, count) in mesh.ranges.items():
                if count == 0:
                    continue
                shader = self._shader(_body_shader, mode, frame.origin is not None, passed)
                bind(shader, {"triangles": mesh.triangles, "materials": mesh.materials, "store": mesh.store})
                set_uniforms(shader, light_from_object=light_from_object.T, slot=slot)
                if frame.origin is not None:
                    set_uniforms(shader, middle=frame.middle_m, nearest=frame.nearest_m)
                vertex_array = context.vertex_array(shader, [(mesh.corners, "3f 4x", "corner")])
                with context.scope(target, context.BLEND):
                    context.blend_func = (source, context.SRC_COLOR if passed else context.ONE)
                    context.blend_equation = equation  # type: ignore[assignment]
                    vertex_array.render(context.TRIANGLES, vertices=3 * count, first=3 * first)
                    context.blend_equation = context.FUNC_ADD  # type: ignore[assignment]


def _table(extents: Sequence[Floats], size: int) -> Floats:
    """Return the table of an atlas whose slots, of `size` texels, have these extents (6,)."""
    table = np.zeros((len(extents), ROW_TEXELS, 4))
    for number, of_frame in enumerate(extents):
        corner = number % _COLUMNS * size, number // _COLUMNS * size
        table[number, :2] = of_frame[:4], (*of_frame[4:], *corner)
    return table


def _nothing() -> tuple[moderngl.Texture, Floats]:
    return texture_from_array(np.zeros((1, 1, 2))), np.zeros((1, ROW_TEXELS, 4))


def translucent(frames: Sequence[LightFrame]) -> bool:
    """Return whether bodies of frames let light through by their alpha."""
    return any(m.alpha_mode == "BLEND" for frame in frames for body in frame.bodies for m in body.mesh.materials)


def _body_shader(mode: AlphaMode, projected: bool, passed: bool) -> moderngl.Program:
    """Return the shader that draws triangles of an alpha mode. passed: what they let through, else their heights."""
    path = "composite/gl/shaders/atlas/shadow_atlas"
    switches = {"READS_ALPHA": mode != "OPAQUE", "MASKED": mode == "MASK", "PROJECTED": projected, "PASSED": passed}
    defines = {name: 1 for name, there in switches.items() if there}
    return program(vertex=f"{path}.vert", fragment=f"{path}.frag", defines=defines)


def _column_shader(clear: bool) -> moderngl.Program:
    """Return the shader that makes columns of what was drawn. clear: bodies let light through."""
    return program(
        fragment="composite/gl/shaders/atlas/shadow_columns.frag", defines={"TRANSLUCENT": 1} if clear else {}
    )


def _level_shader() -> moderngl.Program:
    return program(fragment="composite/gl/shaders/atlas/shadow_levels.frag")


def _level(width: int, height: int) -> moderngl.Framebuffer:
    return gl_context().framebuffer([float_texture(width, height, 4)])


def _target(width: int, height: int, passed: bool = False) -> moderngl.Framebuffer:
    """Return a framebuffer to draw heights of bodies of columns (height, width) into, or what these let through."""
    size = (_SUPERSAMPLING * width, _SUPERSAMPLING * height)
    drawn = gl_context().texture(size, 1 if passed else 2, dtype="f4")
    return gl_context().framebuffer([drawn])
