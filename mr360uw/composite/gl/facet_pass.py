# SPDX-License-Identifier: Apache-2.0
"""Triangles of a shot on OpenGL in camera axes: their vectors for ray intersection, and the pixels that each may cover.

All visible objects share one numbering of triangles. The rows of an object are redrawn only if it or the camera moved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, version
from mr360uw.composite.gl.targets import Targets, bind
from mr360uw.composite.gl.upload import MODES, MeshBuffers, cutting_maps, list_texture, texture_store
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.tiles import NEAREST
from mr360uw.errors import MeshError
from mr360uw.gl.context import gl_context, largest_texture, set_uniforms
from mr360uw.types import Floats, Rectangle

if TYPE_CHECKING:
    import moderngl

FACET_COLUMNS = 512
_FACETS = ("facet_a", "facet_b", "facet_c")
_CUTOUTS = ("cutout_a", "cutout_b", "cutout_c")
_EYES = 2
"""Targets that are kept, one of each eye."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectTriangles:
    """Triangles of objects. textures: inputs of visible.frag by name. first: number of each object's first triangle.

    numbers: (T,) of the triangles that face the camera, nearest first. kinds: (T,) indices of their alpha modes in
    `MODES`. rectangles: (T, 4) of the pixels that they may cover, as `make_blocks` takes them.
    """

    textures: dict[str, moderngl.Texture]
    first: NDArray[np.int64]
    numbers: NDArray[np.int64]
    kinds: NDArray[np.int8]
    rectangles: NDArray[np.int32]


class _Rows:
    """A target with a texel for each triangle as an eye sees it, its values read back, and the keys of the objects."""

    def __init__(self, _eye_m: float) -> None:
        self.target: moderngl.Framebuffer | None = None
        self.rectangles = np.zeros((0, 4), np.int32)
        self.kinds = np.zeros(0, np.int8)
        self.nearest = np.zeros(0, np.float32)
        self.drawn: list[object] = []

    def room(self, rows: int, masked: bool) -> moderngl.Framebuffer:
        """Return the target, made anew if it has too few rows or no attachments for masked triangles."""
        channels = (4,) * (1 + len(_FACETS)) + (1,) + (4,) * (len(_CUTOUTS) if masked else 0)
        target = self.target
        if target is not None and target.height >= rows and len(target.color_attachments) >= len(channels):
            return target
        limit = largest_texture()
        if rows > limit:
            raise MeshError(
                f"objects - too many triangles for this OpenGL (got {rows * FACET_COLUMNS / 1e6:.1f} million) - "
                f"simplify the meshes to {limit * FACET_COLUMNS / 1e6:.1f} million"
            )
        rows = max(rows, 0 if target is None else min(2 * target.height, limit))
        textures = [gl_context().texture((FACET_COLUMNS, rows), c, dtype="f4") for c in channels]
        self.target = gl_context().framebuffer(textures)
        self.rectangles = np.full((rows * FACET_COLUMNS, 4), -1, np.int32)
        self.kinds = np.zeros(rows * FACET_COLUMNS, np.int8)
        self.nearest = np.zeros(rows * FACET_COLUMNS, np.float32)
        self.drawn.clear()
        return self.target

    def read(self, targets: Targets, first: int, end: int) -> None:
        """Read rows [first, end) back from the device."""
        assert self.target is not None
        part = Rectangle(0, first, FACET_COLUMNS, end - first)
        rectangles, nearest = (targets.read(self.target, part, k) for k in (0, 1 + len(_FACETS)))
        rows = slice(first * FACET_COLUMNS, end * FACET_COLUMNS)
        self.rectangles[rows], self.nearest[rows] = rectangles.reshape(-1, 4), nearest.reshape(-1)


