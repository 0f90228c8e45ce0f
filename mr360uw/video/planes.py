# SPDX-License-Identifier: Apache-2.0
"""Writes linear light, and the grain of the plate, into the planes of a video frame, one rectangle at a time.

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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import av
import numpy as np
from av.sidedata.sidedata import SideDataContainer, Type
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import (
    ColorSpec,
    Transfer,
    code_range,
    decode,
    encode,
    in_plate_primaries,
    rgb_from_ycbcr,
    ycbcr_from_rgb,
)
from mr360uw.base.tile_blend import NO_GROUND, blended, changed_pixels, light_sum
from mr360uw.jit import fast, inlined
from mr360uw.types import Floats, Rectangle, Tile, UnlaidGround, YuvImage
from mr360uw.video.plane_kernels import row_room, write_planes
from mr360uw.yuv.decoding import coefficients, decode_table, encode_table, linear_from_planes, subsampling


def lay_over_planes(
    old: YuvImage,
    new: YuvImage,
    tile: Tile,
    frame_index: int,
    wrap: bool = True,
    grain: Grain | None = None,
    composite: Floats | None = None,
    ground: UnlaidGround | None = None,
) -> tuple[float, float]:
    """Lay a tile over the planes `old` and write what it changes into `new`, which hold a copy of them.

    Only pixels that it covers, lights or darkens get a new luma code, and only chroma samples of 2x2 (or 2x1, 1x1)
    blocks with such a pixel a new chroma code. Light is clipped to code values between 0 and full scale (a plate that
    is itself brighter or darker keeps its excursion where it is not covered). grain: that covered pixels get.
    composite: linear Rec.709 light (h, w, 3) to write; None for that of `tile_blend`. ground: has the tile's ratio and
    veil, over a plate of Rec.709; None where the tile has them. Returns the brightest linear light that was written,
    and a sum of it that is not finite where any is not.
    """
    sx, sy = subsampling(old)
    none, found = np.empty((0, 0, 3), np.float32), None
    if composite is None and not old.spec.is_rec709:
        composite = blended(linear_from_planes(old, tile.rectangle, wrap), tile)
    if composite is not None:
        found = float(composite.max()), light_sum(composite)
        composite = in_plate_primaries(composite, old.spec)
    # Take what the tile has; its ratio and veil where no ground is to be laid
    ratio, veil = (tile.ratio, tile.veil) if ground is None else (None, None)
    parts = (tile.radiance, tile.alpha, ratio, veil, tile.shafts, composite)
    arrays = tuple(none if part is None else np.ascontiguousarray(part, np.float32) for part in parts)
    grain = grain or NO_GRAIN
    strength = grain.deviation
    noise, blotches = np.empty((0, 0), np.float32), np.empty((2, 0, 0), np.float32)
    if strength.any() and arrays[1].any():
        noise, blotches = _noise(grain, tile, old, frame_index)
    # Decode, blend and encode
    spec = old.spec
    coding = coefficients(spec), decode_table(spec), encode_table(spec), np.float32((1 << spec.bits) - 1)
    brightest, total = write_planes(
        (old.y, old.u, old.v), (new.y, new.u, new.v), (tile.row, tile.column, frame_index, sx, sy, wrap), coding,
        arrays, NO_GROUND if ground is None else ground.lines, (noise, blotches, strength),
        row_room(tile.rectangle.width),
    )  # fmt: skip
    return (float(brightest), float(total)) if found is None else found


def _samples(rectangle: Rectangle, sx: int, sy: int) -> Rectangle:
    """Return the samples of a subsampled plane that a rectangle of pixels touches."""
    column, row, width, height = rectangle
    i, j = column >> sx, row >> sy
    return Rectangle(i, j, ((column + width - 1) >> sx) - i + 1, ((row + height - 1) >> sy) - j + 1)


def _noise(
    grain: Grain, tile: Tile, image: YuvImage, frame_index: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return noise for the luma (h, w) and the chroma samples (2, ...) of a tile, 0 beside what it covers."""
    box, found = covered_box(tile.alpha), []
    covered = box._replace(column=tile.column + box.column, row=tile.row + box.row)
    for n, plane in enumerate((image.y, image.u, image.v)):
        sx, sy = subsampling(image) if n else (0, 0)
        all_, part = _samples(tile.rectangle, sx, sy), _samples(covered, sx, sy)
        row, column = part.row - all_.row, part.column - all_.column
        noise = np.zeros((all_.height, all_.width), np.float32)
        noise[row : row + part.height, column : column + part.width] = grain.noise(n, frame_index, part, plane.shape[1])
        found.append(noise)
    return found[0], np.stack(found[1:])


