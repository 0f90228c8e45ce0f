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

from typing import Any

import av
import numpy as np
from av.sidedata.sidedata import Type
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import ColorSpec, Transfer, code_range, decode, encode, in_plate_primaries
from mr360uw.base.tile_blend import NO_GROUND, blended, light_sum
from mr360uw.types import Floats, Rectangle, Tile, UnlaidGround, YuvImage
from mr360uw.video.grain import NO_GRAIN, Grain, covered_box
from mr360uw.video.plane_kernels import write_planes
from mr360uw.yuv.decoding import coefficients, decode_table, encode_table, linear_from_planes, subsampling


def lay_over_planes(
    old: YuvImage,
    new: YuvImage,
    tile: Tile,
    frame_index: int,
    wrap: bool = True,
    grain: Grain = NO_GRAIN,
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
    *arrays, whole = [none if part is None else np.ascontiguousarray(part, np.float32) for part in parts]
    strength = grain.deviation
    noise, blotches = np.empty((0, 0), np.float32), np.empty((2, 0, 0), np.float32)
    if strength.any() and arrays[1].any():
        noise, blotches = _noise(grain, tile, old, frame_index)
    # Decode, blend and encode
    spec = old.spec
    coding = coefficients(spec), decode_table(spec), encode_table(spec), np.float32((1 << spec.bits) - 1)
    brightest, total = write_planes(
        (old.y, old.u, old.v), (new.y, new.u, new.v), (tile.row, tile.column, frame_index, sx, sy, wrap), coding,
        tuple(arrays), NO_GROUND if ground is None else ground.lines, whole, (noise, blotches, strength),
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


def lay_over_codes(
    codes: NDArray[Any],
    linear: Floats,
    changed: NDArray[np.bool_],
    transfer: Transfer,
    rectangle: Rectangle,
    frame_index: int,
) -> None:
    """Write linear light (h, w, 3) into a rectangle of code values, in place, where `changed`.

    Integer codes are clipped to full scale and dithered; floating point pictures take the new light as it is.
    """
    if codes.dtype.kind == "f":
        codes[changed] = encode(linear[changed], transfer)
        return
    peak = peak_code(codes)
    column, row, width, height = rectangle
    dither = noise(height, width, row, column, frame_index)[changed][:, None]
    new = encode(np.asarray(linear[changed], np.float64), transfer) * peak
    codes[changed] = np.clip(np.floor(new + dither), 0.0, peak).astype(codes.dtype)


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
    return native.side_data.get(Type.STEREO3D) is not None
