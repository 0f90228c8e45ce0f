# SPDX-License-Identifier: Apache-2.0
"""The layer of a frame on OpenGL 3.3: the same samples, groups and light as the reference renderer.

Objects that overlap in the frame share a window. Its raster holds every sample of its pixels (sampling.py); each
triangle is drawn there as its rectangle of longitudes and latitudes, and a sample keeps it where its own ray meets it:
neither the seam nor the poles are special. Then every object's pixels are lit, once for each group of samples, and
only they are read back. What has not changed since the frame before is kept: meshes, shadow maps, and the samples of a
window whose objects and camera stand still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.composite.aovs import SUMS, AovFrame, Aovs
from mr360uw.composite.geometry import object_rectangles
from mr360uw.composite.gl_light import LightTextures
from mr360uw.composite.gl_upload import MeshBuffers, upload_mesh, write_uniform
from mr360uw.composite.holdout import hold_out
from mr360uw.composite.material import AlphaMode
from mr360uw.composite.mesh import Mesh
from mr360uw.composite.over import empty_tile
from mr360uw.composite.receiver import (
    CoarseGrid,
    ReceiverShape,
    coarse_grid,
    receiver_rectangles,
    shadow_rectangles,
)
from mr360uw.composite.sampling import Pattern, pattern, raster_from_frame
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.tiles import Rectangle, even_tiles, joined
from mr360uw.gl.context import draw_fullscreen, gl_context, program, set_uniforms, texture_from_array
from mr360uw.types import Floats, Layer, Tile

if TYPE_CHECKING:
    import moderngl

BLEND_LAYERS = 4
_RASTER_SIDE = 2048
_STRIDE = 4
"""What bodies keep off a receiver is found at every so many pixels, and between where it varies."""
_KEPT_WINDOWS = 8
_KEPT_MESHES = 64


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


class LayerRenderer:
    """Draws shots; keeps on the device what the next one can use. One for each OpenGL thread."""

    def __init__(self) -> None:
        self._programs: dict[str, moderngl.Program] = {}
        self._meshes: dict[Mesh, MeshBuffers] = {}
        self._rasters: dict[tuple[int, int], _Raster] = {}
        self._targets: dict[str, moderngl.Framebuffer] = {}
        self._light = LightTextures()
        self._shape: tuple[object, ReceiverShape] | None = None
        self._grid: tuple[object, CoarseGrid] | None = None
        self._receiver_maps: dict[object, moderngl.Texture] = {}

    def render(self, shot: Shot) -> Layer:
        """Return the layer of a shot, as `reference.render_layer` does."""
        return self._render(shot, None)

    def render_aovs(self, shot: Shot) -> tuple[Layer, Aovs]:
        """Return the layer of a shot and its output variables, as `reference.render_aovs` does."""
        frame = AovFrame(shot)
        layer = self._render(shot, frame)
        return layer, frame.finish(shot, layer)

    def _render(self, shot: Shot, frame: AovFrame | None) -> Layer:
        gl_context().gc()
        shape = self._receiver_shape(shot)
        object_parts = object_rectangles(shot)
        receiver_parts = receiver_rectangles(shot, self._coarse_grid(shot, shape)) if shape is not None else []
        tiles = even_tiles(object_parts + receiver_parts, shot.width, shot.height)
        if not tiles:
            return Layer(shot.height, shot.width, ())
        self._light.update(shot, self._buffers)
        drawn = [empty_tile(c, r, h, w) for c, r, w, h in tiles]
        visible = [placed for placed in shot.objects if placed.visible]
        samples = pattern(shot.samples)
        windows = _windows(joined(object_parts, shot.width), samples)
        for index, window in enumerate(windows):
            image = self._draw_window(
                shot, visible, object_parts, samples, window, index, keep=len(windows) <= _KEPT_WINDOWS, frame=frame
            )
            _paste(drawn, window.rectangle, shot.width, radiance=image[0], alpha=image[1], distance_m=image[2])
        shadow_parts = shadow_rectangles(shot, self._coarse_grid(shot, shape)) if shape is not None else []
        for rectangle in joined(receiver_parts, shot.width):
            assert shape is not None
            ratio, veil = self._draw_receiver(shot, shape, rectangle, shadow_parts)
            _paste(drawn, rectangle, shot.width, ratio=ratio, veil=veil)
        return Layer(shot.height, shot.width, tuple(hold_out(shot, tile) for tile in drawn))

    # --- objects ---------------------------------------------------------------------------------------------------

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
            if (common := _common(part, window.rectangle, shot.width)) is not None
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
                shader = self._program(
                    "visible", defines, vertex="composite/visible.vert", geometry="composite/visible.geom"
                )
                textures = {"triangles": buffers.triangles, "materials": buffers.materials, "store": buffers.store}
                if solid is not None:
                    textures |= {"opaque": solid.seen, "nearer": (nearer or solid).seen}
                _bind(shader, textures)
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
        shader = self._program("layer", defines)
        _bind(
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
        self._draw(shader, f"layer {aovs}", common[2], common[3], channels)
        images = self._read(f"layer {aovs}", common[2], common[3])
        if aovs == 0:
            images[1] = np.where(images[0][..., 3] > 0.0, images[1][..., 0], np.float32(np.inf))
        return images

    # --- receivers -------------------------------------------------------------------------------------------------

    def _receiver_shape(self, shot: Shot) -> ReceiverShape | None:
        if shot.receiver is None:
            return None
        key = (id(shot.receiver), shot.camera_position.tobytes())
        if self._shape is None or self._shape[0] != key:
            self._shape = key, ReceiverShape(shot.receiver, shot.camera_position)
            self._receiver_maps.clear()
        return self._shape[1]

    def _coarse_grid(self, shot: Shot, shape: ReceiverShape) -> CoarseGrid:
        key = (id(shape), shot.width, shot.height, shot.world_from_camera.tobytes(), id(shot.medium))
        if self._grid is None or self._grid[0] != key:
            self._grid = key, coarse_grid(shot, shape)
        return self._grid[1]

    def _draw_receiver(
        self, shot: Shot, shape: ReceiverShape, rectangle: Rectangle, shadow_parts: Sequence[Rectangle]
    ) -> tuple[Floats, Floats]:
        """Return ratio and veil of a rectangle of the frame; the sun's shadow is looked for in `shadow_parts` only."""
        assert shot.receiver is not None
        column, row, width, height = rectangle
        key = (rectangle, shot.width, shot.height, shot.world_from_camera.tobytes())
        if key not in self._receiver_maps:
            if len(self._receiver_maps) > _KEPT_WINDOWS:
                self._receiver_maps.clear()
            x, y = column + np.arange(width) + 0.5, (row + np.arange(height) + 0.5)[:, None]
            distance, normal = shape.meet(shot, x, y)
            place = np.where(np.isfinite(distance), distance, 0.0)[..., None]
            self._receiver_maps[key] = texture_from_array(np.concatenate([normal, place], axis=-1))
        unwanted = {"SHADOW": not shot.receiver.shadow, "CAUSTICS": not shot.receiver.caustics}
        defines = {name for name in self._light.defines if not unwanted.get(name)}
        view = {
            "world_from_camera": shot.world_from_camera.T, "frame_size": (shot.width, shot.height),
            "window": (column, row), "surfel_count": self._light.surfels,
        }  # fmt: skip
        textures = {"shape": self._receiver_maps[key], **self._light.textures}
        if shot.receiver.occlusion and self._light.surfels:
            defines.add("OCCLUSION")
        wide = width // _STRIDE + 2, height // _STRIDE + 2
        coarse = self._program(
            "coarse", dict.fromkeys(defines & {"OCCLUSION", "SHADOW", "SUN"}, 1) | {"STRIDE": _STRIDE}
        )
        _bind(coarse, textures)
        self._light.set(coarse, 0.0)
        set_uniforms(coarse, last=(width - 1, height - 1), **view)
        textures["coarse"] = self._draw(coarse, "coarse", *wide, (2,))
        shadowed = [part for p in shadow_parts if (part := _common(p, rectangle, shot.width)) is not None]
        areas = [(defines - {"SHADOW"}, (0, 0, width, height))]
        areas += [(defines, part) for part in shadowed if "SHADOW" in defines]
        for wanted, part in areas:
            shader = self._program("receiver", dict.fromkeys(wanted, 1) | {"STRIDE": _STRIDE})
            _bind(shader, textures)
            self._light.set(shader, 0.0)
            set_uniforms(shader, **view)
            self._draw(shader, "receiver", width, height, (4, 4), part)
        ratio, veil = self._read("receiver", width, height)
        return ratio[..., :3], veil[..., :3]

    # --- what is kept ----------------------------------------------------------------------------------------------

    def _buffers(self, mesh: Mesh) -> MeshBuffers:
        if mesh not in self._meshes:
            if len(self._meshes) >= _KEPT_MESHES:
                self._meshes.pop(next(iter(self._meshes)))
            self._meshes[mesh] = upload_mesh(mesh)
        return self._meshes[mesh]

    def _program(self, name: str, defines: dict[str, int], **stages: str) -> moderngl.Program:
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"composite/{name}.frag", defines=defines, **stages)
        return self._programs[key]

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

    def _draw(
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

    def _read(self, name: str, width: int, height: int) -> list[Floats]:
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


def _bind(shader: moderngl.Program, textures: dict[str, Any]) -> None:
    """Bind the textures that a program uses, each to a unit of its own."""
    unit = 0
    for name, texture in textures.items():
        if name in shader:
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
            unit += 1


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


def _common(part: Rectangle, window: Rectangle, frame_width: int) -> Rectangle | None:
    """Return the part of a window that a rectangle covers, relative to the window; both may pass the seam."""
    top, bottom = max(part[1], window[1]), min(part[1] + part[3], window[1] + window[3])
    spans = [
        (max(part[0] + k, window[0]), min(part[0] + k + part[2], window[0] + window[2]))
        for k in (-frame_width, 0, frame_width)
    ]
    spans = [(a, b) for a, b in spans if a < b]
    if not spans or top >= bottom:
        return None
    left, right = min(a for a, _ in spans), max(b for _, b in spans)
    return left - window[0], top - window[1], right - left, bottom - top


def _paste(tiles: Sequence[Tile], rectangle: Rectangle, frame_width: int, **images: Floats) -> None:
    """Write images of a rectangle, which may pass the seam, into the tiles that it touches."""
    column, row, width, height = rectangle
    for tile in tiles:
        rows, columns = tile.alpha.shape
        r0, r1 = max(row, tile.row), min(row + height, tile.row + rows)
        for turn in (-frame_width, 0, frame_width):
            c0, c1 = max(column + turn, tile.column), min(column + turn + width, tile.column + columns)
            if r0 >= r1 or c0 >= c1:
                continue
            to = np.s_[r0 - tile.row : r1 - tile.row, c0 - tile.column : c1 - tile.column]
            source = np.s_[r0 - row : r1 - row, c0 - column - turn : c1 - column - turn]
            for name, image in images.items():
                getattr(tile, name)[to] = image[source]