def planes_from_linear(linear: Floats, planes: YuvImage, wrap: bool = True) -> None:
    """Write a whole picture of linear Rec.709 light (H, W, 3), dithered, into planes that are about to hold it."""
    y_offset, _, c_offset, _ = code_range(planes.spec)
    of_luma, of_chroma = np.full_like(planes.y, y_offset), np.full_like(planes.u, c_offset)
    black = YuvImage(of_luma, of_chroma, of_chroma, planes.spec)
    planes.u[...] = planes.v[...] = c_offset
    everything = np.ones(planes.y.shape, np.float32)
    opaque = Tile(0, 0, linear, everything, everything, np.ones_like(linear), linear)
    lay_over_planes(black, planes, opaque, 0, wrap, composite=linear)


# Converts between the code values of RGB pictures (PNG, JPEG, EXR) and linear light.


def peak_code(codes: NDArray[Any]) -> float:
    """Return the code value of full scale: 255, 65535, or 1 of floating point pictures."""
    return float(np.iinfo(codes.dtype).max) if codes.dtype.kind == "u" else 1.0


@shared(keep=8)
def _decode_table(peak: int, transfer: Transfer) -> NDArray[np.float32]:
    return np.asarray(decode(np.arange(peak + 1) / peak, transfer), np.float32)


def linear_from_codes(codes: NDArray[Any], transfer: Transfer) -> NDArray[np.float32]:
    """Return the linear light of code values (..., 3), float32."""
    if codes.dtype.kind == "u":
        return _decode_table(int(peak_code(codes)), transfer)[codes]
    return decode(np.asarray(codes, np.float32), transfer).astype(np.float32)


def noise(rows: int, columns: int, row: int, column: int, frame_index: int) -> NDArray[np.float32]:
    """Return the dither of a rectangle (rows, columns), in (0, 1); see `planes`."""
    from mr360uw.video.plane_kernels import write_noise

    dither = np.empty((rows, columns), np.float32)
    write_noise(row, column, frame_index, dither)
    return dither


def codes_from_linear(linear: Floats, transfer: Transfer, dtype: Any, frame_index: int) -> NDArray[Any]:
    """Return dithered code values of linear light (H, W, 3), clipped to full scale; dtype uint8 or uint16."""
    peak = float(np.iinfo(dtype).max)
    dither = noise(linear.shape[0], linear.shape[1], 0, 0, frame_index)[..., None]
    return np.clip(np.floor(encode(linear, transfer) * peak + dither), 0.0, peak).astype(dtype)


def lay_over_codes(codes: NDArray[Any], linear: Floats, tile: Tile, transfer: Transfer, frame_index: int) -> None:
    """Write the composite of a tile, linear light (h, w, 3), into a picture's code values, where the tile changes them.

    Integer codes are clipped to full scale and dithered; floating point pictures take the new light as it is.
    """
    part, changed = codes[tile.window], changed_pixels(tile)
    if codes.dtype.kind == "f":
        part[changed] = encode(linear[changed], transfer)
        return
    peak, (rows, columns) = peak_code(codes), changed.shape
    dither = noise(rows, columns, tile.row, tile.column, frame_index)[changed][:, None]
    new = encode(np.asarray(linear[changed], np.float64), transfer) * peak
    part[changed] = np.clip(np.floor(new + dither), 0.0, peak).astype(codes.dtype)


# Converts between PyAV frames and planes.


def plane_views(native: Any, spec: ColorSpec, *, locked: bool = False) -> YuvImage:
    """Return the planes of a PyAV frame as arrays that share its memory and keep it alive. locked: read-only."""
    dtype = np.dtype(np.uint8 if spec.bits <= 8 else np.uint16)
    y, u, v = (_view(plane, dtype) for plane in native.planes)
    for plane in (y, u, v):
        plane.flags.writeable = plane.flags.writeable and not locked
    return YuvImage(y, u, v, spec)


