# SPDX-License-Identifier: Apache-2.0
"""The compositing formula of a tile over the plate: differential rendering below water, then `over`.

The plate's radiance is T L_surface + veil. A shadow or a caustic changes L_surface alone, so the receiver's ratio
E_with/E_without multiplies (plate - veil) and leaves the veil (Debevec 1998, with the veil that water adds):

    background = veil + (plate - veil) ratio + shafts        composite = radiance + (1 - alpha) background

Shafts are the change of the smooth veil by bodies and waves, of either sign; they never make the plate negative.

Alpha is premultiplied (Porter & Duff 1984). A veil brighter than the plate is clipped to it, so that haze is never
darkened and no pixel turns negative.

A plate of a wider gamut than Rec.709 has channels below zero. They are multiplied by s, the least factor of the
channels above zero, 1 at most: the background is then s plate plus light that is nowhere negative, and a colour that
the plate's primaries can show stays one.

Light on the ground varies slowly, and is known at the corners of blocks of pixels:

    ratio = 1 + w (sun + (share (free - sun) + added)/r - 1)        sun = seen waves

with the symbols of composite/receiver/ratio.py, and r the plate's own pattern (composite/receiver/pattern.py), 1
without one. Each quantity is interpolated between the corners, or taken from an image of a block's pixels if there is
one. A line is worked out where it is laid over the plate, from the plate's light that is decoded there, so that nothing
of the ground's size is written in between (video/plane_kernels.py); `BlockGround.lay` writes a whole tile, for what
needs one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import room
from mr360uw.jit import exact, fast, inlined
from mr360uw.types import Floats, Rectangle, Tile

BLOCK = 8
"""Pixels along a block."""
CORNER_CHANNELS = 10
"""Numbers at a corner: share (3), veil (3), free (3) and seen."""
LEAST_LIGHT = 1e-3
"""Linear light above the veil below which a pattern is taken for noise: a quarter of an 8-bit code near black."""
LEAST_DIRECT = 0.02
"""Least direct light over the mean that is left beside the ambient: filaments are bright, what lies between them is not
quite without sun."""
MOST_LOST = 4.0
"""Factor by which a clipped channel's light was more than it shows, at most: two stops."""
_AT_ONCE = 32
"""Most blocks beside each other that are computed together: compilers vectorise loops that are longer than a block.
Half as many or twice as many take as long."""
_MIDDLE = ((np.arange(BLOCK) + 0.5) / BLOCK).astype(np.float32)
"""Where the pixels of a block lie, along it."""
_HALF_BIAS = np.float32(2.0**112)
"""Ratio of the exponents' biases of float32 and float16, which turns the bits of one into the other."""


def blended(plate_linear: Floats, tile: Tile) -> Floats:
    """Return the composite (h, w, 3) of the plate's linear pixels below one tile, in their type."""
    image = np.empty_like(plate_linear)
    shafts = np.zeros((0, 0, 3), tile.radiance.dtype) if tile.shafts is None else tile.shafts
    lay_over(plate_linear, tile.radiance, tile.alpha, tile.ratio, tile.veil, shafts, plate_linear.dtype.type(1), image)
    return image


def light_sum(image: Floats) -> float:
    """Return the sum of an image's light; it is not finite where any number is not."""
    with np.errstate(all="ignore"):
        return float(image.sum())


def changed_pixels(tile: Tile) -> NDArray[np.bool_]:
    """Return where a tile changes the plate, (h, w): coverage, light, shafts, or a ratio other than 1."""
    changed = (tile.alpha != 0.0) | np.any((tile.ratio != 1.0) | (tile.radiance != 0.0), axis=-1)
    return changed if tile.shafts is None else changed | np.any(tile.shafts != 0.0, axis=-1)


