# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of `planes`, serial, outside Python's lock: a row of a tile is decoded, laid over and encoded at once.

k: `yuv.coefficients.coefficients`. sx, sy: log2 of the chroma subsampling. wrap: left and right edges meet. grain:
noise of variance 1 in a rectangle of a plane, or an empty array for none; strength: its standard deviation in parts of
the span, times the amount of grain, at equal steps of Y' from 0 to 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.base.cache import room
from mr360uw.base.constants import (
    DITHER_ALONG,
    DITHER_CONTRAST,
    DITHER_DOWN,
    DITHER_FRAMES,
    DITHER_LEAST,
    DITHER_STEP,
)
from mr360uw.base.tile_blend import BLOCK, blend_row, find_changes, ground_line, ground_room
from mr360uw.jit import fast, inlined
from mr360uw.yuv.decoding import (
    ENCODE_LOW,
    ENCODE_STEP_BITS,
    ENCODE_STEPS,
    chroma_row,
    light_row,
    luma_from_code,
)


@fast
def _encode_row(plate: Any, light_bits: Any, alpha: Any, k: Any, channel: int, table: Any, out: Any) -> None:
    """Write the step from the old R' (or G', B') of a row to that of its new light into `out`.

    plate: the old codes of luma, and chroma. light_bits: float32 read as uint32. table: (2, ENCODE_STEPS + 1), of light
    and of negative light. The new value is clipped to [0, 1], or as far outside as the old one was, where it is not
    covered.
    """
    (codes, cb, cr), offset, scale = plate, k[0], np.float32(1.0) / k[1]
    from_cb, from_cr = k[4 + 2 * channel], k[5 + 2 * channel]
    fraction_mask, sign_bit = np.uint32((1 << ENCODE_STEP_BITS) - 1), np.uint32(1 << 31)
    fraction_scale = np.float32(1.0 / (1 << ENCODE_STEP_BITS))
    first, last = np.int32(ENCODE_LOW), np.int32(ENCODE_STEPS - 1)
    zero, one = np.float32(0.0), np.float32(1.0)
    for c in range(out.size):  # look-ups apart: what remains is done by vector instructions
        magnitude = light_bits[c] & ~sign_bit
        step = np.int32(magnitude >> np.uint32(ENCODE_STEP_BITS)) - first
        i = np.uint32(min(max(step, np.int32(0)), last))
        side = np.uint32(light_bits[c] >> np.uint32(31))
        low = table[side, i]
        out[c] = low + np.float32(magnitude & fraction_mask) * fraction_scale * (table[side, i + np.uint32(1)] - low)
    for c in range(out.size):
        old = luma_from_code(codes[c], offset, scale) + from_cb * cb[c] + from_cr * cr[c]
        clear = one - alpha[c]
        out[c] = min(max(out[c], clear * min(old, zero)), one + clear * max(old - one, zero)) - old


@inlined
def _noise(row: int, column: int, frame: int) -> Any:
    """Return interleaved gradient noise, 0.001 to 0.999 (`constants.DITHER_ALONG`)."""
    shift = np.float32(DITHER_STEP) * np.float32(frame & (DITHER_FRAMES - 1))
    x, y = np.float32(np.int32(column)) + shift, np.float32(np.int32(row)) + shift
    ramp = np.float32(DITHER_ALONG) * x + np.float32(DITHER_DOWN) * y
    value = np.float32(DITHER_CONTRAST) * (ramp - np.float32(np.int32(ramp)))
    return np.float32(DITHER_LEAST) + np.float32(1.0 - 2.0 * DITHER_LEAST) * (value - np.float32(np.int32(value)))


