# SPDX-License-Identifier: Apache-2.0
"""Meshes and light as textures and buffers, in the layouts that geometry.glsl and light.glsl read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.material import AlphaMode, Material
from mr360uw.composite.mesh import Mesh
from mr360uw.composite.texture import WRAPS, Texture
from mr360uw.errors import MeshError
from mr360uw.gl.context import gl_context, texture_from_array
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

_LIST_COLUMNS = 2048
_STORE_COLUMNS = 4096
_STORE_ALIGNMENT = 64
_MODES: tuple[AlphaMode, ...] = ("OPAQUE", "MASK", "BLEND")


@dataclass(frozen=True, slots=True, eq=False)
class MeshBuffers:
    """A mesh on the device, triangles ordered by alpha mode.

    corners: one vec4 a corner, (position, 1 where both sides are drawn). ranges: (first, count) triangles of each mode.
    triangles, materials, store: as geometry.glsl and texture.glsl say.
    """

    mesh: Mesh
    corners: moderngl.Buffer
    ranges: dict[AlphaMode, tuple[int, int]]
    triangles: moderngl.Texture
    materials: moderngl.Texture
    store: moderngl.Texture


def upload_mesh(mesh: Mesh) -> MeshBuffers:
    """Return a mesh on the device."""
    mode = np.array([_MODES.index(m.alpha_mode) for m in mesh.materials])[mesh.material]
    order = np.argsort(mode, kind="stable")
    counts = np.bincount(mode, minlength=3)
    ranges = {name: (int(counts[:k].sum()), int(counts[k])) for k, name in enumerate(_MODES)}
    two_sided = np.array([m.double_sided for m in mesh.materials])[mesh.material[order]]
    corners = np.empty((len(order), 3, 4), np.float32)
    corners[..., :3], corners[..., 3] = mesh.positions[order], two_sided[:, None]
    texels = np.zeros((len(order), 10, 4), np.float32)
    texels[:, 0:9:3, :3], texels[:, 0:9:3, 3] = mesh.positions[order], mesh.uv[order, :, 0]
    texels[:, 1:9:3, :3], texels[:, 1:9:3, 3] = mesh.normals[order], mesh.uv[order, :, 1]
    texels[:, 2:9:3] = mesh.colors[order]
    texels[:, 9, 0], texels[:, 9, 1] = mesh.material[order], mesh.patch[order]
    store, address = _store(mesh.materials)
    materials = np.stack([_material_texels(m, address) for m in mesh.materials])
    return MeshBuffers(
        mesh=mesh,
        corners=gl_context().buffer(corners.tobytes()),
        ranges=ranges,
        triangles=list_texture(texels),
        materials=list_texture(materials),
        store=store,
    )


def list_texture(texels: Floats) -> moderngl.Texture:
    """Return a texture of texels (..., 4) in rows of 2048."""
    flat = np.asarray(texels, np.float32).reshape(-1, 4)
    rows = -(-len(flat) // _LIST_COLUMNS)
    padded = np.zeros((rows * _LIST_COLUMNS, 4), np.float32)
    padded[: len(flat)] = flat
    return texture_from_array(padded.reshape(rows, _LIST_COLUMNS, 4))


def _store(materials: tuple[Material, ...]) -> tuple[moderngl.Texture, dict[int, int]]:
    """Return all levels of all maps in one texture, and the address of each map by its identity."""
    maps: dict[int, Texture] = {}
    for m in materials:
        for texture in (m.base_map, m.metallic_roughness_map, m.normal_map, m.occlusion_map, m.emission_map):
            if texture is not None:
                maps[id(texture)] = texture
    pieces: list[Any] = []
    address: dict[int, int] = {}
    total = 0
    for key, texture in maps.items():
        address[key] = total // _STORE_ALIGNMENT
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
    return texture_from_array(np.concatenate(pieces).reshape(rows, _STORE_COLUMNS, 4), "f2"), address


def _material_texels(m: Material, address: dict[int, int]) -> Floats:
    def entry(texture: Texture | None) -> tuple[float, float, float, float]:
        if texture is None:
            return -1.0, 0.0, 0.0, 0.0
        wrap = WRAPS.index(texture.wrap[0]) + 3 * WRAPS.index(texture.wrap[1])
        return float(address[id(texture)]), float(texture.size[0]), float(texture.size[1]), float(wrap)

    return np.array(
        [
            m.base_color,
            (m.metallic, m.roughness, m.normal_scale, m.occlusion_strength),
            (*m.emission, 0.0),
            (m.alpha_cutoff, 0.0, m.refractive_index, 0.0),
            entry(m.base_map),
            entry(m.metallic_roughness_map),
            entry(m.normal_map),
            entry(m.occlusion_map),
            entry(m.emission_map),
        ],
        np.float32,
    )


def write_uniform(shader: moderngl.Program, name: str, values: NDArray[Any]) -> None:
    """Set an array of numbers or vectors, float32 or int32; a name the compiler removed is passed over."""
    import moderngl

    uniform = shader.get(name, None)
    if isinstance(uniform, moderngl.Uniform):
        uniform.write(np.ascontiguousarray(values).tobytes())
