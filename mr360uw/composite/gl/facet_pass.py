# SPDX-License-Identifier: Apache-2.0
"""The triangles of a shot on OpenGL as the camera sees them: what rays meet, and the pixels that each may touch.

All visible objects share one numbering of triangles. An object that stands still before the camera keeps its rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.gl.targets import Targets, bind, read_attachment
from mr360uw.composite.gl.upload import MODES, MeshBuffers, list_texture, texture_store
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.errors import MeshError
from mr360uw.gl.context import gl_context, set_uniforms
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

FACET_COLUMNS = 512
_FACETS = ("facet_a", "facet_b", "facet_c")
_CUTOUTS = ("cutout_a", "cutout_b", "cutout_c")


@dataclass(frozen=True, slots=True, eq=False)
class Facets:
    """The triangles of objects. textures: as visible.frag names them. first: number of each object's first triangle.

    numbers: (T,) of all that face the camera, the nearest first; kinds: (T,) places of their alpha modes in `MODES`;
    rectangles: (T, 4) of the pixels that they may touch, as `make_blocks` takes them.
    """

    textures: dict[str, moderngl.Texture]
    first: NDArray[np.int64]
    numbers: NDArray[np.int64]
    kinds: NDArray[np.int8]
    rectangles: NDArray[np.int32]


class FacetPass:
    """Draws triangles into one texel each. buffers: gives the device's copy of a mesh."""

    def __init__(self, targets: Targets, buffers: Callable[[Mesh], MeshBuffers]) -> None:
        self._targets, self._buffers = targets, buffers
        self._target: moderngl.Framebuffer | None = None
        self._rectangles = np.zeros((0, 4), np.int32)
        self._kinds = np.zeros(0, np.int8)
        self._nearest = np.zeros(0, np.float32)
        self._drawn: list[object] = []
        self._cutouts: tuple[tuple[Mesh, ...], dict[str, moderngl.Texture], dict[Mesh, int]] = ((), {}, {})

    def draw(self, shot: Shot, objects: Sequence[PlacedObject]) -> Facets:
        """Return the triangles of objects of a shot."""
        rows = [-(-len(placed.mesh.positions) // FACET_COLUMNS) for placed in objects]
        row = np.concatenate([[0], np.cumsum(rows)])
        masked = tuple(dict.fromkeys(p.mesh for p in objects if self._buffers(p.mesh).ranges["MASK"][1]))
        self._update_cutouts(masked)
        target = self._room(int(row[-1]), bool(masked))
        view = (shot.width, shot.height, shot.camera_position.tobytes(), shot.world_from_camera.tobytes())
        piece, changed = 0, []
        for k, placed in enumerate(objects):
            first_map = self._cutouts[2].get(placed.mesh, 0)
            key = (view, int(row[k]), piece, first_map, placed.mesh, placed.world_from_object.tobytes())
            if k >= len(self._drawn) or self._drawn[k] != key:
                self._drawn[k : k + 1] = [key]
                self._draw(shot, placed, target, int(row[k]), rows[k], piece)
                changed.append(k)
            piece += self._buffers(placed.mesh).pieces
        if changed:
            self._read(target, int(row[changed[0]]), int(row[changed[-1] + 1]))
        used = self._rectangles[: int(row[-1]) * FACET_COLUMNS]
        numbers = _nearest_first(np.flatnonzero(used[:, 2] >= used[:, 0]), self._nearest)
        names = (*_FACETS, "nearest", *(_CUTOUTS if masked else ()))
        textures: dict[str, Any] = dict(zip(names, target.color_attachments[1:], strict=False))
        return Facets(
            textures | self._cutouts[1], row[:-1] * FACET_COLUMNS, numbers, self._kinds[numbers], used[numbers]
        )

    def _draw(
        self, shot: Shot, placed: PlacedObject, target: moderngl.Framebuffer, row: int, rows: int, piece: int
    ) -> None:
        buffers = self._buffers(placed.mesh)
        defines = {"FACET_COLUMNS": FACET_COLUMNS} | ({"CUTOUTS": 1} if self._cutouts[0] else {})
        shader = self._targets.program("facets", defines)
        bind(shader, {"triangles": buffers.triangles, "materials": buffers.materials})
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = shot.world_from_camera.T
        set_uniforms(
            shader,
            camera_from_object=(camera_from_world @ camera_centred(placed, shot)).T,
            frame_size=(shot.width, shot.height),
            count=len(placed.mesh.positions),
            first_row=row,
            first_piece=float(piece),
            first_map=float(self._cutouts[2].get(placed.mesh, 0)),
        )
        self._targets.fill(target, shader, (0, row, FACET_COLUMNS, rows))
        kinds = self._kinds[row * FACET_COLUMNS :]
        for kind, mode in enumerate(MODES):
            start, count = buffers.ranges[mode]
            kinds[start : start + count] = kind

    def _read(self, target: moderngl.Framebuffer, first: int, end: int) -> None:
        part, rows = (0, first, FACET_COLUMNS, end - first), slice(first * FACET_COLUMNS, end * FACET_COLUMNS)
        self._rectangles[rows] = read_attachment(target, 0, part).reshape(-1, 4)
        self._nearest[rows] = read_attachment(target, 1 + len(_FACETS), part).reshape(-1)

    def _room(self, rows: int, masked: bool) -> moderngl.Framebuffer:
        """Return the target, made anew where it is too small or has no place for cut-outs."""
        kept = self._target
        channels = (4,) * (1 + len(_FACETS)) + (1,) + (4,) * (len(_CUTOUTS) if masked else 0)
        if kept is None or kept.height < rows or len(kept.color_attachments) < len(channels):
            limit = int(gl_context().info["GL_MAX_TEXTURE_SIZE"])
            if rows > limit:
                raise MeshError(
                    f"objects - too many triangles for this OpenGL (got {rows * FACET_COLUMNS / 1e6:.1f} million) - "
                    f"simplify the meshes to {limit * FACET_COLUMNS / 1e6:.1f} million"
                )
            rows = min(max(rows, 0 if kept is None else 2 * kept.height), limit)
            textures = [gl_context().texture((FACET_COLUMNS, rows), c, dtype="f4") for c in channels]
            kept = self._target = gl_context().framebuffer(textures)
            self._rectangles = np.full((rows * FACET_COLUMNS, 4), -1, np.int32)
            self._kinds = np.zeros(rows * FACET_COLUMNS, np.int8)
            self._nearest = np.zeros(rows * FACET_COLUMNS, np.float32)
            self._drawn.clear()
        return kept

    def _update_cutouts(self, meshes: tuple[Mesh, ...]) -> None:
        """Bring the alpha of all maps that cut to one texture, and each mesh's first number among them."""
        if self._cutouts[0] == meshes:
            return
        maps = [texture for mesh in meshes for texture in self._buffers(mesh).cut_maps]
        counts = [len(self._buffers(mesh).cut_maps) for mesh in meshes]
        first = np.cumsum([0, *counts])
        store, entries = texture_store(maps, slice(3, 4))
        table = np.array([entries[id(texture)] for texture in maps])
        textures = {"cutouts": store, "cutout_maps": list_texture(table)}
        self._cutouts = meshes, textures if meshes else {}, dict(zip(meshes, first[:-1].tolist(), strict=True))
        self._drawn.clear()


def _nearest_first(numbers: NDArray[np.int64], nearest: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return numbers of triangles in order of falling nearness."""
    # positive floats sort like their bits, and one array of integers sorts faster than two
    key = ~nearest[numbers].view(np.uint32).astype(np.uint64) << np.uint64(32) | numbers.astype(np.uint64)
    key.sort()
    return (key & np.uint64(0xFFFFFFFF)).astype(np.int64)


def camera_centred(placed: PlacedObject, shot: Shot) -> Floats:
    """Return the matrix (4, 4) from an object to the camera's place, in the world's axes."""
    matrix = placed.world_from_object.copy()
    matrix[:3, 3] -= shot.camera_position
    return matrix
