# SPDX-License-Identifier: Apache-2.0
"""Triangles of a shot on OpenGL in camera axes: their vectors for ray intersection, and lists of those that may cover
each block of 4 x 4 pixels.

All visible objects share one numbering of triangles. The rows of an object are redrawn only if it or the camera moved.
A block lists the triangles whose rectangles of the frame overlap it, with a mask of the overlapped pixels; blocks
without triangles are left out. A rectangle may cross the seam or run around the whole frame, so neither the seam nor
the poles are special. The device reads the lists with blocks.glsl.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, version
from mr360uw.composite.gl.targets import BLOCK, Targets, bind
from mr360uw.composite.gl.upload import MODES, MeshBuffers, cutting_maps, list_texture, texture_store
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.tiles import NEAREST
from mr360uw.errors import MeshError
from mr360uw.gl.context import gl_context, largest_texture, set_uniforms
from mr360uw.jit import exact
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


KINDS = 3
"""Kinds of triangles: opaque, masked, blended, in this order in every list."""

# sort key: (block, kind, position of the triangle, mask) in the bits of one integer, the first highest
_MASK_BITS, _PLACE_BITS, _KIND_BITS = 16, 23, 2
_KIND_AT = _MASK_BITS + _PLACE_BITS
_BLOCK_AT = _KIND_AT + _KIND_BITS
MOST_TRIANGLES = 1 << _PLACE_BITS
_ROW_STARTS = np.array([0x0000, 0x0001, 0x0011, 0x0111, 0x1111], np.int32)
"""The first bit of each of the first k rows of a block."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """n blocks of pixels and their lists, row by row.

    corner: (n, 2) column and row of the first pixel. bounds: (n, 4) indices into `members`: begin and end of a block's
    opaque triangles, end of the masked and end of the blended ones that follow. members: (m,) numbers of triangles, in
    their given order within each kind. masks: (m,) a bit for each pixel of the block that the triangle may cover, row
    by row.
    """

    corner: NDArray[np.int64]
    bounds: NDArray[np.int64]
    members: NDArray[np.integer]
    masks: NDArray[np.int32]

    def some(self, which: slice | NDArray[np.bool_]) -> Blocks:
        """Return some of the blocks, with the same members."""
        return replace(self, corner=self.corner[which], bounds=self.bounds[which])

    def pixels(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns (16 n,) of all pixels, block by block; some may lie beyond the frame."""
        at = np.arange(BLOCK * BLOCK)
        return (self.corner[:, 1:] + at // BLOCK).ravel(), (self.corner[:, :1] + at % BLOCK).ravel()


def make_blocks(
    rectangles: NDArray[np.integer], numbers: NDArray[np.integer], kinds: NDArray[np.integer], width: int
) -> Blocks:
    """Return the blocks that triangles may cover.

    rectangles: (T, 4) first column, first row, last column, last row of pixels; columns start inside the frame and may
    run beyond it, around the seam. numbers, kinds: (T,), T up to `MOST_TRIANGLES`.
    """
    across = -(-width // BLOCK)
    left, top, right, bottom = np.ascontiguousarray(rectangles.T, np.int32)
    places = np.arange(len(left))
    over = np.flatnonzero(right >= width)
    if len(over):  # rectangles across the seam continue at column 0
        top, bottom, places, kinds = (np.concatenate([a, a[over]]) for a in (top, bottom, places, kinds))
        left = np.concatenate([left, np.zeros(len(over), np.int32)])
        right = np.concatenate([np.minimum(right, width - 1), right[over] - width])
    meetings = (right // BLOCK - left // BLOCK + 1) * (bottom // BLOCK - top // BLOCK + 1)
    begin = np.cumsum(meetings, dtype=np.int64) - meetings
    key = np.empty(int(meetings.sum(dtype=np.int64)), np.uint64)
    code = (kinds.astype(np.uint64) << np.uint64(_KIND_AT)) | (places.astype(np.uint64) << np.uint64(_MASK_BITS))
    _set_keys(left, top, right, bottom, code, begin, across, key)
    key.sort()
    block = (key >> np.uint64(_BLOCK_AT)).astype(np.int64)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    there = block[first]
    bounds = np.empty((len(first), 1 + KINDS), np.int64)
    bounds[:, 0], bounds[:, KINDS] = first, np.append(first[1:], len(key))
    for kind in range(1, KINDS):
        least = (there << _KIND_BITS | kind).astype(np.uint64) << np.uint64(_KIND_AT)
        bounds[:, kind] = np.searchsorted(key, least) if kinds.any() else bounds[:, KINDS]
    return Blocks(
        corner=BLOCK * np.stack([there % across, there // across], axis=-1),
        bounds=bounds,
        members=numbers[((key >> np.uint64(_MASK_BITS)) & np.uint64(MOST_TRIANGLES - 1)).astype(np.int64)],
        masks=(key & np.uint64((1 << _MASK_BITS) - 1)).astype(np.int32),
    )


@exact
def _set_keys(left: Any, top: Any, right: Any, bottom: Any, code: Any, begin: Any, across: Any, key: Any) -> None:
    """Set the sort keys of all blocks that rectangles (T,) overlap, those of the t-th from begin[t] on.

    code: (T,) what the key has besides the block and the mask of its pixels. across: blocks in a row of the frame.
    """
    for t in range(len(left)):
        n = begin[t]
        for r in range(top[t] // BLOCK, bottom[t] // BLOCK + 1):
            rows = _ROW_STARTS[min(bottom[t] - BLOCK * r, BLOCK - 1) + 1] - _ROW_STARTS[max(top[t] - BLOCK * r, 0)]
            for c in range(left[t] // BLOCK, right[t] // BLOCK + 1):
                in_a_row = (2 << min(right[t] - BLOCK * c, BLOCK - 1)) - (1 << max(left[t] - BLOCK * c, 0))
                key[n] = (np.uint64(r * across + c) << np.uint64(_BLOCK_AT)) | code[t] | np.uint64(in_a_row * rows)
                n += 1