@exact
def find_changes(alpha: Any, radiance: Any, ratio: Any, shafts: Any, changed: Any) -> None:
    """Write `changed_pixels` of a row of a tile, float32, into `changed` (w,). shafts: (w, 3), or (0, 3) for none."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(len(changed)):
        same = alpha[i] == zero
        for c in range(3):
            same &= (ratio[i, c] == one) & (radiance[i, c] == zero)
        changed[i] = not same
    if len(shafts):
        for i in range(len(changed)):
            for c in range(3):
                changed[i] |= shafts[i, c] != zero


@inlined
def _background(below: Any, ratio: Any, veil: Any, one: Any) -> Any:
    """Return a channel of the plate that is not below zero with the light on its surface changed."""
    haze = min(veil, below)
    return haze + (below - haze) * ratio if ratio != one else below


@exact
def blend_row(plate: Any, radiance: Any, alpha: Any, ratio: Any, veil: Any, shafts: Any, one: Any, image: Any) -> None:
    """Write the composite (w, 3) of a row of a tile over the plate's pixels (w, 3).

    shafts: (w, 3), or (0, 3) for none. one: 1 in the type that is computed in. Where a tile changes nothing the plate
    is copied bit for bit.
    """
    zero = one - one
    if len(shafts):
        for i in range(len(alpha)):
            for c in range(3):
                below = max(_background(plate[i, c], ratio[i, c], veil[i, c], one) + shafts[i, c], zero)
                image[i, c] = radiance[i, c] + (one - alpha[i]) * below
    else:
        for i in range(len(alpha)):
            for c in range(3):
                below = _background(plate[i, c], ratio[i, c], veil[i, c], one)
                image[i, c] = radiance[i, c] + (one - alpha[i]) * below
    for i in range(len(alpha)):
        if min(plate[i, 0], plate[i, 1], plate[i, 2]) >= zero:
            continue
        # Beyond the gamut: find by what factor the channel with light that loses most is multiplied
        least = one
        for c in range(3):
            if plate[i, c] > zero:
                below = _background(plate[i, c], ratio[i, c], veil[i, c], one)
                if len(shafts):
                    below = max(below + shafts[i, c], zero)
                least = min(least, below / plate[i, c])
        # Multiply those below zero by it
        for c in range(3):
            if plate[i, c] < zero:
                below = plate[i, c] * least
                if len(shafts):
                    below += max(shafts[i, c], zero)
                image[i, c] = radiance[i, c] + (one - alpha[i]) * below


@exact
def lay_over(plate: Any, radiance: Any, alpha: Any, ratio: Any, veil: Any, shafts: Any, one: Any, image: Any) -> None:
    """Write the composite (h, w, 3) of a tile over the plate's pixels (h, w, 3); see `blend_row`."""
    for j in range(alpha.shape[0]):
        more = shafts[min(j, len(shafts) - 1)] if len(shafts) else shafts.reshape(0, 3)
        blend_row(plate[j], radiance[j], alpha[j], ratio[j], veil[j], more, one, image[j])


# --- light on the ground ---------------------------------------------------------------------------------------------