@fast
def write_noise(row: int, column: int, frame: int, out: Any) -> None:
    """Write the noise of a rectangle that begins at (row, column) into `out` (h, w)."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[r, c] = _noise(row + r, column + c, frame)


@inlined
def _quantise(code: Any, noise: Any, peak: Any) -> Any:
    return np.int32(min(max(code + noise, np.float32(0.0)), peak))


@fast
def _lost_detail(plane: Any, j: int, i: int, sy: int, wrap: bool) -> Any:
    """Return the detail of a chroma code that interpolation and filter lose: the code less its blur [1 6 1]/8."""
    rows, columns = plane.shape
    left = i - 1 if i else (columns - 1 if wrap else 0)
    right = i + 1 if i + 1 < columns else (0 if wrap else i)
    six, eight = np.float32(6.0), np.float32(8.0)
    blur = np.float32(plane[j, left]) + six * np.float32(plane[j, i]) + np.float32(plane[j, right])
    if sy:
        up, down = max(j - 1, 0), min(j + 1, rows - 1)
        above = np.float32(plane[up, left]) + six * np.float32(plane[up, i]) + np.float32(plane[up, right])
        below = np.float32(plane[down, left]) + six * np.float32(plane[down, i]) + np.float32(plane[down, right])
        blur = (above + six * blur + below) / eight
    return np.float32(plane[j, i]) - blur / eight


@inlined
def _strength(luma: Any, strength: Any) -> Any:
    """Return the strength of the grain at Y' = `luma`."""
    place = luma * np.float32(strength.size - 1) + np.float32(0.5)
    return strength[np.int32(min(max(place, np.float32(0.0)), np.float32(strength.size - 1)))]


@fast
def _grain_row(codes: Any, cb: Any, cr: Any, alpha: Any, grain: Any, strength: Any, k: Any, steps: Any) -> None:
    """Add a row's luma grain to the steps of R', G', B' (3, w): grey has no chroma, and the luma weights sum to 1.

    It takes from a channel no more than that has, as the noise of a sensor does.
    """
    for c in range(codes.size):
        if alpha[c] > np.float32(0.0):
            old = (np.float32(codes[c]) - k[0]) / k[1]
            luma = old + k[10] * steps[0, c] + k[11] * steps[1, c] + k[12] * steps[2, c]
            step = alpha[c] * grain[c] * _strength(luma, strength)
            for n in range(3):
                before = old + k[4 + 2 * n] * cb[c] + k[5 + 2 * n] * cr[c]
                steps[n, c] = max(steps[n, c] + step, min(steps[n, c], -before))


@inlined
def _grain_left(luma: Any, cb: Any, cr: Any, cb_grain: Any, cr_grain: Any, k: Any) -> Any:
    """Return the fraction of a chroma sample's grain that leaves R', G' and B' of its darkest pixel at least 0."""
    left = np.float32(1.0)
    for n in range(3):
        value = luma + k[4 + 2 * n] * cb + k[5 + 2 * n] * cr
        change = k[4 + 2 * n] * cb_grain + k[5 + 2 * n] * cr_grain
        if value + left * change < np.float32(0.0) and change < np.float32(0.0):
            left = max(value, np.float32(0.0)) / -change
    return left


_GAP = 32
"""Pixels that do not change, in a row, between runs that are written apart: a run costs as much as about ten."""


@fast
def _next_run(changed: Any, begin: int) -> Any:
    """Return the first and the one after the last column of the next run of changed pixels of a row, from `begin` on;
    the same twice where there is none.
    """
    first = begin
    while first < changed.size and not changed[first]:
        first += 1
    after = first
    for c in range(first, changed.size):
        if changed[c]:
            after = c + 1
        elif c - after >= _GAP:
            break
    return first, after


def row_room(width: int) -> tuple[Any, ...]:
    """Return room of `write_planes` for a row of pixels, and for the rows that share a row of chroma samples."""
    of_row = room(width, width, (3, width), (width, 3), (width + 1, 3), (0, 3))  # the last one for what is returned
    of_ground = room((width, 3), (width, 3))
    of_chroma = room((2, 2, width), (3, width + 2)), room((2, width), width + 2, dtype=np.bool_)
    return *of_row, (ground_room(), *of_ground), *of_chroma


