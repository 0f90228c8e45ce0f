# SPDX-License-Identifier: Apache-2.0
"""What passes keep on the device: meshes as geometry.glsl and texture.glsl read them, programs, render targets,
light.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Scratch
from mr360uw.base.caustic_lookup import mip_levels
from mr360uw.base.constants import MAXIMUM_GLOSSY_LEVELS
from mr360uw.composite.gl.light_visibility import Visibility, visibility_of
from mr360uw.composite.light_sources import lamps_of, sun_of, sun_up, widest_half_angle
from mr360uw.composite.mesh.material import MAPS, WRAPS, Material, Texture
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import Shot
from mr360uw.errors import MeshError
from mr360uw.gl import gl_context, program, set_uniforms, texture_array_from_array, texture_from_array
from mr360uw.jit import exact
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import CausticStack, Environment, Floats, MediumTable

_LIST_COLUMNS = 2048
_STORE_COLUMNS = 4096
_STORE_ALIGNMENT = 64
_NO_MAP = (-1.0, 0.0, 0.0, 0.0)
MapEntry = tuple[float, float, float, float]
"""(address / 64, width, height, wrap) of a map in its store."""
TRIANGLE_TEXELS = 11
ADDRESS_BITS = 12
"""Bits of the lower half of an address: single floats hold both halves exactly. Twin: geometry.glsl."""
SETS = 8
"""Sets of texture coordinates that a material may have: more than it has maps. Twin: geometry.glsl."""


MeshBuffers = tuple[dict[str, moderngl.Texture], dict[str, int]]
"""A mesh on the device: textures of triangles, materials and store, as geometry.glsl and texture.glsl say; and what its
materials have, as defines of shaders.
"""
StillBuffers = tuple[NDArray[np.float32], MeshBuffers]
"""What all poses of a mesh share: the texels (rows, columns, 4) of its triangles, complete but for positions and
normals, and the textures of its materials.
"""
Places = PartOf[NDArray[np.int64]]
"""Points (T, 4) of the ambient light of a mesh, as `Lattice.places` has them."""


def upload_still(mesh: Mesh, places: Places | None = None) -> StillBuffers:
    """Return what the poses of a mesh share on the device. places: its points of ambient light; None without them."""
    # Write the triangles, then their further texture coordinates
    count = len(mesh.positions)
    texels = np.zeros((count, TRIANGLE_TEXELS, 4), np.float32)
    texels[:, 0:9:3, 3], texels[:, 1:9:3, 3] = mesh.uv[..., 0], mesh.uv[..., 1]
    texels[:, 2:9:3] = mesh.colors
    texels[:, 9, 0], texels[:, 9, 1] = mesh.material, mesh.patch
    further = np.zeros((count, mesh.more_uv.shape[2], 3, 4), np.float32)
    further[..., :2] = np.swapaxes(mesh.more_uv, 1, 2)
    address = TRIANGLE_TEXELS * count + 3 * mesh.more_uv.shape[2] * np.arange(count)
    texels[:, 9, 2], texels[:, 9, 3] = np.divmod(address, 1 << ADDRESS_BITS)
    if places is not None:
        texels[:, 10] = places.whole
    # Lay out the materials and their maps
    store, entries = texture_store(texture for m in mesh.materials for texture in m.maps)
    materials = np.stack([_material_texels(m, entries) for m in mesh.materials])
    # Define every kind of map that some material has, further texture coordinates, and materials smoother than diffuse
    defines = {kind.upper(): 1 for kind in MAPS if any(getattr(m, kind) is not None for m in mesh.materials)}
    defines |= ({"MORE_UV": 1} if mesh.more_uv.shape[2] else {}) | ({"SMOOTH": 1} if mesh.glossy else {})
    return _in_rows((texels, further), 4), ({"materials": list_texture(materials), "store": store}, defines)


def upload_mesh(mesh: Mesh, places: Places | None = None, still: StillBuffers | None = None) -> MeshBuffers:
    """Return a mesh on the device. places: those of `upload_still`. still: of a pose, what it shares with others."""
    whole, (textures, defines) = upload_still(mesh, places) if still is None else still
    rows, count = whole.copy(), len(mesh.positions)
    texels = rows.reshape(-1, 4)[: TRIANGLE_TEXELS * count].reshape(-1, TRIANGLE_TEXELS, 4)
    texels[:, 0:9:3, :3], texels[:, 1:9:3, :3] = mesh.positions, mesh.normals
    return {"triangles": texture_from_array(rows), **textures}, defines


def list_texture(*parts: NDArray[Any], channels: int = 4, scratch: Scratch | None = None) -> moderngl.Texture:
    """Return a texture of values (..., channels), those of one array after the other, in rows of 2048 texels.

    scratch: for a copy of them; None takes new memory.
    """
    return texture_from_array(_in_rows(parts, channels, scratch))


def _in_rows(parts: Sequence[NDArray[Any]], channels: int, scratch: Scratch | None = None) -> NDArray[np.float32]:
    """Return the texels of `list_texture` (rows, 2048, channels), the last row filled up with zeros."""
    count = sum(map(np.size, parts))
    shape = max(-(-count // (_LIST_COLUMNS * channels)), 1), _LIST_COLUMNS, channels
    texels = np.empty(shape, np.float32) if scratch is None else scratch.floats("texels", *shape)
    flat, start = texels.reshape(-1), 0
    for part in parts:
        flat[start : start + part.size] = part.reshape(-1)
        start += part.size
    flat[start:] = 0.0
    return texels


def texture_store(textures: Iterable[Texture]) -> tuple[moderngl.Texture, dict[Texture, MapEntry]]:
    """Return all levels of textures in one texture, and each one's entry for texture.glsl.

    Raises `MeshError` if it is larger than OpenGL allows.
    """
    pieces: list[Any] = []
    entries: dict[Texture, MapEntry] = {}
    total = 0
    for texture in textures:
        if texture in entries:
            continue
        wrap = WRAPS.index(texture.wrap[0]) + 3 * WRAPS.index(texture.wrap[1])
        columns, rows = texture.size
        entries[texture] = float(total // _STORE_ALIGNMENT), float(columns), float(rows), float(wrap)
        pieces += [level.reshape(-1, 4) for level in texture.levels]
        size = sum(level.shape[0] * level.shape[1] for level in texture.levels)
        pad = -size % _STORE_ALIGNMENT
        pieces.append(np.zeros((pad, 4), np.float16))
        total += size + pad
    rows = max(-(-total // _STORE_COLUMNS), 1)
    limit = int(gl_context().info["GL_MAX_TEXTURE_SIZE"])
    if rows > limit:
        raise MeshError(
            f"textures - are too large for this OpenGL (got {total / 1e6:.0f} million texels of one mesh) - "
            f"scale them down to {limit * _STORE_COLUMNS / 1e6:.0f} million"
        )
    pieces.append(np.zeros((rows * _STORE_COLUMNS - total, 4), np.float16))
    return texture_from_array(np.concatenate(pieces).reshape(rows, _STORE_COLUMNS, 4), "f2"), entries


def _material_texels(m: Material, entries: dict[Texture, MapEntry]) -> Floats:
    maps = (m.base_map, m.metallic_roughness_map, m.normal_map, m.occlusion_map, m.emission_map)
    return np.array(
        [
            m.base_color,
            (m.metallic, m.roughness, m.normal_scale, m.occlusion_strength),
            # numbers of texture coordinates of the maps but the first, as digits
            (*m.emission, float(sum(number * SETS**place for place, number in enumerate(m.sets[1:])))),
            *(_NO_MAP if texture is None else entries[texture] for texture in maps),
            (*m.trim, m.refractive_index),
        ],
        np.float32,
    )


BLOCK = 4
"""Pixels along a block. Targets hold numbered items block by block. Twin: layer.frag."""
_LANE_COLUMNS = 256
"""Width [texels] of targets that hold numbered items."""


class Targets:
    """Compiled programs by name and defines; float targets by name and channels, which only grow."""

    def __init__(self) -> None:
        self._programs: dict[str, moderngl.Program] = {}
        self._triangles: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._targets: dict[tuple[str, tuple[int, ...]], moderngl.Framebuffer] = {}

    def shaded(
        self, name: str, defines: Mapping[str, int], textures: Mapping[str, Any], uniforms: Mapping[str, Any],
        count: int, channels: tuple[int, ...],
    ) -> NDArray[np.float32]:  # fmt: skip
        """Run composite/gl/shaders/<name>.frag, compiled once for each set of defines, on `count` numbered items.

        Returns what `items` does. textures, uniforms: by name; those that the program does not have are passed over.
        """
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"composite/gl/shaders/{name}.frag", defines=defines)
        shader, unit = self._programs[key], 0
        # Bind each texture that it uses to a unit of its own
        for texture_name, texture in textures.items():
            sampler: Any = shader.get(texture_name, None)
            if sampler is not None:
                texture.use(unit)
                sampler.value = unit
                unit += 1
        set_uniforms(shader, **uniforms, count=count)
        return self.items(shader, name, count, channels)

    def items(self, shader: moderngl.Program, name: str, count: int, channels: tuple[int, ...]) -> NDArray[np.float32]:
        """Run a full-screen program on `count` numbered items, as layer.frag numbers the texels of a kept target.

        Returns the values (count, k) of all its textures, one for each number of channels, side by side.
        """
        context, part = gl_context(), (_LANE_COLUMNS, BLOCK * -(-count // (BLOCK * _LANE_COLUMNS)))
        # Take the kept target, or a larger one
        target = self._targets.get((name, channels))
        if target is None or target.height < part[1]:
            target = context.framebuffer([context.texture(part, c, dtype="f4") for c in channels])
            self._targets[name, channels] = target
        # Draw its part that holds the items
        if shader not in self._triangles:
            self._triangles[shader] = context.vertex_array(shader, [])
        target.use()
        target.viewport = 0, 0, *part
        context.disable(context.DEPTH_TEST | context.BLEND)
        self._triangles[shader].render(vertices=3)
        # Read it back, which waits until it is drawn
        values, first = np.empty((count, sum(channels)), np.float32), 0
        for k, c in enumerate(channels):
            image = np.empty((*part[::-1], c), np.float32)
            target.read_into(image, target.viewport, c, attachment=k, dtype="f4", alignment=1)
            write_lanes(image, first, values)
            first += c
        return values


@exact
def write_lanes(image: Any, first: int, values: Any) -> None:
    """Write the texels of a target's image (h, w, c) into values (n, first + c...), from column `first` on, in the
    order of their numbers: block by block.
    """
    across = image.shape[1] // BLOCK
    for k in range(len(values)):
        block, within = k // (BLOCK * BLOCK), k % (BLOCK * BLOCK)
        row = BLOCK * (block // across) + within // BLOCK
        column = BLOCK * (block % across) + within % BLOCK
        for c in range(image.shape[2]):
            values[k, first + c] = image[row, column, c]


# --- Light of a shot ------------------------------------------------------------------------------------------------

# Light of a shot on the device: textures and uniforms of environment, water, caustics, sun and lamps; and what hides
# sun and lamps, which is found on the processor.


_ROWS_OF_BEAM = 2
"""Rows of the texture `beam` before the lamps' attenuations: the sun's beam, and what of it has not turned."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadingInputs:
    """The light of one shot on the device. textures, uniforms: by their names in shaders. defines: of these.
    visibility: of its sun and lamps.
    """

    defines: dict[str, int]
    textures: dict[str, Any]
    uniforms: dict[str, Any]
    visibility: Visibility