def _view(plane: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    rows = np.frombuffer(plane, dtype).reshape(plane.height, plane.line_size // dtype.itemsize)
    return rows[:, : plane.width]


def pixel_format(image: YuvImage) -> str:
    """Return FFmpeg's name of the planes' layout; full range of 8 bits has a name of its own."""
    (height, width), (rows, columns) = image.y.shape, image.u.shape
    kind = "444" if columns == width else "422" if rows == height else "420"
    if image.spec.bits == 8:
        return f"yuv{'j' if image.spec.full_range else ''}{kind}p"
    return f"yuv{kind}p{image.spec.bits}le"


def native_frame(image: YuvImage, name: str | None = None) -> Any:
    """Return a new PyAV frame with a copy of the planes, optionally under another name of the same layout."""
    height, width = image.y.shape
    native = av.VideoFrame(width, height, name or pixel_format(image))
    for plane, source in zip(native.planes, (image.y, image.u, image.v), strict=True):
        np.copyto(_view(plane, source.dtype), source)
    return native


def has_stereo_mark(native: Any) -> bool:
    """Return whether a decoded frame has a mark of how its eyes are arranged.

    x264 takes a new arrangement for a change of settings in mid-stream, after which "lossless" loses a few codes.
    """
    return side_data_of(native).get(Type.STEREO3D) is not None


def side_data_of(native: Any) -> Any:
    """Return what a decoded frame holds beside its planes, by its type.

    A frame keeps its `side_data`, which keeps the frame: neither would be let go of.
    """
    container: Any = SideDataContainer
    return container(native)


# --- Grain of the plate ---------------------------------------------------------------------------------------------

# Adds grain of the plate's spectrum and strength to the composite, where a layer covers the plate.
#
#     code' = code + amount alpha(pixel) deviation(brightness) noise(place, frame)
#
# noise is white noise filtered to the spectrum's shape, of variance 1. Codes are in units of full scale, Y' from 0 to
# 1. `grain_measure` finds spectrum and strength.
#
# White noise is a hash of the pixel's place, its plane and the frame's index, so any rectangle of any frame can be had
# by itself (counter-based, as Salmon 2011). The hash is the finaliser of SplitMix64 (Steele 2014, variant 13). Four of
# its 16-bit pieces add up to a nearly normal number that is never beyond 3.5 standard deviations.


_DEVIATION = np.float32(np.sqrt((2.0**32 - 1.0) / 3.0))
"""Standard deviation of the sum of four independent integers, each even over [0, 2^16)."""


@inlined
def _mixed(z: Any) -> Any:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@fast
def white_noise(frame: int, plane: int, row: int, column: int, columns: int, out: Any) -> None:
    """Write noise of mean 0 and variance 1 into `out` (h, w); it repeats after `columns` columns."""
    step, low = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFFFF)
    stream = _mixed(np.uint64(frame) * step + np.uint64(plane + 1))
    for r in range(out.shape[0]):
        along = _mixed(stream + np.uint64(row + r + (1 << 32)) * step)
        for c in range(out.shape[1]):
            z = _mixed(along + np.uint64((column + c) % columns) * step)
            total = (z & low) + ((z >> np.uint64(16)) & low) + ((z >> np.uint64(32)) & low) + (z >> np.uint64(48))
            out[r, c] = (np.float32(total) - np.float32(131070.0)) / _DEVIATION


@fast
def survey(blocks: Any, out: Any) -> None:
    """Write (lowest value, highest value, mean, roughness) of blocks (n, h, w) into `out` (n, 4).

    Roughness is the energy of the second differences, lags 1, 2 and 4, both ways.
    """
    count, height, width = blocks.shape
    for n in range(count):
        block = blocks[n]
        low, high, total, rough = block[0, 0], block[0, 0], np.float32(0.0), np.float32(0.0)
        for r in range(height):
            for c in range(width):
                low, high, total = min(low, block[r, c]), max(high, block[r, c]), total + block[r, c]
        for lag in (1, 2, 4):
            for r in range(lag, height - lag):
                for c in range(lag, width - lag):
                    twice = np.float32(2.0) * block[r, c]
                    across = block[r, c - lag] - twice + block[r, c + lag]
                    down = block[r - lag, c] - twice + block[r + lag, c]
                    rough += across * across + down * down
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = low, high, total / np.float32(height * width), rough


RADIUS = 5
"""Radius of the filter [px]: correlations of codecs end within a few pixels; time grows with the square."""
TABLE = 64
"""Samples of the strength's curve over brightness, Y' from 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Grain:
    """The grain of a frame's planes Y', Cb, Cr.

    deviation: (3, TABLE) standard deviation over brightness, Y' from 0 to 1. filters: (3, 2 RADIUS + 1, 2 RADIUS + 1),
    squares sum to 1 (0 where a plane has no grain). transfer: the curve of the code values.
    """

    deviation: NDArray[np.float32]
    filters: NDArray[np.float32]
    transfer: Transfer = "srgb"

    def noise(self, plane: int, frame_index: int, rectangle: Rectangle, columns: int) -> NDArray[np.float32]:
        """Return grain of variance 1 in a rectangle of a plane, (height, width).

        columns: of the whole plane, after which the noise starts again.
        """
        import cv2

        column, row, width, height = rectangle
        white = np.empty((height + 2 * RADIUS, width + 2 * RADIUS), np.float32)
        white_noise(frame_index, plane, row - RADIUS, (column - RADIUS) % columns, columns, white)
        found = cv2.filter2D(white, -1, self.filters[plane])
        return np.ascontiguousarray(found[RADIUS : RADIUS + height, RADIUS : RADIUS + width])

    def at(self, plane: int, brightness: Floats) -> NDArray[np.float32]:
        """Return the standard deviation in a plane where Y' is `brightness` (...)."""
        place = np.clip(np.asarray(brightness) * (TABLE - 1) + 0.5, 0, TABLE - 1).astype(np.int64)
        return self.deviation[plane][place]


NO_GRAIN = Grain(np.zeros((3, TABLE), np.float32), np.zeros((3, 2 * RADIUS + 1, 2 * RADIUS + 1), np.float32))


def covered_box(alpha: Floats) -> Rectangle:
    """Return the smallest rectangle around the coverage (h, w) above 0; there is some."""
    rows, columns = (np.flatnonzero(np.any(alpha > 0.0, axis=axis)) for axis in (1, 0))
    width, height = int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1)
    return Rectangle(int(columns[0]), int(rows[0]), width, height)