@fast
def write_planes(old: Any, new: Any, place: Any, coding: Any, tile: Any, ground: Any, grain: Any, work: Any) -> Any:
    """Write the pixels that a tile changes, and their chroma, into planes; return the brightest light and the sum of
    all, of which floats that are not finite make one.

    old, new: y, u and v of the plate, and of what is written. place: the tile's row and column, the frame's index, sx,
    sy and wrap. coding: k, `decode_table`, `encode_table` and the top code. tile: radiance, alpha, ratio, veil, shafts
    and composite, which are (0, 0, 3) for none, the composite for that of `blend_row`. ground: `GroundLines` that ratio
    and veil are worked out from where the tile has none. grain: (h, w) of luma, (2, samples down, samples across) of
    chroma, both without rows for none, and the strength (3, n) of both. work: of `row_room`.
    """
    (y, u, v), y_out, (row, column, frame, sx, sy, wrap) = old, new[0], place
    k, decoding, encoding, peak = coding
    (radiance, alpha, ratio, veil, shafts, composite), (noise, blotches, strength) = tile, grain
    cb, cr, steps, plate, light, none, of_ground, (chroma, sums), (changed, touched) = work
    (lines, own_ratio, own_veil), bits, bare = of_ground, light.view(np.uint32), len(ratio) == 0
    (height, width), one, grainy = alpha.shape, np.float32(1.0), noise.size > 0
    ordered, most, total = light.view(np.int32), np.int32(0), np.float32(0.0)  # bits of light sort as light does
    for j in range(row >> sy, ((row + height - 1) >> sy) + 1):
        begin, end, any_ = max((j << sy) - row, 0), min(((j + 1) << sy) - row, height), False
        for r in range(begin, end):
            # Work out the light on the ground, and find the pixels of a row that change
            b, q, more = r - begin, (row + r) // BLOCK, shafts[r] if len(shafts) else none
            codes, codes_out = y[row + r, column : column + width], y_out[row + r, column : column + width]
            decoded = bare and ground.patterned and ground.first[q] < ground.first[q + 1]
            if decoded:
                chroma_row(u, (row + r, column, sx, sy, wrap), k[2], k[3], cb)
                chroma_row(v, (row + r, column, sx, sy, wrap), k[2], k[3], cr)
                light_row(codes, cb, cr, k, decoding, steps, plate)
            if bare:
                flat_ratio, flat_veil = own_ratio.reshape(-1), own_veil.reshape(-1)
                for n in range(3 * width):
                    flat_ratio[n], flat_veil[n] = one, np.float32(0.0)
                ground_line(ground, row + r, column, plate, lines, own_ratio, own_veil)
            share, haze = own_ratio if bare else ratio[r], own_veil if bare else veil[r]
            find_changes(alpha[r], radiance[r], share, more, changed[b])
            chroma[:, b] = np.float32(0.0)
            first, after = _next_run(changed[b], 0)
            while first < after:
                any_, part = True, slice(first, after)
                # Decode the plate and lay the tile over it
                if not decoded:
                    chroma_row(u, (row + r, column + first, sx, sy, wrap), k[2], k[3], cb[part])
                    chroma_row(v, (row + r, column + first, sx, sy, wrap), k[2], k[3], cr[part])
                if len(composite):
                    for c in range(first, after):
                        for n in range(3):
                            light[c, n] = composite[r, c, n]
                else:
                    if not decoded:
                        light_row(codes[part], cb[part], cr[part], k, decoding, steps[:, part], plate[part])
                    blend_row(plate[part], radiance[r, part], alpha[r, part], share[part], haze[part], more[part], one,
                              light[part])  # fmt: skip
                # Note the brightest light, and the sum of all
                written, in_order = light[part].reshape(-1), ordered[part].reshape(-1)
                for n in range(len(written)):
                    most = max(most, in_order[n])
                    total += written[n]
                # Encode the difference, with the grain
                for n in range(3):
                    old_row = codes[part], cb[part], cr[part]
                    _encode_row(old_row, bits[part, n], alpha[r, part], k, n, encoding, steps[n, part])
                if grainy:
                    own = noise[r, part]
                    _grain_row(codes[part], cb[part], cr[part], alpha[r, part], own, strength[0], k, steps[:, part])
                # Add it to the codes of luma, and keep that of chroma
                red, green, blue = k[1] * k[10], k[1] * k[11], k[1] * k[12]
                (old_y, new_y), here = (codes[part], codes_out[part]), changed[b, part]
                red_step, green_step, blue_step = steps[0, part], steps[1, part], steps[2, part]
                for c in range(len(here)):
                    step = red * red_step[c] + green * green_step[c] + blue * blue_step[c]
                    code = _quantise(np.float32(old_y[c]) + step, _noise(row + r, column + first + c, frame), peak)
                    new_y[c] = code if here[c] else new_y[c]
                for n in range(2):
                    red, green, blue = k[3] * k[13 + 3 * n], k[3] * k[14 + 3 * n], k[3] * k[15 + 3 * n]
                    row_of_chroma = chroma[n, b, part]
                    for c in range(len(here)):
                        step = red * red_step[c] + green * green_step[c] + blue * blue_step[c]
                        row_of_chroma[c] = step if here[c] else np.float32(0.0)
                first, after = _next_run(changed[b], after)
        if any_:
            change = chroma, alpha[begin:end], changed[: end - begin]
            _write_chroma(old, new, place, (k, peak), j, change, (blotches, strength[1:]), (sums, touched))
    ordered[width, 0] = most
    return light[width, 0], total


