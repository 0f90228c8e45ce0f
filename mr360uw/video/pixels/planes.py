# SPDX-License-Identifier: Apache-2.0
"""Writes linear light into the planes of a video frame, one rectangle at a time.

`lay_over_planes` adds the *difference* between the new and the old light (`yuv.decoding`), in code values, to the old
codes: unchanged light keeps its code, and nothing is lost by a round trip through another colour space.

Chroma is sited as the decoder has it, and filtered [1 2 1]/4 along, [1 1]/2 across; a chroma sample is written only
where a pixel of its own block changed. Round a panorama, the column after the last one is the first.

    code' = code + span (E(new) - E(old)) + alpha grain + dither,    E: linear light -> R'G'B' -> Y' or C

Where an object of coverage alpha covers the plate, the detail of the old chroma that linear interpolation and the
filter do not return is scaled by 1 - alpha, so that no plate shines through an opaque object.

The encoding curve is a table, linearly interpolated: 128 samples in each octave of linear light from 2^-32 to 64, found
by the leading bits of the float, which follows the steep foot of a power law (error below 2e-6 of full scale).
The dither is interleaved gradient noise (Jimenez 2014), of the pixel's position and the frame's index alone: no
banding, no random state.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import code_range, in_plate_primaries
from mr360uw.types import Floats, Rectangle, Tile, YuvImage
from mr360uw.video.pixels.grain import NO_GRAIN, Grain, covered_box
from mr360uw.video.pixels.kernels import find_changes, write_chroma, write_luma
from mr360uw.yuv.coefficients import coefficients, encode_table, subsampling


def changed_pixels(tile: Tile) -> NDArray[np.bool_]:
    """Return where a tile changes the plate, (h, w): coverage, light, shafts, or a ratio other than 1."""
    out = np.empty(tile.alpha.shape, np.bool_)
    shafts = np.empty((0, 0, 3)) if tile.shafts is None else tile.shafts
    alpha, ratio, radiance, more = (
        np.ascontiguousarray(values, np.float32) for values in (tile.alpha, tile.ratio, tile.radiance, shafts)
    )
    find_changes(alpha, ratio, radiance, more, out)
    return out


def lay_over_planes(
    old: YuvImage,
    new: YuvImage,
    rectangle: Rectangle,
    linear: Floats,
    alpha: Floats,
    changed: NDArray[np.bool_],
    frame_index: int,
    wrap: bool = True,
    grain: Grain = NO_GRAIN,
    amount: float = 0.0,
) -> None:
    """Write linear Rec.709 light (h, w, 3) into a rectangle of the planes `new`, which hold a copy of `old`.

    Only pixels where `changed` (h, w) get a new luma code, and only chroma samples of 2x2 (or 2x1, 1x1) blocks with
    such a pixel a new chroma code. Light is clipped to code values between 0 and full scale (a plate that is itself
    brighter or darker keeps its excursion where it is not covered). alpha: (h, w) coverage of the plate. amount: of
    the grain that covered pixels get, 1 for as much as the plate has.
    """
    column, row = rectangle.column, rectangle.row
    linear = in_plate_primaries(linear, old.spec)
    sx, sy = subsampling(old)
    k, peak = coefficients(old.spec), np.float32((1 << old.spec.bits) - 1)
    light, cover = np.ascontiguousarray(linear, np.float32), np.ascontiguousarray(alpha, np.float32)
    chroma = np.empty((2, *alpha.shape), np.float32)
    strength = np.float32(amount) * grain.deviation
    noise, blotches = np.empty((0, 0), np.float32), np.empty((2, 0, 0), np.float32)
    if amount > 0.0 and strength.any() and cover.any():
        box = covered_box(cover)
        covered = box._replace(column=column + box.column, row=row + box.row)
        noise, blotches = _noise(grain, rectangle, covered, old, frame_index)
    write_luma(
        old.y, old.u, old.v, new.y, row, column, sx, sy, wrap,
        k, encode_table(old.spec), peak, light.view(np.uint32), cover, changed, frame_index,
        noise, strength[0], chroma,
    )  # fmt: skip
    write_chroma(
        old.u, old.v, new.y, new.u, new.v, row, column, sx, sy, wrap,
        k, peak, cover, changed, frame_index, blotches, strength[1:], chroma,
    )  # fmt: skip


def _samples(rectangle: Rectangle, sx: int, sy: int) -> Rectangle:
    """Return the samples of a subsampled plane that a rectangle of pixels touches."""
    column, row, width, height = rectangle
    i, j = column >> sx, row >> sy
    return Rectangle(i, j, ((column + width - 1) >> sx) - i + 1, ((row + height - 1) >> sy) - j + 1)


def _noise(
    grain: Grain, rectangle: Rectangle, covered: Rectangle, image: YuvImage, frame_index: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return noise for the luma (h, w) and the chroma samples (2, ...) of a rectangle, 0 outside of `covered`."""
    found = []
    for n, plane in enumerate((image.y, image.u, image.v)):
        sx, sy = subsampling(image) if n else (0, 0)
        all_, part = _samples(rectangle, sx, sy), _samples(covered, sx, sy)
        row, column = part.row - all_.row, part.column - all_.column
        noise = np.zeros((all_.height, all_.width), np.float32)
        noise[row : row + part.height, column : column + part.width] = grain.noise(n, frame_index, part, plane.shape[1])
        found.append(noise)
    return found[0], np.stack(found[1:])


def planes_from_linear(linear: Floats, planes: YuvImage, wrap: bool = True) -> None:
    """Write a whole picture of linear Rec.709 light (H, W, 3), dithered, into planes that are about to hold it."""
    y_offset, _, c_offset, _ = code_range(planes.spec)
    black = YuvImage(
        np.full_like(planes.y, y_offset),
        np.full_like(planes.u, c_offset),
        np.full_like(planes.v, c_offset),
        planes.spec,
    )
    np.copyto(planes.u, black.u)
    np.copyto(planes.v, black.v)
    everything = np.ones(planes.y.shape, np.float32)
    whole = Rectangle(0, 0, *planes.y.shape[::-1])
    lay_over_planes(black, planes, whole, linear, everything, everything > 0, 0, wrap)
