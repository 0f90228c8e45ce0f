# SPDX-License-Identifier: Apache-2.0
"""The picture of a stage on OpenGL 3.3, in single precision, for the thread that made its context.

The surface is an atlas of heights (`height_atlas`), in which rays are intersected. Most pixels are done with the light
on the two rays that a first hit makes, in one pass. Those whose rays meet the surface again are listed, and a second
pass follows all of their rays, by a stack of those that wait.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.errors import GlError
from mr360uw.gl.context import gl_context, per_thread, program, set_uniforms, texture_from_array
from mr360uw.surface.gl.facet_table import QUANTILES, seen_slopes
from mr360uw.surface.gl.height_atlas import HeightAtlas
from mr360uw.surface.gl.ray_tiles import split_frame
from mr360uw.surface.gl.stage_textures import stage_inputs
from mr360uw.surface.ray_stage import FAINTEST, FARTHEST_M, GENERATIONS, WIDEST, RayStage
from mr360uw.surface.sea_picture import SurfacePicture
from mr360uw.surface.slopes import FARTHEST
from mr360uw.types import Floats, Rectangle, View

if TYPE_CHECKING:
    import moderngl

_STACK = 4
"""Rays of a pixel that may wait. The brighter of two is followed first, and of those that find no room the fainter is
lost: with 3, pictures in a gale are the same to 60 dB."""
_RAYS = 32
"""Rays of a sample that are followed at most."""
_AT_ONCE = 1 << 21
"""Pixels in one draw call: 0.1 GB of targets."""
_LISTED, _LISTED_ROWS = 1024, 256
"""Listed pixels in a row of their target, and rows: 4 MB."""
_GLARE = 4.0
"""Sunlight of small waves over all other light of a sample beyond which its slopes are to be exact. Their error of 1e-3
changes it by up to 3 %; twice this value changes pictures by less than that error."""
_LIMITS = {
    "FARTHEST_M": FARTHEST_M, "FARTHEST": FARTHEST, "QUANTILES": QUANTILES, "WIDEST": WIDEST, "FAINTEST": FAINTEST,
    "GENERATIONS": GENERATIONS, "STACK": _STACK, "GLARE": _GLARE, "RAYS": _RAYS,
}  # fmt: skip
_DIRECT = {"DIRECT": 1}


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

    @property
    def made(self) -> Counter[str]:
        """How often each texture was made."""
        return self._cache.made

    def render(self, stage: RayStage, view: View, samples: int) -> SurfacePicture:
        """Return the picture, float32. samples: per pixel and axis. Raises `GlError` for a floor with relief."""
        if stage.planes:
            raise GlError("floor - OpenGL has level floors alone (got a relief) - take backend='reference'")
        gl_context().gc()
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        inputs = stage_inputs(stage, view, self._cache)
        draw = _Draw(
            self, {**inputs.textures, **self._heights.of(stage.sea), "seen_slopes": self._seen},
            inputs.uniforms, {**_LIMITS, **inputs.defines, "SAMPLES": samples}, view.width,
        )  # fmt: skip
        parts = split_frame(stage, view)
        rows = max(_AT_ONCE // view.width, 1)
        bands = [draw.band(parts, first, min(rows, view.height - first)) for first in range(0, view.height, rows)]
        radiance, lengths, normal = (np.concatenate(images) for images in zip(*bands, strict=True))
        reach = np.where(lengths[..., :2] < 0.0, np.float32(np.inf), lengths[..., :2])
        return SurfacePicture(
            radiance, reach[..., 0], reach[..., 1], normal[..., :3], lengths[..., 2] > 0.5, lengths[..., 3] > 0.5,
            stage.camera_in_water,
        )  # fmt: skip

    def target(self, name: str, count: int, width: int, rows: int) -> moderngl.Framebuffer:
        """Return a target of `count` textures, kept by its name."""

        def make() -> moderngl.Framebuffer:
            textures = [gl_context().texture((width, rows), 4, dtype="f4") for _ in range(count)]
            return gl_context().framebuffer(textures)

        return self._cache.get(name, (count, width, rows), make)

    def program(self, name: str, defines: Mapping[str, Any]) -> moderngl.Program:
        """Return a program of this folder, compiled once for its defines."""
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"surface/gl/shaders/{name}.frag", defines=defines)
        return self._programs[key]


class _Draw:
    """One picture's passes."""

    def __init__(
        self, renderer: PictureRenderer, textures: dict[str, Any], uniforms: dict[str, Any], defines: dict[str, Any],
        width: int,
    ) -> None:  # fmt: skip
        self._renderer, self._textures, self._uniforms = renderer, textures, uniforms
        self._defines, self._width = defines, width

    def band(self, parts: tuple[list[Rectangle], list[Rectangle]], first: int, rows: int) -> list[Floats]:
        """Return radiance (rows, W, 3), lengths and masks (rows, W, 4) and normals of a band of rows."""
        if self._defines["SAMPLES"] == 1:  # the samples are the pixels' centres
            images = self._passes("picture", 3, {**self._defines, "CENTRES": 1}, parts, first, rows)
        else:
            centres = {name: self._defines[name] for name in _CENTRES}
            images = self._passes("picture", 1, self._defines, parts, first, rows)
            images += self._passes("centres", 2, centres, parts, first, rows)
        radiance = images[0][..., :3].copy()
        row, column = np.nonzero(images[0][..., 3] == 0.0)
        if len(row):
            radiance[row, column] = self._listed(np.stack([column, row + first], axis=-1))
        return [radiance, *images[1:]]

    def _passes(
        self, name: str, targets: int, defines: dict[str, Any], parts: tuple[list[Rectangle], list[Rectangle]],
        first: int, rows: int,
    ) -> list[Floats]:  # fmt: skip
        target = self._renderer.target(name, targets, self._width, rows)
        target.use()
        for rectangles, kind in zip(parts, (_DIRECT, {}), strict=True):
            inside = [r for r in (_within(r, first, rows) for r in rectangles) if r.height > 0]
            if inside:
                self._fill(target, name, {**defines, **kind}, inside, float(first))
        return [_read(target, k, rows) for k in range(targets)]

    def _listed(self, places: NDArray[np.int64]) -> Floats:
        """Return the radiance (n, 3) of pixels at columns and rows (n, 2), by all of their rays."""
        target = self._renderer.target("listed", 1, _LISTED, _LISTED_ROWS)
        images = []
        for start in range(0, len(places), _LISTED * _LISTED_ROWS):
            part = places[start : start + _LISTED * _LISTED_ROWS]
            rows = -(-len(part) // _LISTED)
            table = np.zeros((rows * _LISTED, 2), np.float32)
            table[: len(part)] = part
            self._textures["listed"] = texture_from_array(table.reshape(rows, _LISTED, 2))
            target.use()
            self._fill(target, "picture", {**self._defines, "TREE": 1}, [Rectangle(0, 0, _LISTED, rows)], 0.0)
            images.append(_read(target, 0, rows).reshape(-1, 4)[: len(part), :3])
        return np.concatenate(images)

    def _fill(
        self, target: moderngl.Framebuffer, name: str, defines: Mapping[str, Any], parts: Sequence[Rectangle],
        first: float,
    ) -> None:  # fmt: skip
        shader = self._renderer.program(name, defines)
        unit = 0
        for sampler, texture in self._textures.items():
            if sampler in shader:
                texture.use(unit)
                set_uniforms(shader, **{sampler: unit})
                unit += 1
        set_uniforms(shader, **self._uniforms, first_row=first)
        triangle = gl_context().vertex_array(shader, [])
        for part in parts:
            target.viewport = part
            triangle.render(vertices=3)


_CENTRES = ("FARTHEST_M", "FARTHEST", "QUANTILES", "CAMERA_IN_WATER")


def _within(part: Rectangle, first: int, rows: int) -> Rectangle:
    """Return the part of a rectangle that lies in a band, from the band's first row."""
    top, end = max(part.row, first), min(part.row + part.height, first + rows)
    return Rectangle(part.column, top - first, part.width, max(end - top, 0))


def _read(target: moderngl.Framebuffer, attachment: int, height: int) -> Floats:
    width = target.width
    data = target.read(viewport=(0, 0, width, height), components=4, attachment=attachment, dtype="f4", alignment=1)
    return np.frombuffer(data, np.float32).reshape(height, width, 4)
