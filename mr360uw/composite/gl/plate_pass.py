# SPDX-License-Identifier: Apache-2.0
"""Composites a layer over the planes of a video frame on the device: `over.lay_over` and `video.pixels.kernels`.

Y, U and V go up once a frame as integers. Of each tile the numbers go up as they lie in memory: bodies within the
rectangle that they cover, ratio and veil in the rows that change. plate_luma.frag decodes, blends and encodes the
pixels of a tile, plate_chroma.frag sums their steps of chroma. The tiles' codes come back, and are waited for once.

Coverage, light and ratio are the processor's own numbers, so the same pixels change, and all others keep their codes.
Changed codes differ from those of the processor where single precision rounds the dither differently, by 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec, code_range, rec709_from_plate, rgb_from_ycbcr, ycbcr_from_rgb
from mr360uw.composite.gl.targets import Targets, bind
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
"""Numbers in a row of a list: all of a tile of 8192 x 4096 pixels fit into 12 288 rows."""
_TABLES: dict[str, str | int | float] = {
    "DECODE_LOW": DECODE_LOW, "DECODE_SCALE": (DECODE_STEPS - 1) / (DECODE_HIGH - DECODE_LOW),
    "DECODE_LAST": DECODE_STEPS - 1.01, "ENCODE_LOW": ENCODE_LOW, "ENCODE_STEP_BITS": ENCODE_STEP_BITS,
    "ENCODE_STEPS": ENCODE_STEPS,
}  # fmt: skip
Sent = tuple[Rectangle, int]
"""A rectangle of a plane, and where its codes begin in the buffer that comes back [bytes]."""


@exact
def find_bounds(values: Any, same: Any, bounds: Any) -> None:
    """Widen `bounds` (first row, row after the last, first column, column after the last) to the values (h, w, c) that
    are not `same`.
    """
    height, width, channels = values.shape
    for r in range(height):
        row = values[r].reshape(width * channels)
        first, after = 0, width * channels
        while first < after and row[first] == same:
            first += 1
        if first == after:
            continue
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
        self._targets: dict[str, moderngl.Framebuffer] = {}
        self._tables: dict[ColorSpec, tuple[moderngl.Texture, moderngl.Texture]] = {}
        self._back: moderngl.Buffer | None = None
        self._columns = min(_LIST_COLUMNS, largest_texture())

    def over(self, old: YuvImage, new: YuvImage, layer: Layer, frame_index: int, wrap: bool) -> bool:
        """Write the composite of a layer over the planes `old` into `new`, which hold a copy; return whether it could.

        It cannot where the plate is read through a mapping, or where tiles share a chroma sample. wrap: the left and
        right edges meet.
        """
        tiles = [tile for tile in layer.tiles if tile.alpha.size]
        sx, sy = subsampling(old)
        if old.spec.mapping is not None or _overlap([_samples(tile.rectangle, sx, sy) for tile in tiles]):
            return False
        next_frame()
        code_bytes = old.y.dtype.itemsize
        sizes = [_codes_of(tile.rectangle, sx, sy) * code_bytes for tile in tiles]
        if self._back is None or self._back.size < sum(sizes):
            self._back = gl_context().buffer(reserve=2 * sum(sizes))
        planes = {f"{name}_codes": _plane(codes) for name, codes in (("y", old.y), ("u", old.u), ("v", old.v))}
        every = planes | dict(zip(("decoded", "encoded"), self._tables_of(old.spec), strict=True))
        of_frame = {"wrap": wrap, "frame": frame_index, "peak": float((1 << old.spec.bits) - 1)}
        sent: list[tuple[NDArray[Any], Sent]] = []
        begin = 0
        for tile, size in zip(tiles, sizes, strict=True):
            where = self._draw(tile, old, every, of_frame, begin)
            sent += zip((new.y, new.u, new.v), where, strict=True) if where else ()
            begin += size
        data = self._back.read(begin) if sent else b""
        for plane, (part, start) in sent:
            column, row, width, height = part
            codes = np.frombuffer(data, plane.dtype, width * height, start).reshape(height, width)
            plane[row : row + height, column : column + width] = codes
        return True

    def _draw(
        self, tile: Tile, old: YuvImage, textures: dict[str, Any], of_frame: dict[str, Any], begin: int
    ) -> list[Sent]:
        """Draw the codes of a tile and send them on their way; return where those of Y, U and V will lie.

        Of a tile that changes nothing none are drawn. begin: where they may begin in the buffer [bytes].
        """
        radiance, alpha, ratio, veil = (
            np.ascontiguousarray(values, np.float32) for values in (tile.radiance, tile.alpha, tile.ratio, tile.veil)
        )
        top, bottom, left, right = _bounds(0.0, alpha[..., None], radiance).tolist()
        first, after = _bounds(1.0, ratio).tolist()[:2]
        if top == bottom and first == after and tile.shafts is None:
            return []
        body, lit_rows = (slice(top, bottom), slice(left, right)), slice(first, after)
        lists = {"radiance": radiance[body], "alpha": alpha[body], "ratio": ratio[lit_rows], "veil": veil[lit_rows]}
        if tile.shafts is not None:
            lists["shafts"] = tile.shafts
        textures = {"shafts": textures["decoded"], **textures, **{name: self._list(of) for name, of in lists.items()}}
        spec, rectangle, (sx, sy) = old.spec, tile.rectangle, subsampling(old)
        of_tile = of_frame | {"corner": rectangle[:2], "size": rectangle[2:]}
        code_type = f"u{old.y.dtype.itemsize}"

        defines: dict[str, str | int | float] = {"SX": sx, "SY": sy, "LIST_COLUMNS": self._columns}
        gamut: dict[str, str | int | float] = {} if spec.gamut == "bt709" else {"GAMUT": 1}
        shader = self._shaders.program("plate_luma", defines | _TABLES | gamut)
        bind(shader, textures)
        to_rec709 = rec709_from_plate(spec.gamut)
        set_uniforms(
            shader,
            covered=(left, top, right - left, bottom - top),
            relit=(first, after),
            lit=tile.shafts is not None,
            spans=code_range(spec),
            rgb_from_ycbcr=rgb_from_ycbcr(spec.matrix).T,
            ycbcr_from_rgb=ycbcr_from_rgb(spec.matrix).T,
            rec709_from_plate=to_rec709.T,
            plate_from_rec709=np.linalg.inv(to_rec709).T,
            **of_tile,
        )
        luma = self._target("luma", rectangle, ((1, code_type), (4, "f4")))
        self._shaders.fill(luma, shader, Rectangle(0, 0, *rectangle[2:]))

        shader = self._shaders.program("plate_chroma", defines)
        bind(shader, {**textures, "steps": luma.color_attachments[1]})
        set_uniforms(shader, **of_tile)
        samples = _samples(rectangle, sx, sy)
        chroma = self._target("chroma", samples, ((1, code_type), (1, code_type)))
        self._shaders.fill(chroma, shader, Rectangle(0, 0, *samples[2:]))

        where = []
        for target, number, part in ((luma, 0, rectangle), (chroma, 0, samples), (chroma, 1, samples)):
            target.read_into(
                self._back, (0, 0, *part[2:]), 1, attachment=number, dtype=code_type, alignment=1, write_offset=begin
            )
            where.append((part, begin))
            begin += part.width * part.height * old.y.dtype.itemsize
        return where

    def _tables_of(self, spec: ColorSpec) -> tuple[moderngl.Texture, moderngl.Texture]:
        """Return the transfer curve of a plate and its inverse, as lists."""
        if spec not in self._tables:
            self._tables = {spec: (self._list(decode_table(spec)), self._list(encode_table(spec)))}
        return self._tables[spec]

    def _list(self, values: NDArray[Any]) -> moderngl.Texture:
        """Return a texture of numbers in order, in rows of `LIST_COLUMNS`, without a copy where they lie in order."""
        flat = np.ascontiguousarray(values, np.float32).reshape(-1)
        rows, rest = divmod(flat.size, self._columns)
        texture = texture_pool().texture((self._columns, roomy_rows(rows + 1)), 1)
        if rows:
            texture.write(flat[: rows * self._columns], viewport=(0, 0, self._columns, rows), alignment=1)
        if rest:
            texture.write(flat[rows * self._columns :], viewport=(0, rows, rest, 1), alignment=1)
        return texture

    def _target(self, name: str, part: Rectangle, formats: Sequence[tuple[int, str]]) -> moderngl.Framebuffer:
        """Return a kept target of at least a part's size, one texture for each (channels, type)."""
        target, key = self._targets.get(f"{name} {formats}"), f"{name} {formats}"
        if target is None or target.width < part.width or target.height < part.height:
            width, height = part.width, roomy_rows(part.height)
            if target is not None:
                width, height = max(width, target.width), max(height, target.height)
            textures = [gl_context().texture((width, height), channels, dtype=dtype) for channels, dtype in formats]
            target = self._targets[key] = gl_context().framebuffer(textures)
        return target


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


def _codes_of(part: Rectangle, sx: int, sy: int) -> int:
    """Return the number of codes of Y, U and V in a rectangle of pixels."""
    samples = _samples(part, sx, sy)
    return part.width * part.height + 2 * samples.width * samples.height


def _overlap(parts: Sequence[Rectangle]) -> bool:
    """Return whether any two of some rectangles overlap."""
    boxes = np.array(parts, np.int64).reshape(-1, 4)
    first, after = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    meet = np.all((first[:, None] < after) & (first < after[:, None]), axis=-1)
    return bool(np.sum(meet) > len(boxes))
