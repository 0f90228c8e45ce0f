# SPDX-License-Identifier: Apache-2.0
"""Lists of the triangles that may cover each block of 4 x 4 pixels.

Every triangle has a rectangle of the frame. A block lists the triangles whose rectangles overlap it, with a mask of the
overlapped pixels; blocks without triangles are left out. A rectangle may cross the seam or run around the whole frame,
so neither the seam nor the poles are special. The device reads the lists with blocks.glsl.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact

BLOCK = 4
LANE_COLUMNS = 256
"""Width [texels] of targets that hold numbered items."""
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


@exact
def write_lanes(images: Any, values: Any) -> None:
    """Write the texels of a target's images (n, h, w, c) into values (count, n c), in the order of their numbers.

    The order is `lane_number` of blocks.glsl: block by block.
    """
    across, channels = images.shape[2] // BLOCK, images.shape[3]
    for k in range(len(values)):
        block, within = k // (BLOCK * BLOCK), k % (BLOCK * BLOCK)
        row = BLOCK * (block // across) + within // BLOCK
        column = BLOCK * (block % across) + within % BLOCK
        for image in range(len(images)):
            for c in range(channels):
                values[k, channels * image + c] = images[image, row, column, c]


def lane_rows(count: int) -> int:
    """Return the rows of a target of `LANE_COLUMNS` columns that holds `count` numbered items."""
    return BLOCK * -(-count // (BLOCK * LANE_COLUMNS))
