# SPDX-License-Identifier: Apache-2.0
"""Irradiance ratio E_with/E_without of the receiver: its change by objects, waves and lamps.

    ratio = 1 + w (share free + (1 - share) seen waves + added - 1)

with share the ambient fraction of the plate's irradiance, free the fraction of it that bodies leave, with what they
send there themselves, seen the visible fraction of the plate's direct light, waves the caustic factor on it, added the
irradiance of lamps over that of the plate, and w the weight that fades out towards the receiver's end.

Over blocks of pixels it is written into tiles in one compiled pass, with r of pattern.py, which is 1 without a pattern:

    ratio = 1 + w (sun + (share (free - sun) + added)/r - 1)        sun = seen waves

Each quantity is interpolated between the corners of a block, or taken from an image of the block's pixels if there is
one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.lighting.light_sources import LightSource
from mr360uw.composite.lighting.shading import ambient_irradiance
from mr360uw.composite.receiver.pattern import (
    LEAST_DIRECT,
    LEAST_LIGHT,
    NO_BLURS,
    PlatePattern,
    calm_line,
    direct_pattern,
    drawn_towards,
)
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import places_in_mask
from mr360uw.constants import BRIGHTEST, DARK
from mr360uw.jit import fast, inlined
from mr360uw.texels import smoothstep
from mr360uw.types import Floats, Rectangle, Tile

FADE_FROM = 0.8
"""Fraction of its extent from which the receiver fades out, so that shadow and waves end without a line."""
BLOCK = 8
"""Pixels along a block."""
SHARE, VEIL, FREE, SEEN = slice(0, 3), slice(3, 6), slice(6, 9), 9
CORNER_CHANNELS = 10
_AT_ONCE = 32
"""Most blocks beside each other that are computed together: compilers vectorise loops that are longer than a block.
Half as many or twice as many take as long."""
_MIDDLE = ((np.arange(BLOCK) + 0.5) / BLOCK).astype(np.float32)
"""Where the pixels of a block lie, along it."""


def ambient_share(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> Floats:
    """Return the ambient fraction (n, 3) of the plate's irradiance on the receiver; 0 in the dark."""
    ambient, beam = _plate_light(shot, sources, point, normal)
    return ambient / np.maximum(ambient + beam, DARK)