@fast
def _write_chroma(old: Any, new: Any, place: Any, coding: Any, j: int, change: Any, grain: Any, work: Any) -> None:
    """Add the change of the pixels' chroma to the samples of row j of the blocks with a changed pixel.

    Adding lets two rectangles share a block. old, new, place: see `write_planes`; the new luma has been written.
    coding: k and the top code. change: (2, 2, w) of the rows of pixels of the samples, their alpha, and whether they
    change. grain: (2, blocks down, blocks across), and its strength (2, n). work: for sums of three numbers of a row of
    pixels and one more to either side, and whether they change.
    """
    (_, u, v), (y_out, u_out, v_out), (row, column, frame, sx, sy, wrap), (k, peak) = old, new, place, coding
    (chroma, alpha, changed), (blotches, strength), (steps, touched) = change, grain, work
    rows, width = alpha.shape
    # Sum down a block, for the pixels of a row and one more to either side
    steps[:], touched[:] = np.float32(0.0), False
    scale = np.float32(1.0) / np.float32((4 if sx else 1) * (2 if sy else 1))
    side, middle = np.float32(1.0 if sx else 0.0), np.float32(2.0 if sx else 1.0)
    for r in range(rows):
        for c in range(width):
            steps[0, c + 1] += chroma[0, r, c]
            steps[1, c + 1] += chroma[1, r, c]
            steps[2, c + 1] += alpha[r, c] if changed[r, c] else np.float32(0.0)
            touched[c + 1] |= changed[r, c]
    for i in range(column >> sx, ((column + width - 1) >> sx) + 1):
        c = (i << sx) - column + 1
        if not (touched[c] or touched[c + sx]):
            continue
        # Filter the change along the row
        before = c - 1 if c > 1 else c  # the column left of the rectangle is taken to change like its first one
        cb_step = side * (steps[0, before] + steps[0, c + sx]) + middle * steps[0, c]
        cr_step = side * (steps[1, before] + steps[1, c + sx]) + middle * steps[1, c]
        cover = side * (steps[2, before] + steps[2, c + sx]) + middle * steps[2, c]
        cb = np.float32(u_out[j, i]) + cb_step * scale
        cr = np.float32(v_out[j, i]) + cr_step * scale
        # Take off the detail of the plate that a body hides, and add the grain
        if sx and cover > np.float32(0.0):
            cb -= cover * scale * _lost_detail(u, j, i, sy, wrap)
            cr -= cover * scale * _lost_detail(v, j, i, sy, wrap)
        if blotches.size > 0 and cover > np.float32(0.0):
            luma = (np.float32(y_out[j << sy, i << sx]) - k[0]) / k[1]
            m, n = j - (row >> sy), i - (column >> sx)
            cb_grain = cover * scale * blotches[0, m, n] * _strength(luma, strength[0])
            cr_grain = cover * scale * blotches[1, m, n] * _strength(luma, strength[1])
            for down in range(min(1 + sy, y_out.shape[0] - (j << sy))):
                for right in range(min(1 + sx, y_out.shape[1] - (i << sx))):
                    luma = min(luma, (np.float32(y_out[(j << sy) + down, (i << sx) + right]) - k[0]) / k[1])
            left = _grain_left(luma, (cb - k[2]) / k[3], (cr - k[2]) / k[3], cb_grain, cr_grain, k)
            cb += left * cb_grain * k[3]
            cr += left * cr_grain * k[3]
        # Other corners of the noise than luma's, so that the three do not round up together
        u_out[j, i] = _quantise(cb, _noise(j + 17, i + 59, frame), peak)
        v_out[j, i] = _quantise(cr, _noise(j + 101, i + 31, frame), peak)
