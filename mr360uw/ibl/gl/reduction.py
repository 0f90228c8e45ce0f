# SPDX-License-Identifier: Apache-2.0
"""Environment of a plate that is a texture of linear RGB: expansion and block means on the GPU.

One fragment for each coarse pixel sums the plate's texels under it. The sun and the integrals are small and stay on
the CPU. On llvmpipe the pass over decoded planes (`environment_from_yuv`) is quicker: use this on a GPU.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.color import encode
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.gl.context import draw_fullscreen, gl_context, program, read_framebuffer, set_uniforms, texture_from_array
from mr360uw.ibl.expansion import expand_samples, region_edge
from mr360uw.ibl.level.upward import LEVEL, elevation_sine, upward
from mr360uw.ibl.lighting import SunChoice, light_of
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.ibl.published.tone_curves import POINTWISE, gain, luma_weights
from mr360uw.ibl.settings import LightSettings
from mr360uw.sphere import Array, frame_from_direction
from mr360uw.types import Environment, Floats

if TYPE_CHECKING:
    import moderngl

_TABLE = 2048


@dataclass(frozen=True, slots=True)
class TexturePlate:
    """A plate held as a texture (H, W) of linear RGB, with the maps of one pass over it."""

    texture: moderngl.Texture
    settings: LightSettings
    coarse: Floats
    brightest: Floats
    up: Array
    refractive_index: float

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        width, height = self.texture.size
        x, y = frame_from_direction(direction, width, height)
        places = texture_from_array(np.stack([x, y], axis=-1))
        shader = _program("ibl/gl/look.frag")
        for unit, (name, texture) in enumerate((("plate", self.texture), ("places", places))):
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
        target = gl_context().framebuffer([gl_context().texture(places.size, 4, dtype="f4")])
        draw_fullscreen(target, shader)
        return read_framebuffer(target, 4)[..., :3]

    def look_expanded(self, direction: Floats) -> Floats:
        """Return the expanded radiance (h, w, 3) in directions (h, w, 3)."""
        sine = elevation_sine(direction, self.up)
        return expand_samples(self.look(direction), sine, self.settings, None, self.refractive_index)


@functools.cache
def _program(fragment: str) -> moderngl.Program:
    return program(fragment=fragment)


@functools.lru_cache(maxsize=4)
def _tables(settings: LightSettings) -> tuple[moderngl.Texture, moderngl.Texture]:
    x = np.linspace(0.0, 1.0, _TABLE)
    return (
        texture_from_array(gain(x, settings)[None]),
        texture_from_array(encode(x * x, settings.transfer)[None]),
    )


def reduce_texture(
    texture: moderngl.Texture,
    settings: LightSettings,
    columns: int,
    rows: int,
    up: Array = LEVEL,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> Floats:
    """Return (rows, columns, 4): mean expanded radiance over exact solid angles, and the brightest luminance.

    Every pointwise operator; the spatial one of Kovaleski & Oliveira runs on the CPU only and leaves the plate as is.
    """
    shader = _program("ibl/gl/reduce.frag")
    gains, curve = _tables(settings)
    for unit, (name, bound) in enumerate((("plate", texture), ("gains", gains), ("curve", curve))):
        bound.use(unit)
        set_uniforms(shader, **{name: unit})
    edge, ramp = region_edge(settings, refractive_index)
    if settings.operator not in POINTWISE:
        edge, ramp = np.pi, 0.0
    set_uniforms(
        shader, expansion__luma_weight=luma_weights(settings), expansion__edge=edge, expansion__ramp=ramp,
        expansion__up=up, cells=(columns, rows),
    )  # fmt: skip
    target = gl_context().framebuffer([gl_context().texture((columns, rows), 4, dtype="f4")])
    draw_fullscreen(target, shader)
    return read_framebuffer(target, 4)


def environment_from_texture(
    texture: moderngl.Texture,
    settings: LightSettings | None = None,
    *,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> Environment:
    """Return the light of a plate held as a texture of linear RGB; as `environment`."""
    settings = settings or LightSettings()
    seen_up = upward(up)
    reduced = reduce_texture(texture, settings, COARSE_COLUMNS, COARSE_ROWS, seen_up, refractive_index)
    coarse = np.ascontiguousarray(reduced[..., :3])
    plate = TexturePlate(texture, settings, coarse, reduced[..., 3], seen_up, refractive_index)
    return light_of(plate, settings, sun, underwater, glossy)