class Picture(Protocol):
    """A plate's frame."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def linear(self, rectangle: Rectangle) -> Floats:
        """Return a part of it as linear light (h, w, 3)."""

    def halved(self, rectangle: Rectangle) -> Floats:
        """Return a part of even place and size at half its columns and rows, (h/2, w/2, 3)."""


class PixelImages(NamedTuple):
    """Images of some blocks, (m, B, B, k) float32. at: (n,) for each block the number of its image, or -1."""

    at: NDArray[np.int32]
    image: NDArray[np.float32]


class Blurs(NamedTuple):
    """Blurs of a part of a frame at some widths, and which of them its rows take.

    value: (n,) of all blurred pictures, one after the other. table: (levels, 6) of each: where it begins in `value`,
    its first row and column, its rows and columns, and the pixels of the frame along one of its own. row: the first
    row of the frame. level: (h,) fractional number of the blur that a row takes.
    """

    value: NDArray[np.float32]
    table: NDArray[np.int64]
    row: int
    level: NDArray[np.float32]


class GroundLines(NamedTuple):
    """What the lines of a frame's ground are worked out from, for compiled functions.

    first: (R + 1,) number of the first block of each row of blocks; column: (n,) of the blocks. corner: (R + 1, C + 1,
    10) float32. images: of free (k = 3), seen (1), waves (3), shape (7: share, weight, veil) and added (3), used
    instead of corners. height: of the frame. least: relative change of the plate that is written. patterned: whether
    the plate has caustics of its own. mean: (rows, W, 3) bits of float16 of the frame's last rows in calm water; none
    (0, 0, 0) where the plate is drawn towards blurs, by a strength. white: light from which a channel of the plate is
    clipped.
    """

    first: NDArray[np.int64]
    column: NDArray[np.int64]
    corner: NDArray[np.float32]
    images: tuple[PixelImages, ...]
    height: int
    least: np.float32
    patterned: bool
    mean: NDArray[np.uint16]
    blurs: Blurs
    strength: np.float32
    white: np.float32


NO_BLURS = Blurs(np.zeros(0, np.float32), np.zeros((0, 6), np.int64), 0, np.zeros(0, np.float32))
_NO_IMAGES = tuple(
    PixelImages(np.zeros(0, np.int32), np.zeros((0, BLOCK, BLOCK, k), np.float32)) for k in (3, 1, 3, 7, 3)
)
_NO_BLOCKS = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 0, CORNER_CHANNELS), np.float32)
NO_MEAN = np.zeros((0, 0, 3), np.uint16)
NO_GROUND = GroundLines(
    *_NO_BLOCKS, _NO_IMAGES, 0, np.float32(0.0), False, NO_MEAN, NO_BLURS, np.float32(0.0), np.float32(np.inf)
)


@dataclass(frozen=True, slots=True, eq=False)
class BlockGround:
    """Light on the ground of a frame as an `UnlaidGround`.

    picture: the plate whose own caustics shadows take away; None for none.
    """

    lines: GroundLines
    picture: Picture | None

    def lay(self, tile: Tile) -> Tile:
        """Return a tile with its ratio and its veil on the ground."""
        shown = np.zeros((0, 0, 3), np.float32)
        if self.picture is not None:
            shown = np.ascontiguousarray(self.picture.linear(tile.rectangle), np.float32)
        size = (*tile.alpha.shape, 3)
        ratio, veil = np.ones(size, np.float32), np.zeros(size, np.float32)
        _lay(self.lines, shown, tile.row, 1, tile.column, ground_room(), ratio, veil)
        return replace(tile, ratio=ratio, veil=veil)

    def lines_of(self, part: Rectangle, first: int, step: int) -> tuple[Floats, Floats]:
        """Return ratio and veil (n, w, 3) of lines of a rectangle, the `first` one and each `step` lines further.

        The plate's own caustics are left out.
        """
        size = (len(range(first, part.height, step)), part.width, 3)
        ratio, veil = np.ones(size, np.float32), np.zeros(size, np.float32)
        plain, none = self.lines._replace(patterned=False), np.zeros((0, 0, 3), np.float32)
        _lay(plain, none, part.row + first, step, part.column, ground_room(), ratio, veil)
        return ratio, veil


@fast
def _lay(ground: Any, shown: Any, row: int, step: int, column: int, work: Any, ratio: Any, veil: Any) -> None:
    """Write ratio and veil (h, w, 3) of lines that are `step` apart, the first from (row, column) on.

    shown: light of the plate there, or none. work: of `ground_room`.
    """
    for r in range(len(ratio)):
        light = shown[min(r, len(shown) - 1)] if len(shown) else shown.reshape(0, 3)
        ground_line(ground, row + r * step, column, light, work, ratio[r], veil[r])


def ground_room() -> tuple[Any, ...]:
    """Return room for a line of some blocks: ten numbers of their pixels, and as many at their sides; weight, waves and
    added light; light of the plate, calm light, one over the pattern, the light that is lost, halves of the mean, and
    room of `calm_line`; change.
    """
    n = _AT_ONCE * BLOCK
    plate, inverse = np.ones((2, 2, 3, n), np.float32)
    of_plate = plate, inverse, *room(n, dtype=np.uint32), *room(3 * n + 9)
    return room((10, n), (10, _AT_ONCE + 1)), room(n, (3, n), (3, n)), of_plate, *room((3, n))


@fast
def ground_line(ground: Any, y: int, x0: int, shown: Any, work: Any, ratio: Any, veil: Any) -> None:
    """Write ratio and veil (n, 3) of the pixels of row y, from column x0 on, where blocks change them.

    shown: linear light (n, 3) of the plate there, where it has caustics of its own. work: of `ground_room`.
    """
    (line, side), (weight, waves, added), (plate, inverse, bits, own), change = work
    q, x1, one = y // BLOCK, x0 + len(ratio), np.float32(1.0)
    down = (np.float32(y - q * BLOCK) + np.float32(0.5)) / np.float32(min(BLOCK, ground.height - q * BLOCK))
    end, last = ground.first[q], ground.first[q + 1]
    while end < last and (ground.column[end] + 1) * BLOCK <= x0:
        end += 1
    while end < last and ground.column[end] * BLOCK < x1:
        # Take blocks beside each other
        begin, z = end, ground.column[end]
        while end < last and end - begin < _AT_ONCE and ground.column[end] == z + end - begin:
            end += 1
        blocks, left = end - begin, z * BLOCK
        begin_x, end_x = max(left, x0), min(left + blocks * BLOCK, x1)
        inside, there = slice(begin_x - left, end_x - left), slice(begin_x - x0, end_x - x0)
        # Find what stands in the formula
        for i in range(blocks * BLOCK):
            weight[i] = one
            for k in range(3):
                waves[k, i], added[k, i] = one, np.float32(0.0)
        _between(ground.corner, q, z, down, side, line, blocks)
        for b in range(blocks):
            _take_images((line, weight, waves, added), b, y - q * BLOCK, begin + b, ground.images)
        if ground.patterned:
            _plate_line(ground, y, begin_x, shown[there], (bits, own), plate[0, :, inside], plate[1, :, inside])
            _inverse_pattern(plate, line, blocks * BLOCK, ground.white, inverse)
        for k in range(3):
            share, fall, sun, free = line[k], waves[k], line[9], line[6 + k]
            more, per_light, lost, out = added[k], inverse[0, k], inverse[1, k], change[k]
            for i in range(blocks * BLOCK):
                lit = sun[i] * fall[i]
                left_over = share[i] * (free[i] - lit) + more[i]
                left = lit + left_over * per_light[i]
                out[i] = weight[i] * ((min(left * lost[i], one) if left < one else left) - one)
        _write(change[:, inside], line[3:6, inside], ground.least, ratio[there], veil[there])


@inlined
def _plate_line(ground: Any, y: int, x: int, shown: Any, work: Any, now: Any, calm: Any) -> None:
    """Write the light that the plate shows (n, 3) on a line (3, n) from (y, x) on, and its calm state."""
    n, (bits, own) = len(shown), work
    for k in range(3):
        for i in range(n):
            now[k, i] = shown[i, k]
    if len(ground.mean) == 0:
        calm_line(ground.blurs, y, x, own, calm)
        for k in range(3):
            for i in range(n):
                calm[k, i] = drawn_towards(now[k, i], ground.strength, calm[k, i])
        return
    # Turn the bits of the mean's halves into those of floats; it is 0 above its rows
    row, of_half, none = y - ground.height + len(ground.mean), bits.view(np.float32), np.uint32(0)
    halves = ground.mean[max(row, 0), x : x + n]
    all_bits = np.uint32(0xFFFF) if row >= 0 else none
    for k in range(3):
        for i in range(n):
            half = np.uint32(halves[i, k]) & all_bits
            bits[i] = (half & np.uint32(0x8000)) << np.uint32(16) | (half & np.uint32(0x7FFF)) << np.uint32(13)
        for i in range(n):
            calm[k, i] = of_half[i] * _HALF_BIAS


@inlined
def calm_line(blurs: Any, row: int, column: int, own: Any, out: Any) -> None:
    """Write a line (3, n) of a frame from (row, column) on, mixed from its `Blurs`, bilinearly between their pixels.

    own: room for 3 n + 9 numbers of the pixels of a blurred line.
    """
    value, table, first_row, level = blurs
    number = int(level[row - first_row])
    mixed = level[row - first_row] - np.float32(number)
    for k in range(2):
        weight = mixed if k else np.float32(1.0) - mixed
        if k and weight == np.float32(0.0):
            continue
        # The line of the blurred picture there, between two of its own
        begin, top, left, rows, columns, factor = table[number + k]
        y = (np.float32(row) + np.float32(0.5)) / np.float32(factor) - np.float32(0.5) - np.float32(top)
        y = max(y, np.float32(0.0))
        j = int(y)
        down = y - np.float32(j)
        across, under = 3 * columns, min(j + 1, rows - 1)  # the last row of the frame has none below it
        upper, lower = value[begin + across * j : begin + across * (j + 1)], value[begin + across * under :]
        step = np.float32(1.0) / np.float32(factor)
        start = (np.float32(column) + np.float32(0.5)) * step - np.float32(0.5) - np.float32(left)
        first, after = int(start), int(start + np.float32(out.shape[1] - 1) * step) + 2
        for i in range(3 * (after - first)):
            above, below = upper[3 * first + i], lower[3 * first + i]
            own[i] = weight * (above + down * (below - above))
        # Along it, between its pixels
        for i in range(out.shape[1]):
            x = start + np.float32(i) * step
            n = int(x)
            right = x - np.float32(n)
            n = 3 * (n - first)
            for c in range(3):
                between = own[n + c] + right * (own[n + 3 + c] - own[n + c])
                out[c, i] = between + out[c, i] if k else between


@inlined
def drawn_towards(shown: Any, strength: Any, blurred: Any) -> Any:
    """Return the calm state of light that is shown, drawn towards its blur by a strength."""
    return shown + strength * (blurred - shown)


@inlined
def _inverse_pattern(plate: Any, line: Any, count: int, white: Any, inverse: Any) -> None:
    """Write one over what `pattern.direct_pattern` returns, with one division for a value, and what `lost_light` does,
    into `inverse` (2, 3, n).

    plate: (2, 3, n) its light and its calm state. white: light from which a channel is clipped.
    """
    one, dark, direct = np.float32(1.0), np.float32(LEAST_LIGHT), np.float32(LEAST_DIRECT)
    for k in range(3):
        share, veil, now, mean, out = line[k], line[3 + k], plate[0, k], plate[1, k], inverse[0, k]
        for i in range(count):
            light, base, least = now[i] - veil[i], mean[i] - veil[i], share[i] + direct * (one - share[i])
            lit = light > least * base
            part, whole = base if lit else one, light if lit else least
            out[i] = part / whole if base > dark else one
    for i in range(count):
        brightest = max(plate[0, 0, i], plate[0, 1, i], plate[0, 2, i])
        for k in range(3):
            inverse[1, k, i] = one
        if brightest < white:
            continue
        least = min(inverse[0, 0, i], inverse[0, 1, i], inverse[0, 2, i])
        for k in range(3):
            if plate[0, k, i] >= white:
                inverse[1, k, i] = min(inverse[0, k, i] / least, np.float32(MOST_LOST))
                inverse[0, k, i] /= inverse[1, k, i]


@inlined
def _between(corner: Any, q: int, z: int, down: Any, side: Any, line: Any, blocks: int) -> None:
    """Set a row of `line` (10, n) to what lies between the corners of blocks, from block (q, z) on.

    down: how far the row lies from the upper corners to the lower ones. side: (10, n) room for what it is between them.
    """
    for b in range(blocks + 1):
        for k in range(10):
            side[k, b] = corner[q, z + b, k] + down * (corner[q + 1, z + b, k] - corner[q, z + b, k])
    for k in range(10):
        for b in range(blocks):
            start, step = side[k, b], side[k, b + 1] - side[k, b]
            for i in range(BLOCK):
                line[k, b * BLOCK + i] = start + _MIDDLE[i] * step


@inlined
def _write(change: Any, haze: Any, least: Any, ratio: Any, veil: Any) -> None:
    """Write ratio and veil (n, 3) of the pixels whose relative change (3, n) is above the least. haze: (3, n)."""
    one = np.float32(1.0)
    for i in range(len(ratio)):
        if max(abs(change[0, i]), abs(change[1, i]), abs(change[2, i])) > least:
            for k in range(3):
                ratio[i, k], veil[i, k] = one + change[k, i], haze[k, i]


@inlined
def _take_images(rows: Any, b: int, j: int, n: int, images: Any) -> None:
    """Set a row of block b, the n-th of all, to row j of those images that it has.

    rows: channels of `GroundLines.corner`, weight of the change, waves and added light. images: `PixelImages` of
    free, seen, waves, shape and added.
    """
    (line, weight, waves_row, added_row), (free_, seen_, waves_, shape_, added_) = rows, images
    # Find the numbers of its images, then take those that there are
    f, s, w, g, p = free_.at[n], seen_.at[n], waves_.at[n], shape_.at[n], added_.at[n]
    free, seen, waves, shape, added = free_.image, seen_.image, waves_.image, shape_.image, added_.image
    for i in range(BLOCK):
        at = b * BLOCK + i
        if g >= 0:
            weight[at] = shape[g, j, i, 3]
            for k in range(3):
                line[k, at], line[3 + k, at] = shape[g, j, i, k], shape[g, j, i, 4 + k]
        if f >= 0:
            for k in range(3):
                line[6 + k, at] = free[f, j, i, k]
        if s >= 0:
            line[9, at] = seen[s, j, i, 0]
        if w >= 0:
            for k in range(3):
                waves_row[k, at] = waves[w, j, i, k]
        if p >= 0:
            for k in range(3):
                added_row[k, at] = added[p, j, i, k]
