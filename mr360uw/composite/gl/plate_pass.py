# SPDX-License-Identifier: Apache-2.0
"""Composites a layer over the planes of a video frame on the device: `over.lay_over` and `video.pixels.kernels`.

Y, U and V go up once a frame as integers. Of each tile the numbers go up as they lie in memory: bodies within the
rectangle that they cover, ratio and veil in the rows that change. plate_luma.frag decodes, blends and encodes the
pixels of a tile, plate_chroma.frag sums their steps of chroma. The tiles' codes come back, and are waited for once.

Large tiles are cut into bands, which take turns with the same textures. Coverage, light and ratio are the processor's
own numbers, so the same pixels change, and all others keep their codes. Changed codes differ from the processor's where
single precision rounds the dither differently, by 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec, code_range, rec709_from_plate, rgb_from_ycbcr, ycbcr_from_rgb
from mr360uw.composite.gl.targets import Targets
from mr360uw.gl.context import (
    gl_context,
    largest_texture,
    next_frame,
    per_thread,
    roomy_rows,
    set_uniforms,
    texture_pool,
)
from mr360uw.jit import exact
from mr360uw.types import Layer, Rectangle, Tile, YuvImage
from mr360uw.yuv.coefficients import (
    DECODE_HIGH,
    DECODE_LOW,
    DECODE_STEPS,
    ENCODE_LOW,
    ENCODE_STEP_BITS,
    ENCODE_STEPS,
    decode_table,
    encode_table,
    subsampling,
)

if TYPE_CHECKING:
    import moderngl

_LIST_COLUMNS = 8192
"""Numbers in a row of a list."""
_AT_ONCE = 1 << 19
"""Pixels that are drawn together, 52 bytes each on the device; half as many need twice as many calls."""
_CHANNELS = {"radiance": 3, "alpha": 1, "ratio": 3, "veil": 3, "shafts": 3}
"""Fields of a tile that go up, and their numbers for a pixel."""
_TABLES: dict[str, str | int | float] = {
    "DECODE_LOW": DECODE_LOW, "DECODE_SCALE": (DECODE_STEPS - 1) / (DECODE_HIGH - DECODE_LOW),
    "DECODE_LAST": DECODE_STEPS - 1.01, "ENCODE_LOW": ENCODE_LOW, "ENCODE_STEP_BITS": ENCODE_STEP_BITS,
    "ENCODE_STEPS": ENCODE_STEPS,
}  # fmt: skip
Sent = tuple[Rectangle, int]
"""A rectangle of a plane, and where its codes begin in the buffer that comes back [bytes]."""


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """Programs and targets of a frame's luma and chroma. size: bytes of a code; sx, sy: log2 of the subsampling."""

    luma_shader: moderngl.Program
    chroma_shader: moderngl.Program
    luma: moderngl.Framebuffer
    chroma: moderngl.Framebuffer
    size: int
    sx: int
    sy: int


