# SPDX-License-Identifier: Apache-2.0
"""The picture of a stage on OpenGL 3.3, in single precision, for the thread that made its context.

The surface is an atlas of heights (`height_atlas`), in which rays are intersected. One full-screen pass follows the
tree of rays of every pixel with a stack of those that wait; another meets the rays through the pixels' centres.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.cache import Cache
from mr360uw.gl.context import (
    gl_context,
    per_thread,
    program,
    set_uniforms,
    texture_from_array,
)
from mr360uw.surface.gl.facet_table import QUANTILES, seen_slopes
from mr360uw.surface.gl.height_atlas import HeightAtlas
from mr360uw.surface.gl.stage_textures import stage_inputs
from mr360uw.surface.ray_tree import FAINTEST, FARTHEST_M, GENERATIONS, WIDEST, Stage
from mr360uw.surface.sea_picture import SurfacePicture
from mr360uw.surface.slopes import FARTHEST
from mr360uw.types import Floats, View

if TYPE_CHECKING:
    import moderngl

_STACK = 4
"""Rays of a pixel that may wait. The brighter of two is followed first, and of those that find no room the fainter is
lost: with 3, pictures in a gale are the same to 60 dB."""
_RAYS = 32
"""Rays of a sample that are followed at most."""
_AT_ONCE = 1 << 21
"""Pixels in one draw call: 0.1 GB of targets."""
_LIMITS = {
    "FARTHEST_M": FARTHEST_M, "FARTHEST": FARTHEST, "QUANTILES": QUANTILES, "WIDEST": WIDEST, "FAINTEST": FAINTEST,
    "GENERATIONS": GENERATIONS, "STACK": _STACK, "RAYS": _RAYS,
}  # fmt: skip


@per_thread
def picture_renderer() -> PictureRenderer:
    """Return this thread's renderer, made at the first call; raise `GlError` where there is no OpenGL 3.3."""
    return PictureRenderer()


class PictureRenderer:
    """Renders pictures; keeps programs, and the textures of what has not changed since the picture before."""

    def __init__(self) -> None:
        self._cache = Cache()
        self._heights = HeightAtlas()
        self._seen = texture_from_array(seen_slopes(), nearest=False)
        self._programs: dict[str, moderngl.Program] = {}

    def render(self, stage: Stage, view: View, samples: int) -> SurfacePicture:
        """Return the picture, float32. samples: per pixel and axis."""
        gl_context().gc()
        inputs = stage_inputs(stage, view, self._cache)
        textures = {**inputs.textures, **self._heights.of(stage.sea), "seen_slopes": self._seen}
        centres = self._program("centres", {"FARTHEST_M": FARTHEST_M})
        picture = self._program("picture", {**_LIMITS, **inputs.defines, "SAMPLES": samples})
        rows = max(_AT_ONCE // view.width, 1)
        parts: list[list[Floats]] = []
        for first in range(0, view.height, rows):
            count = min(rows, view.height - first)
            images = []
            for shader, targets in ((picture, 1), (centres, 2)):
                bind(shader, textures)
                set_uniforms(shader, **inputs.uniforms, first_row=float(first))
                images += self._drawn(shader, targets, view.width, count)
            parts.append(images)
        radiance, lengths, normal = (np.concatenate(images) for images in zip(*parts, strict=True))
        reach = np.where(lengths[..., :2] < 0.0, np.float32(np.inf), lengths[..., :2])
        return SurfacePicture(
            radiance[..., :3], reach[..., 0], reach[..., 1], normal[..., :3], lengths[..., 2] > 0.5,
            lengths[..., 3] > 0.5, stage.camera_in_water,
        )  # fmt: skip

    def _drawn(self, shader: moderngl.Program, targets: int, width: int, rows: int) -> list[Floats]:
        target = self._cache.get(
            f"targets {targets}", (width, rows),
            lambda: gl_context().framebuffer([gl_context().texture((width, rows), 4, dtype="f4") for _ in range(targets)]),
        )  # fmt: skip
        target.use()
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        gl_context().vertex_array(shader, []).render(vertices=3)
        images = []
        for k in range(targets):
            data = target.read(components=4, attachment=k, dtype="f4", alignment=1)
            images.append(np.frombuffer(data, np.float32).reshape(rows, width, 4))
        return images

    def _program(self, name: str, defines: Mapping[str, Any]) -> moderngl.Program:
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"surface/gl/shaders/{name}.frag", defines=defines)
        return self._programs[key]


def bind(shader: moderngl.Program, textures: Mapping[str, Any]) -> None:
    """Bind the textures that a program uses, each to a unit of its own."""
    unit = 0
    for name, texture in textures.items():
        if name in shader:
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
            unit += 1