def _plate_light(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return the ambient and the direct irradiance (n, 3) of the plate on the receiver."""
    ambient, beam = ambient_irradiance(shot, point, normal), np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            direction, irradiance, _ = source.arrival(point)
            beam = beam + irradiance * np.maximum(np.sum(normal * direction, -1), 0.0)[:, None]
    return ambient, beam


def added_light(
    shot: Shot,
    sources: Sequence[LightSource],
    point: Floats,
    normal: Floats,
    sides: Floats | None = None,
    *,
    shadows: bool = True,
) -> Floats:
    """Return the irradiance (n, 3) of sources that are not in the plate, over that of the plate.

    sides: (n, 2, 3) [m] of footprints, over which shadows are averaged; None for points.
    """
    added = np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            continue
        direction, irradiance, _ = source.arrival(point)
        cosine = np.maximum(np.sum(normal * direction, -1), 0.0)
        seen = source.visibility(point, sides) if shadows else np.ones(len(point))
        added = added + irradiance * (cosine * seen)[:, None]
    if np.any(added):
        ambient, beam = _plate_light(shot, sources, point, normal)
        added = np.minimum(added / np.maximum(ambient + beam, DARK), BRIGHTEST)
    return added


def receiver_ratio(
    shot: Shot,
    sources: Sequence[LightSource],
    free: Floats,
    point: Floats,
    normal: Floats,
    distance_m: Floats,
    plate: tuple[Floats, Floats, Floats] | None = None,
    sides: Floats | None = None,
) -> Floats:
    """Return E_with/E_without (n, 3) at points of the receiver, 1 where it ends.

    free: (n, 3) fraction of the ambient light that bodies leave there, with what they send. plate: its light, its calm
    light and its veil there, each (n, 3), where it has a pattern (see pattern.py). sides: (n, 2, 3) [m] of the pixels
    on the receiver, over which shadows are averaged; None for points.
    """
    receiver = shot.receiver
    assert receiver is not None
    seen: Floats = np.ones(len(point))
    waves: Floats = np.ones((len(point), 3))
    for source in sources:
        if source.in_plate:
            seen = source.visibility(point, sides) if receiver.shadow else seen
            waves = source.pattern(point, distance_m * np.pi / shot.view.height) if receiver.caustics else waves
    share = ambient_share(shot, sources, point, normal)
    r = np.ones_like(share) if plate is None else direct_pattern(*plate, share)
    ratio = share * free + (r - share) * seen[:, None] * waves
    ratio = (ratio + added_light(shot, sources, point, normal, sides)) / r
    weight = 1.0 - smoothstep(distance_m / receiver.extent_m, FADE_FROM, 1.0)
    return 1.0 + weight[:, None] * (ratio - 1.0)


# --- over blocks of pixels -------------------------------------------------------------------------------------------


class PixelImages(NamedTuple):
    """Images of some blocks, (m, B, B, k) float32. at: (n,) for each block the number of its image, or -1."""

    at: NDArray[np.int32]
    image: NDArray[np.float32]


Gathered = list[tuple[NDArray[np.bool_], NDArray[np.float32]]]
"""Pairs of a mask (n,) of m blocks and their images (m, B, B, k)."""


def gather_images(count: int, channels: int, parts: Gathered) -> PixelImages:
    """Return the images of `count` blocks from parts, each block in one part at most."""
    at, first, every = np.full(count, -1, np.int32), 0, [np.zeros((0, BLOCK, BLOCK, channels), np.float32)]
    for which, images in parts:
        at[which] = first + np.arange(len(images))
        first += len(images)
        every.append(images)
    return PixelImages(at, np.concatenate(every))


@dataclass(frozen=True, slots=True, eq=False)
class BlockLight:
    """Light on blocks of the receiver.

    blocks: (R, C) which they are, n of them, row by row. corner: (R + 1, C + 1, 10) float32, channels SHARE, VEIL,
    FREE, SEEN. Images of pixels, used instead of corners: free (k = 3), seen (1), waves (3), shape (7: share, weight,
    veil), added (3; 0 if there is none).
    """

    blocks: NDArray[np.bool_]
    corner: NDArray[np.float32]
    free: PixelImages
    seen: PixelImages
    waves: PixelImages
    shape: PixelImages
    added: PixelImages


def lay_receiver(
    light: BlockLight, tiles: Sequence[Tile], width: int, height: int, pattern: PlatePattern | None, unseen: float
) -> None:
    """Write ratio and veil of the blocks into tiles of a width x height frame, where they change the plate by a
    fraction of more than `unseen`.

    pattern: the plate's own caustics, which go with the sun's light (see pattern.py).
    """
    none, images = np.zeros((0, 0, 3), np.float32), (light.free, light.seen, light.waves, light.shape, light.added)
    row, column = places_in_mask(light.blocks)
    blurs = NO_BLURS
    if pattern is not None:
        left, top, right, bottom = BLOCK * np.array([column.min(), row.min(), column.max() + 1, row.max() + 1])
        hull = Rectangle(int(left), int(top), int(min(right, width) - left), int(min(bottom, height) - top))
        blurs = pattern.blurs(hull)
    strength = np.float32(0.0 if pattern is None else pattern.strength)
    for tile in tiles:
        part = tile.rectangle
        shown, mean = (none, none) if pattern is None else (pattern.picture.linear(part), pattern.mean_of(part))
        plate = np.ascontiguousarray(shown, np.float32), mean, tuple(blurs), strength
        _lay(
            (row, column, light.corner), images, (width, height, tile.row, tile.column), plate,
            np.float32(unseen), (tile.ratio, tile.veil),
        )  # fmt: skip


@inlined
def _plate_line(plate: Any, at: Any, now: Any, calm: Any) -> None:
    """Write the light that the plate shows on a line (3, n), and its calm state. plate: see `_lay`. at: row and column
    in the frame, and in the tile.
    """
    (shown, mean, blurs, strength), (y, x, r, first) = plate, at
    if len(mean) == 0:
        calm_line(blurs, y, x, calm)
    for i in range(now.shape[1]):
        for k in range(3):
            now[k, i] = shown[r, first + i, k]
            calm[k, i] = mean[r, first + i, k] if len(mean) else drawn_towards(now[k, i], strength, calm[k, i])


@inlined
def _inverse_pattern(plate: Any, line: Any, count: int, inverse: Any) -> None:
    """Write one over what `pattern.direct_pattern` returns into `inverse` (3, n), with one division for a value.

    plate: (2, 3, n) its light and its calm state.
    """
    one, dark, direct = np.float32(1.0), np.float32(LEAST_LIGHT), np.float32(LEAST_DIRECT)
    for k in range(3):
        share, veil, now, mean, out = line[k], line[3 + k], plate[0, k], plate[1, k], inverse[k]
        for i in range(count):
            light, base, least = now[i] - veil[i], mean[i] - veil[i], share[i] + direct * (one - share[i])
            lit = light > least * base
            part, whole = base if lit else one, light if lit else least
            out[i] = part / whole if base > dark else one


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

    rows: channels of `BlockLight.corner`, weight of the change, waves and added light. images: `PixelImages` of free,
    seen, waves, shape and added.
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


@inlined
def _even(corner: Any, q: int, z: int, least: Any) -> bool:
    """Return whether hardly anything changes at the corners of block (q, z)."""
    one, most = np.float32(1.0), np.float32(0.0)
    for k in range(6, 10):
        most = max(most, abs(corner[q, z, k] - one), abs(corner[q, z + 1, k] - one),
                   abs(corner[q + 1, z, k] - one), abs(corner[q + 1, z + 1, k] - one))  # fmt: skip
    return bool(most < np.float32(0.5) * least)


@fast
def _lay(blocks: Any, images: Any, frame: Any, plate: Any, least: Any, tile: Any) -> None:
    """Write ratio and veil of the blocks into a tile, see `lay_receiver`.

    blocks: rows and columns, and corner of `BlockLight`. images: its `PixelImages`.
    frame: width and height, and row and column of the tile. plate: its light, its mean or none, and the blurs and the
    strength by which it is drawn towards them without one. least: change that is written. tile: ratio and veil.
    """
    row, column, corner = blocks
    free, seen, waves, shape, _ = images
    (width, height, first_row, first_column), (ratio, veil) = frame, tile
    # Make room for one row of some blocks
    room = _AT_ONCE * BLOCK
    line, weight = np.empty((10, room), np.float32), np.empty(room, np.float32)
    side = np.empty((10, _AT_ONCE + 1), np.float32)
    waves_row, added_row = np.empty((3, room), np.float32), np.empty((3, room), np.float32)
    plate_row, inverse = np.ones((2, 3, room), np.float32), np.ones((3, room), np.float32)
    change = np.empty((3, room), np.float32)
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    begin, end = 0, 0
    while end < len(row):
        begin, q, z = end, row[end], column[end]
        # blocks beside each other that change
        while end < len(row) and end - begin < _AT_ONCE and row[end] == q and column[end] == z + end - begin:
            pixels = free.at[end] >= 0 or seen.at[end] >= 0 or waves.at[end] >= 0 or shape.at[end] >= 0
            if not pixels and _even(corner, q, column[end], least):
                break
            end += 1
        if end == begin:
            end += 1
            continue
        top, left = q * BLOCK, z * BLOCK
        y0, y1 = max(top, first_row), min(top + BLOCK, height, first_row + ratio.shape[0])
        x0, x1 = max(left, first_column), min(left + (end - begin) * BLOCK, width, first_column + ratio.shape[1])
        if y0 >= y1 or x0 >= x1:
            continue
        across_row, inside = slice(x0 - first_column, x1 - first_column), slice(x0 - left, x1 - left)
        blocks = end - begin
        for i in range(blocks * BLOCK):
            weight[i] = one
            for k in range(3):
                waves_row[k, i], added_row[k, i] = one, zero
        down = one / np.float32(min(BLOCK, height - top))
        for y in range(y0, y1):
            j, v, r = y - top, (np.float32(y - top) + half) * down, y - first_row
            _between(corner, q, z, v, side, line, blocks)
            for b in range(blocks):
                _take_images((line, weight, waves_row, added_row), b, j, begin + b, images)
            if len(plate[0]):
                at = y, x0, r, x0 - first_column
                _plate_line(plate, at, plate_row[0, :, inside], plate_row[1, :, inside])
                _inverse_pattern(plate_row, line, blocks * BLOCK, inverse)
            for k in range(3):
                share, fall, sun, free_row = line[k], waves_row[k], line[9], line[6 + k]
                more, per_light, out = added_row[k], inverse[k], change[k]
                for i in range(blocks * BLOCK):
                    lit = sun[i] * fall[i]
                    left_over = share[i] * (free_row[i] - lit) + more[i]
                    out[i] = weight[i] * (lit + left_over * per_light[i] - one)
            _write(change[:, inside], line[3:6, inside], least, ratio[r, across_row], veil[r, across_row])