def add_grain(linear: Floats, tile: Tile, grain: Grain, amount: float, columns: int, frame_index: int) -> Floats:
    """Return the composite of one tile, linear (h, w, 3), with grain where the tile covers the plate.

    grain: of `grain_of_rgb`; it is added to code values. columns: of the whole frame.
    """
    if not np.any(tile.alpha > 0.0):
        return linear
    column, row, width, height = covered_box(tile.alpha)
    window = slice(row, row + height), slice(column, column + width)
    code = encode(linear[window], grain.transfer)
    brightness = code @ ycbcr_from_rgb("bt709")[0]
    place = Rectangle(tile.column + column, tile.row + row, width, height)
    step = [grain.noise(n, frame_index, place, columns) * grain.at(n, brightness) for n in range(3)]
    alpha = tile.alpha[window][..., None]
    grainy = code + amount * alpha * (np.stack(step, axis=-1) @ rgb_from_ycbcr("bt709").T)
    out = linear.copy()
    dark = np.minimum(linear[window], 0.0)  # grain makes no light negative that was not
    out[window] = np.where(alpha > 0.0, np.maximum(decode(grainy, grain.transfer), dark), linear[window])
    return out


# Measures the plate's grain in one frame: its strength over brightness, and its spectrum.
#
# Grain is the noise that camera and codec add to code values. It varies with brightness, differs between luma and
# chroma, and is correlated after compression. It is measured where the picture is smooth:
#
#     1. rows of three 32 x 32 blocks on a lattice between the latitudes +-60 degrees, none clipped or flat at the
# sides;     2. in each quarter of them by brightness, the smoothest eighth. The outer blocks are judged and the middle
# one is        measured, since a block chosen for its low roughness underestimates it;     3. their power spectra (tilt
# removed, Hann window), the median over the blocks at each frequency, which a few        textured blocks do not move;
# the lowest frequencies are taken like the next higher ones;     4. the shape of the spectrum from the whitest quarter,
# the strength of the others by the median ratio to it:        texture fills low frequencies, few of all;     5. less
# the noise that rounding with dither adds on writing, step^2/6.
#
# One picture cannot separate grain from texture as fine as grain: where nothing is smooth, it is overestimated.
#
# Codes are in units of full scale, Y' from 0 to 1.

Blocks = Callable[[NDArray[np.int64], NDArray[np.int64], int], NDArray[np.float32]]
"""(rows (n,), columns (n,) of pixels, plane) -> the blocks (n, BLOCK, BLOCK) there of Y', Cb or Cr."""

