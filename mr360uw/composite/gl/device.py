# SPDX-License-Identifier: Apache-2.0
"""What passes keep on the device: meshes as geometry.glsl and texture.glsl read them, programs, render targets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import PartOf, Scratch
from mr360uw.composite.mesh.material import MAPS, Material
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.mesh.texture import WRAPS, Texture
from mr360uw.errors import MeshError
from mr360uw.gl.context import gl_context, largest_texture, program, set_uniforms, texture_from_array
from mr360uw.jit import exact
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl


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


@dataclass(frozen=True, slots=True, eq=False)
class MeshBuffers:
    """A mesh on the device. textures: triangles, materials and store, as geometry.glsl and texture.glsl say. defines:
    of shaders, by what its materials have.
    """

    textures: dict[str, moderngl.Texture]
    defines: dict[str, int]


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
    shared = MeshBuffers({"materials": list_texture(materials), "store": store}, defines)
    return _in_rows((texels, further), 4, Scratch()), shared


def upload_mesh(mesh: Mesh, places: Places | None = None, still: StillBuffers | None = None) -> MeshBuffers:
    """Return a mesh on the device. places: those of `upload_still`. still: of a pose, what it shares with others."""
    whole, shared = upload_still(mesh, places) if still is None else still
    rows, count = whole.copy(), len(mesh.positions)
    texels = rows.reshape(-1, 4)[: TRIANGLE_TEXELS * count].reshape(-1, TRIANGLE_TEXELS, 4)
    texels[:, 0:9:3, :3], texels[:, 1:9:3, :3] = mesh.positions, mesh.normals
    return MeshBuffers({"triangles": texture_from_array(rows), **shared.textures}, shared.defines)


def list_texture(*parts: NDArray[Any], channels: int = 4, scratch: Scratch | None = None) -> moderngl.Texture:
    """Return a texture of values (..., channels), those of one array after the other, in rows of 2048 texels.

    scratch: for a copy of them; None takes new memory.
    """
    return texture_from_array(_in_rows(parts, channels, Scratch() if scratch is None else scratch))


def _in_rows(parts: Sequence[NDArray[Any]], channels: int, scratch: Scratch) -> NDArray[np.float32]:
    """Return the texels of `list_texture` (rows, 2048, channels), the last row filled up with zeros."""
    count = sum(map(np.size, parts))
    rows = max(-(-count // (_LIST_COLUMNS * channels)), 1)
    texels = scratch.floats("texels", rows, _LIST_COLUMNS, channels)
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
    limit = largest_texture()
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
            (*m.emission, float(_packed(m.sets))),
            *(_NO_MAP if texture is None else entries[texture] for texture in maps),
            (*m.trim, m.refractive_index),
        ],
        np.float32,
    )


def _packed(sets: Sequence[int]) -> int:
    """Return the numbers of texture coordinates of the maps but the first as digits of base `SETS`, as geometry.glsl
    reads them.
    """
    return sum(number * SETS**place for place, number in enumerate(sets[1:]))


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
