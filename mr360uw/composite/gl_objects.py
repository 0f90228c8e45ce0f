# SPDX-License-Identifier: Apache-2.0
"""Objects on OpenGL 3.3: the samples that see them, and the light of every group of samples.

Objects that overlap in the frame share a window. Its raster holds every sample of its pixels (sampling.py); each
triangle is drawn there as its rectangle of longitudes and latitudes, and a sample keeps it where its own ray meets it:
neither the seam nor the poles are special. Then every object's pixels are lit, once for each group of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.composite.aovs import SUMS, AovFrame
from mr360uw.composite.gl_light import LightTextures
from mr360uw.composite.gl_targets import Targets, bind
from mr360uw.composite.gl_upload import MeshBuffers, write_uniform
from mr360uw.composite.material import AlphaMode
from mr360uw.composite.mesh import Mesh
from mr360uw.composite.sampling import Pattern, pattern, raster_from_frame
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.tiles import Rectangle, common_part, joined
from mr360uw.gl.context import gl_context, set_uniforms
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

BLEND_LAYERS = 4
_RASTER_SIDE = 2048
_KEPT_WINDOWS = 8


@dataclass(slots=True)
class _Raster:
    """A target that samples are drawn into. key: what it shows; None for nothing that may be used again."""

    framebuffer: moderngl.Framebuffer
    seen: moderngl.Texture
    key: object = None


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """A part of the frame and its raster: `origin` and `size` in cells; column + width may pass the seam."""

    rectangle: Rectangle
    origin: tuple[int, int]
    size: tuple[int, int]


class ObjectPass:
    """Draws and lights the objects of shots; keeps the samples of a window whose objects and camera stand still.

    buffers: gives the device's copy of a mesh.
    """

    def __init__(self, targets: Targets, light: LightTextures, buffers: Callable[[Mesh], MeshBuffers]) -> None:
        self._targets, self._light, self._buffers = targets, light, buffers
        self._rasters: dict[tuple[int, int], _Raster] = {}

    def draw(
        self, shot: Shot, parts: Sequence[Rectangle], frame: AovFrame | None
    ) -> Iterator[tuple[Rectangle, dict[str, Floats]]]:
        """Yield the rectangles of the frame that hold objects, each with its radiance, alpha and distance_m.

        parts: the rectangle of every visible object. frame: gathers output variables where they are asked for.
        """
        visible = [placed for placed in shot.objects if placed.visible]
        samples = pattern(shot.samples)
        windows = _windows(joined(parts, shot.width), samples)
        for index, window in enumerate(windows):
            radiance, alpha, distance = self._draw_window(
                shot, visible, parts, samples, window, index, keep=len(windows) <= _KEPT_WINDOWS, frame=frame
            )
            yield window.rectangle, {"radiance": radiance, "alpha": alpha, "distance_m": distance}

    def _draw_window(
        self,
        shot: Shot,
        visible: Sequence[PlacedObject],
        parts: Sequence[Rectangle],
        samples: Pattern,
        window: _Window,
        index: int,
        *,
        keep: bool,
        frame: AovFrame | None,
    ) -> tuple[Floats, Floats, Floats]:
        """Return radiance, alpha, distance of a window's pixels."""
        inside = [
            (k, placed, common)
            for k, (placed, part) in enumerate(zip(visible, parts, strict=True))
            if (common := common_part(part, window.rectangle, shot.width)) is not None
        ]
        modes = {m.alpha_mode for _, placed, _ in inside for m in placed.mesh.materials}
        layers = BLEND_LAYERS + 1 if "BLEND" in modes else 1
        first = np.concatenate([[0], np.cumsum([len(p.mesh.positions) for p in visible])])
        key = (
            window.rectangle, shot.width, shot.samples, shot.camera_position.tobytes(),
            shot.world_from_camera.tobytes(),
            tuple((id(p.mesh), p.world_from_object.tobytes(), int(first[k])) for k, p, _ in inside),
        )  # fmt: skip
        rasters = [self._raster(index if keep else 0, layer, window.size) for layer in range(layers)]
        if not keep or any(raster.key != (key, layers) for raster in rasters):
            solid = rasters[-1]
            self._draw_samples(shot, inside, first, samples, window, solid, ("OPAQUE", "MASK"))
            for layer in range(layers - 1):
                nearer = rasters[layer - 1] if layer else None
                self._draw_samples(shot, inside, first, samples, window, rasters[layer], ("BLEND",), solid, nearer)
            for raster in rasters:
                raster.key = (key, layers)
        _, _, width, height = window.rectangle
        radiance, alpha = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
        distance = np.full((height, width), np.inf, np.float32)
        for layer, raster in enumerate(rasters):
            through = 1.0 - alpha
            for k, placed, common in inside:
                if layer < layers - 1 and not any(m.alpha_mode == "BLEND" for m in placed.mesh.materials):
                    continue
                where = np.s_[common[1] : common[1] + common[3], common[0] : common[0] + common[2]]
                color, near = self._light_object(
                    shot, placed, int(first[k]), samples, window, common, raster, blended=layer < layers - 1
                )
                share = through[where]
                radiance[where] += share[..., None] * color[..., :3]
                alpha[where] += share * color[..., 3]
                distance[where] = np.minimum(distance[where], near)
                if frame is not None:
                    lit = (shot, placed, int(first[k]), samples, window, common, raster)
                    sums = [self._light_object(*lit, blended=layer < layers - 1, aovs=n) for n in (1, 2)]
                    rows = window.rectangle[1] + np.arange(height)[where[0], None]
                    columns = (window.rectangle[0] + np.arange(width)[where[1]]) % shot.width
                    for name, image in zip(SUMS, sums[0] + sums[1], strict=True):
                        frame.sums[name][rows, columns] += share[..., None] * image[..., :3]
                    part = share * color[..., 3]
                    larger = part > frame.share[rows, columns]
                    frame.share[rows, columns] = np.where(larger, part, frame.share[rows, columns])
                    frame.object_id[rows, columns] = np.where(larger, k + 1, frame.object_id[rows, columns])
        return radiance, alpha, distance

    def _draw_samples(
        self,
        shot: Shot,
        inside: Sequence[tuple[int, PlacedObject, Rectangle]],
        first: Any,
        samples: Pattern,
        window: _Window,
        raster: _Raster,
        modes: tuple[AlphaMode, ...],
        solid: _Raster | None = None,
        nearer: _Raster | None = None,
    ) -> None:
        """Fill a raster with the nearest triangles; with `solid`, those in front of it and behind `nearer`."""
        context = gl_context()
        width, height = window.size
        raster.framebuffer.use()
        raster.framebuffer.viewport = (0, 0, width, height)
        raster.framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0, viewport=(0, 0, width, height))
        column, row, columns, rows = window.rectangle
        for k, placed, _ in inside:
            buffers = self._buffers(placed.mesh)
            world = _camera_centred(placed, shot)
            for mode in modes:
                start, count = buffers.ranges[mode]
                if count == 0:
                    continue
                defines = {"MASKED": 1, "BASE_MAP": 1} if mode == "MASK" else {}
                if solid is not None:
                    defines["PEELED"] = int(nearer is not None)
                shader = self._targets.program(
                    "visible", defines, vertex="composite/visible.vert", geometry="composite/visible.geom"
                )
                textures = {"triangles": buffers.triangles, "materials": buffers.materials, "store": buffers.store}
                if solid is not None:
                    textures |= {"opaque": solid.seen, "nearer": (nearer or solid).seen}
                bind(shader, textures)
                set_uniforms(
                    shader,
                    camera_from_object=(_homogeneous(shot.world_from_camera.T) @ world).T,
                    placed_world=world.T,
                    world_from_camera=shot.world_from_camera.T,
                    frame_size=(shot.width, shot.height),
                    window=(column, row, columns, rows),
                    gaussian=(samples.a, samples.b),
                    raster_origin=window.origin,
                    raster_size=window.size,
                    first_number=float(first[k] + start + 1),
                    first_triangle=float(start),
                )
                vertex_array = context.vertex_array(shader, [(buffers.corners, "4f", "corner")])
                with context.scope(raster.framebuffer, context.DEPTH_TEST):
                    vertex_array.render(context.TRIANGLES, vertices=3 * count, first=3 * start)

    def _light_object(
        self,
        shot: Shot,
        placed: PlacedObject,
        first: int,
        samples: Pattern,
        window: _Window,
        common: Rectangle,
        raster: _Raster,
        *,
        blended: bool,
        aovs: int = 0,
    ) -> list[Floats]:
        """Return the outputs of layer.frag over a part of a window (relative to it): [(h, w, 4) radiance and alpha,
        (h, w) distance], or what `aovs` asks for.
        """
        buffers = self._buffers(placed.mesh)
        defines = {"SAMPLES": samples.count, "AOVS": aovs} | _map_defines(placed.mesh) | self._light.defines
        if shot.shading == "sample":
            defines["BY_SAMPLE"] = 1
        shader = self._targets.program("layer", defines)
        bind(
            shader,
            {
                "seen": raster.seen,
                "triangles": buffers.triangles,
                "materials": buffers.materials,
                "store": buffers.store,
                **self._light.textures,
            },
        )
        self._light.set(shader, placed.bias_m)
        write_uniform(shader, "offsets", samples.offsets.astype(np.int32))
        set_uniforms(
            shader,
            placed_world=_camera_centred(placed, shot).T,
            world_from_camera=shot.world_from_camera.T,
            frame_size=(shot.width, shot.height),
            window=window.rectangle[:2],
            gaussian=(samples.a, samples.b),
            raster_origin=window.origin,
            raster_shift=common[:2],
            numbers=(float(first), float(first + len(placed.mesh.positions))),
            blended=blended,
        )
        channels = {0: (4, 1), 1: (4,) * 5, 2: (4,) * 4}[aovs]
        self._targets.draw(shader, f"layer {aovs}", common[2], common[3], channels)
        images = self._targets.read(f"layer {aovs}", common[2], common[3])
        if aovs == 0:
            images[1] = np.where(images[0][..., 3] > 0.0, images[1][..., 0], np.float32(np.inf))
        return images

    def _raster(self, index: int, layer: int, size: tuple[int, int]) -> _Raster:
        """Return a raster of at least a size, made anew where the one there is too small."""
        kept = self._rasters.get((index, layer))
        if kept is None or kept.seen.width < size[0] or kept.seen.height < size[1]:
            had = (0, 0) if kept is None else kept.seen.size
            whole = max(-(-size[0] // 128) * 128, had[0]), max(-(-size[1] // 128) * 128, had[1])
            seen = gl_context().texture(whole, 2, dtype="f4")
            depth = gl_context().depth_renderbuffer(whole)
            kept = _Raster(gl_context().framebuffer([seen], depth), seen)
            self._rasters[index, layer] = kept
        return kept


def _map_defines(mesh: Mesh) -> dict[str, int]:
    """Return a define for every kind of map that some material of a mesh has."""
    kinds = ("base_map", "metallic_roughness_map", "normal_map", "occlusion_map", "emission_map")
    return {kind.upper(): 1 for kind in kinds if any(getattr(m, kind) is not None for m in mesh.materials)}


def _homogeneous(rotation: Floats) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def _camera_centred(placed: PlacedObject, shot: Shot) -> Floats:
    matrix = placed.world_from_object.copy()
    matrix[:3, 3] -= shot.camera_position
    return matrix


def _windows(rectangles: Sequence[Rectangle], samples: Pattern) -> list[_Window]:
    """Return windows of the frame that cover rectangles and whose rasters are not larger than a driver likes."""
    side = _RASTER_SIDE // (samples.a + samples.b)
    windows = []
    for column, row, width, height in rectangles:
        for top in range(row, row + height, side):
            for left in range(column, column + width, side):
                w, h = min(side, column + width - left), min(side, row + height - top)
                x, y = raster_from_frame(np.array([0, w, 0, w]), np.array([0, 0, h, h]), samples.a, samples.b)
                origin = int(np.floor(x.min())) - 1, int(np.floor(y.min())) - 1
                size = int(np.ceil(x.max())) + 1 - origin[0], int(np.ceil(y.max())) + 1 - origin[1]
                windows.append(_Window((left, top, w, h), origin, size))
    return windows