class FacetPass:
    """Draws triangles into one texel each. buffers: returns the device's copy of a mesh."""

    def __init__(self, targets: Targets, buffers: Callable[[Mesh], MeshBuffers], cache: Cache) -> None:
        self._targets, self._buffers, self._cache = targets, buffers, cache

    def draw(self, shot: Shot, objects: Sequence[PlacedObject]) -> ObjectTriangles:
        """Return the triangles of a shot's objects."""
        heights = [-(-len(placed.mesh.positions) // FACET_COLUMNS) for placed in objects]
        row = np.concatenate([[0], np.cumsum(heights)])
        buffers = [self._buffers(placed.mesh) for placed in objects]
        masked = tuple(
            dict.fromkeys(p.mesh.still for p, held in zip(objects, buffers, strict=True) if held.ranges["MASK"][1])
        )
        cutouts, first_map = self._cache.of(self._make_cutouts, masked)
        rows = self._cache.of(_Rows, shot.view.eye_m, keep=_EYES)
        target = rows.room(int(row[-1]), bool(masked))
        piece, changed, seen = 0, [], version((shot.view, masked))
        for k, (placed, held) in enumerate(zip(objects, buffers, strict=True)):
            now = seen, int(row[k]), piece, version(placed)
            if k >= len(rows.drawn) or rows.drawn[k] != now:
                rows.drawn[k : k + 1] = [now]
                place = int(row[k]), heights[k], piece, first_map.get(placed.mesh.still, 0)
                self._draw(shot, placed, held, target, bool(cutouts), place)
                kinds = rows.kinds[int(row[k]) * FACET_COLUMNS :]
                for kind, mode in enumerate(MODES):
                    start, count = held.ranges[mode]
                    kinds[start : start + count] = kind
                changed.append(k)
            piece += held.pieces
        if changed:
            rows.read(self._targets, int(row[changed[0]]), int(row[changed[-1] + 1]))
        used = rows.rectangles[: int(row[-1]) * FACET_COLUMNS]
        numbers = _nearest_first(np.flatnonzero(used[:, 2] >= used[:, 0]), rows.nearest)
        names = (*_FACETS, "nearest", *(_CUTOUTS if masked else ()))
        textures: dict[str, Any] = dict(zip(names, target.color_attachments[1:], strict=False))
        return ObjectTriangles(
            textures | cutouts, row[:-1] * FACET_COLUMNS, numbers, rows.kinds[numbers], used[numbers]
        )

    def _draw(
        self,
        shot: Shot,
        placed: PlacedObject,
        buffers: MeshBuffers,
        target: moderngl.Framebuffer,
        cut: bool,
        place: tuple[int, int, int, int],
    ) -> None:
        """Draw an object. cut: whether the shot has masked triangles. place: the object's first row, its rows, and the
        numbers of its first smooth piece and of its first mask map.
        """
        row, rows, piece, first_map = place
        defines: dict[str, int | float] = {"FACET_COLUMNS": FACET_COLUMNS, **of_eye(shot)}
        defines |= {"CUTOUTS": 1} if cut else {}
        defines |= {"NEAREST": NEAREST} if shot.view.eye_m else {}
        shader = self._targets.program("facets", defines)
        bind(shader, {"triangles": buffers.triangles, "materials": buffers.materials})
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = shot.view.world_from_camera.T
        set_uniforms(
            shader,
            camera_from_object=(camera_from_world @ camera_centred(placed, shot)).T,
            frame_size=(shot.view.width, shot.view.height),
            count=len(placed.mesh.positions),
            first_row=row,
            eye_m=shot.view.eye_m,
            first_piece=float(piece),
            first_map=float(first_map),
        )
        self._targets.fill(target, shader, Rectangle(0, row, FACET_COLUMNS, rows))

    def _make_cutouts(self, meshes: tuple[Mesh, ...]) -> tuple[dict[str, moderngl.Texture], dict[Mesh, int]]:
        """Return textures of the alpha of mask maps and of their entries, and the index of each mesh's first map."""
        maps = [texture for mesh in meshes for texture in cutting_maps(mesh)]
        if not maps:
            return {}, {}
        first = np.cumsum([0, *(len(cutting_maps(mesh)) for mesh in meshes)])
        store, entries = texture_store(maps, slice(3, 4))
        table = np.array([entries[texture] for texture in maps])
        textures = {"cutouts": store, "cutout_maps": list_texture(table)}
        return textures, dict(zip(meshes, first[:-1].tolist(), strict=True))


def of_eye(shot: Shot) -> dict[str, int]:
    """Return the define of shaders whose rays start on the viewing circle (eyes.glsl); none for a single camera."""
    return {"EYE": 1} if shot.view.eye_m else {}


def _nearest_first(numbers: NDArray[np.int64], nearest: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return numbers of triangles sorted by nearness (one over the distance), nearest first."""
    # positive floats sort like their bits, and one array of integers sorts faster than two
    key = ~nearest[numbers].view(np.uint32).astype(np.uint64) << np.uint64(32) | numbers.astype(np.uint64)
    key.sort()
    return (key & np.uint64(0xFFFFFFFF)).astype(np.int64)


def camera_centred(placed: PlacedObject, shot: Shot) -> Floats:
    """Return the transform (4, 4) from an object to world axes with the camera at the origin."""
    matrix = placed.world_from_object.copy()
    matrix[:3, 3] -= shot.view.position
    return matrix