class ShadingTextures:
    """Makes textures and uniforms of the light of shots; unchanged textures come from the cache."""

    def __init__(self, cache: Cache) -> None:
        self._cache, self._caustics, self._scratch = cache, StackTextures(), Scratch()

    def of(self, shot: Shot) -> ShadingInputs:
        """Return the light of a shot; until the next one is asked for, whose caustics are written over its own."""
        environment, medium, stack, cache = shot.environment, shot.medium, shot.caustics, self._cache
        sun, lamps, widest = sun_of(shot), lamps_of(shot), widest_half_angle(shot)
        levels = min(len(environment.glossy), MAXIMUM_GLOSSY_LEVELS)
        # The features that shaders have
        defines: dict[str, int] = {}
        if sun is not None:
            of_sun = {
                "SUN": True, "SHADOW": len(shot.casters) > 0, "CAUSTICS": stack is not None,
                "SOFT": stack is not None and stack.soft is not None, "HALO": widest > sun.half_angle_rad,
            }  # fmt: skip
            defines = dict.fromkeys(filter(of_sun.get, of_sun), 1)
        defines |= {"MEDIUM": 1} if medium is not None else {}
        defines |= {"GLOSSY": 1} if levels else {}
        defines |= {"LAMPS": len(lamps)} if lamps else {}
        defines |= {"EYE": 1} if shot.view.eye_m else {}  # rays start on the viewing circle (eyes.glsl)
        # The camera, the environment and the sun (sun.glsl)
        roughness = np.ones(MAXIMUM_GLOSSY_LEVELS)
        roughness[:levels] = environment.glossy_roughness[:levels]
        uniforms: dict[str, Any] = {
            "view__position": shot.view.position, "view__surface_y_m": shot.view.surface_y_m,
            "world_from_camera": shot.view.world_from_camera.T, "eye_m": shot.view.eye_m,
            "frame_size": (shot.view.width, shot.view.height),
            "outside_index": shot.refractive_index, "glossy_levels": levels, "glossy_roughness": roughness,
            "sun__direction": (0.0, 1.0, 0.0),
        }  # fmt: skip
        if sun is not None:
            uniforms |= {
                "sun__irradiance": sun.irradiance, "sun__direction": sun.direction, "sun__up": sun_up(sun),
                "sun__half_angle": sun.half_angle_rad, "sun__halo_angle": widest,
            }  # fmt: skip
        # One texture of the ambient irradiance and the glossy levels after it, one of lamps (lamps.glsl)
        textures: dict[str, Any] = {"ambient": cache.of(_ambient_texture, environment)}
        if lamps:
            rows = np.zeros((len(lamps), 6, 4))
            for number, (row, lamp) in enumerate(zip(rows, lamps, strict=True)):
                row[:3, :3] = lamp.position - shot.view.position, lamp.axis, lamp.intensity
                row[0, 3], row[4:] = lamp.radius_m, lamp.beam
                row[3, :2] = _ROWS_OF_BEAM + number, nearest_m(lamp)
            textures["lamps"] = cache.of(texture_from_array, rows, keep=2)
        # The water, with the attenuation of lamps' own light
        if medium is not None:
            textures |= cache.of(_medium_textures, medium)
            uniforms |= {"medium__camera_depth_m": medium.camera_depth_m, "medium__length_m": medium.length_m}
            if lamps:
                of_lamps = (lamp.attenuation for lamp in lamps if lamp.attenuation is not None)
                beam = np.stack([medium.beam, medium.unscattered, *of_lamps])
                textures["beam"] = cache.of(texture_from_array, beam, keep=2)
        # The caustics
        if stack is not None:
            uniforms |= {"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction}
            textures |= self._caustics.of(stack)
        return ShadingInputs(defines, textures, uniforms, visibility_of(shot, cache, self._scratch))


def _ambient_texture(environment: Environment) -> moderngl.TextureArray:
    glossy = environment.glossy[:MAXIMUM_GLOSSY_LEVELS]
    return texture_array_from_array(np.stack([environment.ambient, *glossy]))


def _medium_textures(medium: MediumTable) -> dict[str, Any]:
    """Return the tables of a medium in the layout of medium/lookup.glsl, and the plate's ratio."""
    ratio = np.ones((1, 2, 3)) if medium.plate_ratio is None else medium.plate_ratio
    tables = medium.veil, medium.attenuation, medium.diffuse, np.stack([medium.beam, medium.unscattered])
    textures = dict(zip(("veil", "attenuation", "diffuse", "beam"), map(texture_from_array, tables), strict=True))
    return textures | {"plate_ratio": texture_array_from_array(ratio[None])}


# A stack of caustic maps in textures for caustic_lookup.glsl: planes in channels, mip levels below each other.

_NEW_PLANES = 3
"""New planes per layer of the atlas, in channels 1 to 3; channel 0 repeats the last plane of the layer before.

Two neighbouring planes then always share a texel.
"""


@functools.cache
def layer_planes(count: int) -> NDArray[np.int64]:
    """Return the planes (layers, 1, 2 or 4) in the channels of each layer of `count` planes; the last is repeated."""
    first = np.arange(0, max(count - 1, 1), _NEW_PLANES)
    channels = count if count < _NEW_PLANES else _NEW_PLANES + 1
    return np.minimum(first[:, None] + np.arange(channels), count - 1)


def mip_atlas(*stacks: Sequence[Floats], scratch: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
    """Return the levels (D, size, size, C) of stacks in the texture's layout, (layers C, 2 size + 2 levels, size + 2,
    1, 2 or 4).

    A pixel holds up to four planes, of one colour; colours follow each other as layers, and stacks after each other.
    The levels lie below each other, each with the pixels of its other side around it, so that one filtered fetch is
    right at its edges. They all lie in level 0 of the texture: drivers may take the level of a fetch from one pixel of
    each 2 x 2 block. scratch: an earlier atlas, written over if its shape fits: pages of new memory take longer to get
    than to fill.
    """
    count, size = stacks[0][0].shape[:2]
    planes, colours = layer_planes(count), 0
    for levels in stacks:
        colours += levels[0].shape[3]
    shape = (len(planes) * colours, 2 * size + 2 * len(stacks[0]), size + 2, planes.shape[1])
    atlas, first = (scratch if scratch is not None and scratch.shape == shape else np.zeros(shape, np.float32)), 0
    for levels in stacks:
        top, layers = 0, len(planes) * levels[0].shape[3]
        for level in levels:
            write_level(level, planes, atlas[first : first + layers], top)
            top += level.shape[1] + 2
        first += layers
    return atlas


@exact
def write_level(level: Floats, planes: NDArray[np.int64], atlas: NDArray[np.float32], top: int) -> None:
    """Write a level (D, side, side, C) with its border of one pixel into layers of an atlas, from row `top` on."""
    side, colours = level.shape[1], level.shape[3]
    for layer in range(planes.shape[0]):
        for colour in range(colours):
            for row in range(side + 2):
                j = side - 1 if row == 0 else row - 1 if row <= side else 0
                out = atlas[layer * colours + colour, top + row]
                for k in range(planes.shape[1]):
                    line = level[planes[layer, k], j]
                    for i in range(side):
                        out[i + 1, k] = line[i, colour]
                    out[0, k], out[side + 1, k] = out[side, k], out[1, k]


class StackTextures:
    """The textures of the last `CausticStack`. The next one of the same size is written over it: getting pages of new
    memory, here or on the device, takes the processor ten times as long as writing them.
    """

    def __init__(self) -> None:
        self._stack: CausticStack | None = None
        self._atlas = np.zeros((0, 0, 0, 0), np.float32)
        self._textures: dict[str, Any] = {}

    def of(self, stack: CausticStack) -> dict[str, Any]:
        """Return a stack's textures for caustic_lookup.glsl.

        caustic_ratio: its `mip_atlas`. plane_depth: (1, steps, 2) of each interval between its planes: its depth, and
        one over its width (0 for one plane).
        """
        if stack is self._stack:
            return self._textures
        # One colour for all three where they are the same, and the light that has turned
        ratio, before = np.asarray(stack.ratio, np.float32), self._atlas
        grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
        stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
        if stack.soft is not None:
            stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
        self._atlas = mip_atlas(*stacks, scratch=before)
        if self._atlas is before:
            texture = self._textures["caustic_ratio"]
            texture.write(self._atlas, alignment=1)
        else:
            texture = texture_array_from_array(self._atlas)
        # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        depth = np.asarray(stack.depth_m, np.float64)
        inverse = 1.0 / np.diff(depth) if len(depth) > 1 else np.zeros(1)
        steps = np.stack([depth[: len(inverse)], inverse], axis=-1)[None].astype(np.float32)
        self._textures = {"caustic_ratio": texture, "plane_depth": texture_from_array(steps)}
        self._stack = stack
        return self._textures