@exact
def find_bounds(values: Any, same: Any, bounds: Any) -> None:
    """Widen `bounds` (first row, row after the last, first column, column after the last) to the values (h, w, c) that
    are not `same`.
    """
    height, width, channels = values.shape
    for r in range(height):
        row = values[r].reshape(width * channels)
        other = False
        for i in range(width * channels):  # by vector instructions
            other |= row[i] != same
        if not other:
            continue
        first, after = 0, width * channels
        while row[first] == same:
            first += 1
        while after > channels * bounds[3] and row[after - 1] == same:
            after -= 1
        bounds[0], bounds[1] = min(bounds[0], r), max(bounds[1], r + 1)
        bounds[2], bounds[3] = min(bounds[2], first // channels), max(bounds[3], -(-after // channels))


def _bounds(same: float, *values: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the bounds of the values (h, w, c) that are not `same`, all 0 without any; see `find_bounds`."""
    height, width = values[0].shape[:2]
    bounds = np.array([height, 0, width, 0])
    for one in values:
        find_bounds(one, np.float32(same), bounds)
    return bounds if bounds[1] else np.zeros(4, np.int64)


class PlatePass:
    """Composites layers over planes with the context of the thread that made it."""

    def __init__(self) -> None:
        self._shaders = Targets()
        self._spec: ColorSpec | None = None  # of the tables among the lists
        self._lists: dict[str, moderngl.Texture] = {}
        self._back: moderngl.Buffer | None = None
        self._columns = min(_LIST_COLUMNS, largest_texture())

    def over(self, old: YuvImage, new: YuvImage, layer: Layer, frame_index: int, wrap: bool) -> bool:
        """Write the composite of a layer over the planes `old` into `new`, which hold a copy; return whether it could.

        It cannot where the plate is read through a mapping, or where tiles share a chroma sample. wrap: the left and
        right edges meet.
        """
        tiles = [band for tile in layer.tiles if tile.alpha.size for band in _bands(tile)]
        sx, sy = subsampling(old)
        if old.spec.mapping is not None or _overlap([_samples(tile.rectangle, sx, sy) for tile in tiles]):
            return False
        next_frame()
        passes = self._passes(old, tiles, frame_index, wrap)
        room = passes.size * sum(tile.alpha.size + 2 * _area(_samples(tile.rectangle, sx, sy)) for tile in tiles)
        if self._back is None or self._back.size < room:
            self._back = gl_context().buffer(reserve=2 * room)
        sent: list[tuple[NDArray[Any], Sent]] = []
        begin = 0
        for tile in tiles:
            where = self._draw(tile, passes, begin)
            if where:
                sent += zip((new.y, new.u, new.v), where, strict=True)
                part, last = where[-1]
                begin = last + passes.size * _area(part)
        data = self._back.read(begin) if sent else b""
        for plane, (part, start) in sent:
            column, row, width, height = part
            codes = np.frombuffer(data, plane.dtype, width * height, start).reshape(height, width)
            plane[row : row + height, column : column + width] = codes
        return True

    def _passes(self, old: YuvImage, tiles: Sequence[Tile], frame_index: int, wrap: bool) -> Passes:
        """Return programs and targets with all set that the tiles of a frame share, textures bound."""
        spec, (sx, sy), size = old.spec, subsampling(old), old.y.dtype.itemsize
        defines: dict[str, str | int | float] = {"SX": sx, "SY": sy, "LIST_COLUMNS": self._columns}
        gamut: dict[str, str | int | float] = {} if spec.gamut == "bt709" else {"GAMUT": 1}
        width, height = (max((tile.rectangle[axis] for tile in tiles), default=1) for axis in (2, 3))
        passes = Passes(
            luma_shader=self._shaders.program("plate_luma", defines | _TABLES | gamut),
            chroma_shader=self._shaders.program("plate_chroma", defines),
            luma=self._shaders.target(f"luma u{size}", width, height, (1, 4), (f"u{size}", "f4")),
            chroma=self._shaders.target(f"chroma u{size}", width, height, (1, 1), (f"u{size}",) * 2),
            size=size,
            sx=sx,
            sy=sy,
        )
        planes = ("y", old.y), ("u", old.u), ("v", old.v)
        textures: dict[str, Any] = {f"{name}_codes": _plane(codes) for name, codes in planes}
        largest = max((tile.alpha.size for tile in tiles), default=0)
        textures |= {name: self._list(name, channels * largest) for name, channels in _CHANNELS.items()}
        for name, table in (("decoded", decode_table(spec)), ("encoded", encode_table(spec))):
            textures[name] = self._list(name, table.size)
            if spec != self._spec:
                self._fill(name, table)
        self._spec = spec
        textures["steps"] = passes.luma.color_attachments[1]
        to_rec709 = rec709_from_plate(spec.gamut)
        for unit, texture in enumerate(textures.values()):
            texture.use(unit)
        for shader in (passes.luma_shader, passes.chroma_shader):
            set_uniforms(
                shader,
                **{name: unit for unit, name in enumerate(textures)},
                wrap=wrap,
                frame=frame_index,
                peak=float((1 << spec.bits) - 1),
                spans=code_range(spec),
                rgb_from_ycbcr=rgb_from_ycbcr(spec.matrix).T,
                ycbcr_from_rgb=ycbcr_from_rgb(spec.matrix).T,
                rec709_from_plate=to_rec709.T,
                plate_from_rec709=np.linalg.inv(to_rec709).T,
            )
        return passes

    def _draw(self, tile: Tile, passes: Passes, begin: int) -> list[Sent]:
        """Draw the codes of a tile and send them on their way; return where those of Y, U and V will lie.

        Of a tile that changes nothing none are drawn. begin: where they may begin in the buffer [bytes].
        """
        radiance, alpha, ratio = (
            np.ascontiguousarray(of, np.float32) for of in (tile.radiance, tile.alpha, tile.ratio)
        )
        top, bottom, left, right = _bounds(0.0, alpha[..., None], radiance).tolist()
        first, after = _bounds(1.0, ratio).tolist()[:2]
        if top == bottom and first == after and tile.shafts is None:
            return []
        body, relit = (slice(top, bottom), slice(left, right)), slice(first, after)
        self._fill("radiance", radiance[body])
        self._fill("alpha", alpha[body])
        self._fill("ratio", ratio[relit])
        self._fill("veil", tile.veil[relit])
        if tile.shafts is not None:
            self._fill("shafts", tile.shafts)
        samples = _samples(tile.rectangle, passes.sx, passes.sy)
        corner, size = tile.rectangle[:2], tile.rectangle[2:]
        set_uniforms(
            passes.luma_shader,
            corner=corner,
            size=size,
            covered=(left, top, right - left, bottom - top),
            relit=(first, after),
            lit=tile.shafts is not None,
        )
        self._shaders.fill(passes.luma, passes.luma_shader, Rectangle(0, 0, *size))
        set_uniforms(passes.chroma_shader, corner=corner, size=size)
        self._shaders.fill(passes.chroma, passes.chroma_shader, Rectangle(0, 0, *samples[2:]))
        where = []
        of_planes = (passes.luma, 0, tile.rectangle), (passes.chroma, 0, samples), (passes.chroma, 1, samples)
        for target, attachment, part in of_planes:
            target.read_into(
                self._back, (0, 0, *part[2:]), 1, attachment=attachment, dtype=f"u{passes.size}", alignment=1,
                write_offset=begin,
            )  # fmt: skip
            where.append((part, begin))
            begin += passes.size * _area(part)
        return where

    def _list(self, name: str, count: int) -> moderngl.Texture:
        """Return the kept list of a name, with room for `count` numbers."""
        rows, kept = -(-count // self._columns), self._lists.get(name)
        if kept is None or kept.height < rows:
            kept = self._lists[name] = gl_context().texture((self._columns, roomy_rows(rows)), 1, dtype="f4")
        return kept

    def _fill(self, name: str, values: NDArray[Any]) -> None:
        """Write numbers into a list as they lie in memory: full rows, and what is left."""
        flat = np.ascontiguousarray(values, np.float32).reshape(-1)
        rows, rest = divmod(flat.size, self._columns)
        full = rows * self._columns
        if rows:
            self._lists[name].write(flat[:full], viewport=(0, 0, self._columns, rows), alignment=1)
        if rest:
            self._lists[name].write(flat[full:], viewport=(0, rows, rest, 1), alignment=1)


@per_thread
def plate_pass() -> PlatePass:
    """Return the pass of this thread's context."""
    return PlatePass()


def _plane(codes: NDArray[Any]) -> moderngl.Texture:
    """Return a texture of the codes (h, w) of a plane, as integers."""
    texture = texture_pool().texture((codes.shape[1], codes.shape[0]), 1, f"u{codes.dtype.itemsize}")
    texture.write(np.ascontiguousarray(codes), alignment=1)
    return texture


def _samples(part: Rectangle, sx: int, sy: int) -> Rectangle:
    """Return the chroma samples that a rectangle of pixels touches."""
    i, j = part.column >> sx, part.row >> sy
    after = ((part.column + part.width - 1) >> sx) + 1, ((part.row + part.height - 1) >> sy) + 1
    return Rectangle(i, j, after[0] - i, after[1] - j)


def _area(part: Rectangle) -> int:
    return part.width * part.height


def _bands(tile: Tile) -> Iterator[Tile]:
    """Yield a tile in bands of rows of `_AT_ONCE` pixels or little more, which share no chroma sample."""
    height, width = tile.alpha.shape
    rows = max(_AT_ONCE // width // 2 * 2, 2)
    first = 0
    while first < height:
        after = min(first + rows - (tile.row + first) % 2, height)
        fields = {name: getattr(tile, name) for name in (*_CHANNELS, "distance_m")}
        of_band: dict[str, Any] = {
            name: None if values is None else values[first:after] for name, values in fields.items()
        }
        yield replace(tile, row=tile.row + first, **of_band)
        first = after


def _overlap(parts: Sequence[Rectangle]) -> bool:
    """Return whether any two of some rectangles overlap."""
    boxes = np.array(parts, np.int64).reshape(-1, 4)
    first, after = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    meet = np.all((first[:, None] < after) & (first < after[:, None]), axis=-1)
    return bool(np.sum(meet) > len(boxes))