BLOCK = 32
"""Side of a measured block [px], several times the grain's correlation length."""
LATTICE = 16, 24
"""Number of places measured, down and along the picture; time grows with their product."""
LATITUDES = 2.0 / 3.0
"""Fraction of a panorama's rows that is measured: nearer to the poles the picture is stretched."""
GROUPS = 4
"""Groups by brightness: nodes of the strength's curve."""
SMOOTHEST = 8
"""One in so many of each group is measured. A larger share takes in texture, which then counts as grain."""
CONTRAST = 2.5
"""The strongest grain over the weakest, by brightness. Photon noise is nearly even in code values (sRGB: L^-0.08), that
of the electronics shows in the dark; what exceeds this is texture. Half the noise of rounding counts as some grain."""
_FEWEST = 4
"""Least number of blocks in a group: the median of fewer spectra is noise."""
_RING = np.maximum(np.abs(np.fft.fftfreq(BLOCK))[:, None], np.fft.rfftfreq(BLOCK)) * BLOCK
"""Distance (BLOCK, BLOCK/2 + 1) of the frequencies of `rfft2` from zero, along the farther axis."""
_ROUNDING = 1.0 / 6.0
"""Variance that rounding with an even dither adds, in squared steps, on average over all values."""


def grain_of_planes(image: YuvImage, panorama: bool = True) -> Grain:
    """Return the grain of decoded planes; none where they are smaller than two blocks.

    panorama: the rows are latitudes, and those near the poles are left out.
    """
    y_offset, y_span, c_offset, c_span = code_range(image.spec)
    offset, span = (y_offset, c_offset, c_offset), (y_span, c_span, c_span)
    planes = image.y, image.u, image.v

    def blocks(rows: NDArray[np.int64], columns: NDArray[np.int64], plane: int) -> NDArray[np.float32]:
        codes = planes[plane]
        j, i = (n * small // large for n, small, large in zip((rows, columns), codes.shape, image.y.shape, strict=True))
        j, i = np.minimum(j, codes.shape[0] - BLOCK), np.minimum(i, codes.shape[1] - BLOCK)
        windows = np.lib.stride_tricks.sliding_window_view(codes, (BLOCK, BLOCK))
        return (windows[j, i].astype(np.float32) - np.float32(offset[plane])) * np.float32(1.0 / span[plane])

    if min(image.u.shape) < BLOCK:
        return NO_GRAIN
    steps = np.array([1.0 / y_span, 1.0 / c_span, 1.0 / c_span])
    return _measure(blocks, image.y.shape, panorama, _ROUNDING * steps**2)


def grain_of_rgb(codes: NDArray[Any], transfer: Transfer, panorama: bool = True) -> Grain:
    """Return the grain of an RGB picture (H, W, 3) in Y'CbCr of BT.709.

    transfer: the curve of its values. Floating point pictures are measured as sRGB would code them, and were never
    rounded.
    """
    matrix = ycbcr_from_rgb("bt709")
    step = 1.0 / np.iinfo(codes.dtype).max if codes.dtype.kind == "u" else 0.0

    def blocks(rows: NDArray[np.int64], columns: NDArray[np.int64], plane: int) -> NDArray[np.float32]:
        windows = np.lib.stride_tricks.sliding_window_view(codes, (BLOCK, BLOCK), axis=(0, 1))
        found = np.asarray(windows[rows, columns], np.float32)  # (n, 3, BLOCK, BLOCK)
        rgb = found * np.float32(step) if step else encode(decode(found, transfer), "srgb")
        return np.einsum("nchw,c->nhw", rgb, matrix[plane].astype(np.float32))

    found = _measure(blocks, codes.shape[:2], panorama, _ROUNDING * step**2 * np.sum(matrix**2, axis=1))
    return replace(found, transfer=transfer) if step else found


def _measure(blocks: Blocks, shape: tuple[int, int], panorama: bool, rounding: Floats) -> Grain:
    rows, columns = shape
    if rows < 2 * BLOCK or columns < 3 * BLOCK:
        return NO_GRAIN
    border = int(0.5 * (1.0 - LATITUDES) * rows) if panorama else 0
    first, last = min(border, (rows - BLOCK) // 2), max(rows - border - BLOCK, (rows - BLOCK) // 2)
    j = np.linspace(first, last, LATTICE[0]).astype(np.int64).repeat(LATTICE[1])
    i = np.tile(np.linspace(0, columns - 3 * BLOCK, LATTICE[1]).astype(np.int64), LATTICE[0])
    found = np.empty((2, len(j), 4), np.float32)
    for side in range(2):
        survey(blocks(j, i + 2 * side * BLOCK, 0), found[side])
    low, high, mean, rough = found[..., 0].min(0), found[..., 1].max(0), found[..., 2].mean(0), found[..., 3]
    # flat to the last bit is no picture of a camera: a cap, a title
    usable = (low > 0.0) & (high < 1.0) & np.all(rough > 0.0, axis=0)
    groups = _smooth_groups(mean, rough.max(0), usable)
    if not groups:
        return NO_GRAIN
    brightness = [float(mean[group].mean()) for group in groups]
    deviation, filters = np.zeros((3, TABLE), np.float32), np.zeros_like(NO_GRAIN.filters)
    chosen, ends = np.concatenate(groups), np.cumsum([len(group) for group in groups])[:-1]
    for plane in range(3):
        power = _power(blocks(j[chosen], i[chosen] + BLOCK, plane))
        spectra = np.array([_median(part) for part in np.split(power, ends)])
        strength, filters[plane] = _fit(spectra, float(rounding[plane]))
        deviation[plane] = np.interp(np.linspace(0.0, 1.0, TABLE), brightness, strength)
    return Grain(deviation, filters)


def _smooth_groups(brightness: Floats, rough: Floats, usable: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Return the numbers of the smoothest blocks in each group by brightness, darkest first."""
    order = np.flatnonzero(usable)
    order = order[np.argsort(brightness[order], kind="stable")]
    groups = [g for g in np.array_split(order, GROUPS) if len(g) >= SMOOTHEST * _FEWEST]
    return [g[np.argsort(rough[g], kind="stable")[: len(g) // SMOOTHEST]] for g in groups]


def _power(blocks: Floats) -> Floats:
    """Return the power of blocks (n, BLOCK, BLOCK) at each frequency of `rfft2`, (n, BLOCK, BLOCK/2 + 1)."""
    import scipy.fft

    ramp = ((np.arange(BLOCK) - 0.5 * (BLOCK - 1)) / np.sqrt((BLOCK**2 - 1) / 12.0)).astype(np.float32)
    flat = blocks - blocks.mean((1, 2), keepdims=True)
    flat -= (flat.mean(1) @ ramp / BLOCK)[:, None, None] * ramp
    flat -= (flat.mean(2) @ ramp / BLOCK)[:, None, None] * ramp[:, None]
    window = np.hanning(BLOCK + 2)[1:-1].astype(np.float32)
    window = np.outer(window, window)
    waves = scipy.fft.rfft2(flat * window, overwrite_x=True)
    return (waves.real**2 + waves.imag**2) / (np.sum(window**2) * BLOCK**2)


def _median(power: Floats) -> Floats:
    """Return the mean of spectra (n, BLOCK, BLOCK/2 + 1) by their median: that of n exponentially distributed numbers
    of mean 1 is about ln 2 + 1/(2 n).
    """
    ordered = np.sort(power, axis=0)
    middle = (ordered[(len(power) - 1) // 2] + ordered[len(power) // 2]) / (2.0 * np.log(2.0) + 1.0 / len(power))
    middle = 0.5 * (middle + np.roll(middle[::-1], 1, axis=0))  # grain has no handedness
    return np.where(_RING < 2, middle[_RING == 2].mean(), middle)


def _total(power: Floats) -> Floats:
    """Return the variance (...) of spectra (..., BLOCK, BLOCK/2 + 1)."""
    return 2.0 * power.sum((-2, -1)) - power[..., 0].sum(-1) - power[..., -1].sum(-1)


def _fit(spectra: Floats, rounding: float) -> tuple[Floats, Floats]:
    """Return standard deviations (g,) and the filter of groups' spectra (g, BLOCK, BLOCK/2 + 1), rounding taken off."""
    share = spectra[:, _RING < BLOCK // 4].sum(-1) / np.maximum(spectra.sum((1, 2)), 1e-30)
    whitest = np.maximum(spectra[int(np.argmin(share))], 1e-30)
    scale = np.median((spectra / whitest).reshape(len(spectra), -1), axis=-1)
    strength = np.sqrt(np.maximum(scale * _total(whitest) - rounding, 0.0))
    strength = np.minimum(strength, CONTRAST * max(float(strength.min()), 0.5 * rounding**0.5))
    power = np.maximum(scale.mean() * whitest - rounding / BLOCK**2, 0.0)
    kernel = np.fft.fftshift(np.fft.irfft2(np.sqrt(power)))
    middle = slice(BLOCK // 2 - RADIUS, BLOCK // 2 + RADIUS + 1)
    return strength, kernel[middle, middle] / max(float(np.linalg.norm(kernel[middle, middle])), 1e-30)
