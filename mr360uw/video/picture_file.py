# SPDX-License-Identifier: Apache-2.0
"""Reads one picture file: its codes, how they are light, its metadata, and what of it is not used.

OpenCV decodes most kinds, Pillow TGA, FFmpeg DPX, OpenEXR its own. Radiance HDR is decoded by OpenCV after its header
is read here: exposure, primaries and orientation (Ward, "The RADIANCE Picture File Format").
"""

from __future__ import annotations

import io
import math
import re
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import HDR_CURVES, REC709_XY, XY_BY_NAME, PlateMapping, Primaries, Transfer, rec709_from_xyz
from mr360uw.base.input_files import HDR_SIZE, PICTURE, TIFF_STARTS, not_read, picture_size, read_data
from mr360uw.base.parameters import checked
from mr360uw.errors import VideoError
from mr360uw.video.exr import Wanted, read_frame
from mr360uw.video.picture_tags import (
    PictureTags,
    TiffForm,
    is_not_srgb,
    jpeg_bits,
    quietly,
    read_tags,
    tiff_form,
    unused_parts,
)
from mr360uw.yuv.file_profile import (
    SRGB,
    ToneCurve,
    chromatic_profile,
    icc_name,
    icc_profile,
    linear_profile,
)


@dataclass(frozen=True, slots=True, eq=False)
class PictureFile:
    """A picture. codes: (H, W, 3), of mattes with alpha (H, W, 4): uint8, uint16, or float32 of linear light.

    transfer, primaries: as the file says, else None. mapping: takes the place of both. notes: what of the file is not
    used, one line each; filled in on request.
    """

    codes: NDArray[Any]
    tags: PictureTags
    transfer: Transfer | None = None
    primaries: Primaries | None = None
    mapping: PlateMapping | None = None
    notes: tuple[str, ...] = ()


@checked
def read_picture(path: Path) -> NDArray[Any]:
    """Return the RGB codes of a picture, (H, W, 3): uint8, uint16, or float32 of EXR, HDR and TIFF files of floats.

    They are as stored, upright; the alpha of an EXR is left out.
    """
    return picture_file(path).codes


def picture_file(path: Path, wanted: Wanted = "colour", *, notes: bool = False) -> PictureFile:
    """Return a picture; raise `VideoError` where it cannot be read. notes: say also what is not used of it."""
    from mr360uw.video.demux import check_file

    check_file(path)
    suffix = path.suffix.lower()
    if suffix == ".exr":
        return _exr(path, wanted)
    data = read_data(path, VideoError)
    if problem := _explained(data, suffix):
        raise VideoError(f"{path} - {problem}")
    if data.startswith(b"#?"):
        return _radiance(path, data, notes=notes)
    if data[:4] in (b"SDPX", b"XPDS"):
        return _dpx(path, data)
    return _plain(path, data, wanted, notes=notes)


def _unusable(path: Path) -> VideoError:
    return VideoError(f"{path} - is not a picture that can be read, or it is cut short - save or copy it again")


def _explained(data: bytes, suffix: str) -> str:
    """Return why a file of a kind that is not read is none, and what to do, else ""."""
    if suffix in not_read("raw picture"):
        return (
            f"is camera raw ({suffix}), which has to be developed first - save it as a 16-bit TIFF or an EXR from the "
            "camera maker's program, darktable or Lightroom"
        )
    if data[:4] in (b"II+\0", b"MM\0+"):
        return "is a BigTIFF, which is not read - save it as plain TIFF, PNG or EXR"
    if suffix in not_read("picture") or data.startswith(_JPEG_XL):
        return f"is a picture of a kind that is not read ({suffix}) - save it as PNG, TIFF or EXR"
    if data[:4] in TIFF_STARTS:
        return _unread_tiff(tiff_form(data))
    if data.startswith(b"\xff\xd8") and (bits := jpeg_bits(data)) != 8:
        return f"is a JPEG of {bits} bits, which is not read - save it as 16-bit PNG or TIFF"
    brands = data[8:64] if data[4:8] == b"ftyp" else b""
    if b"avif" not in brands and brands[:4] in (b"heic", b"heix", b"hevc", b"heim", b"heis", b"mif1", b"msf1"):
        return "is HEIC, which is not read - save it as JPEG, PNG or AVIF, as by heif-convert IN.heic OUT.png"
    return ""


_JPEG_XL = (b"\xff\x0a", b"\0\0\0\x0cJXL ")


def _unread_tiff(form: TiffForm) -> str:
    """Return why a TIFF is not read, and what to do, else ""."""
    colours = {5: "CMYK, the colours of a printer", **dict.fromkeys((8, 9, 10), "L*a*b*")}.get(form.photometric, "")
    if colours:
        return f"is {colours} - save it as RGB"
    if form.photometric in (32803, 34892):
        return "is camera raw, which has to be developed first - save it as a 16-bit TIFF or an EXR"
    samples = {1: "whole numbers", 2: "signed numbers", 3: "floats"}.get(form.sample_format, "numbers of another kind")
    if (form.sample_format, form.bits) not in ((1, 1), (1, 2), (1, 4), (1, 8), (1, 16), (3, 32)):
        return f"holds {samples} of {form.bits} bits, which are not read - save it with 8 or 16 bits, or 32-bit floats"
    if form.samples > 4 or (form.samples == 2 and form.bits != 8):
        return f"has {form.samples} channels of {form.bits} bits - save it as RGB"
    if form.planar and form.bits != 8:
        return "stores its channels one after the other (planar), which is read of 8 bits only - save it interleaved"
    if form.compression not in _TIFF_COMPRESSIONS and form.bits != 8:
        return f"is compressed in a way that is not read (got number {form.compression}) - save it with LZW or ZIP"
    return ""


_TIFF_COMPRESSIONS = frozenset({1, 2, 3, 4, 5, 6, 7, 8, 32773, 32946})
"""Numbers of the compressions that OpenCV undoes: none, fax, LZW, JPEG, ZIP, PackBits."""


def _exr(path: Path, wanted: Wanted) -> PictureFile:
    channels, xy, header, notes = read_frame(path, wanted)
    size = (channels.shape[1], channels.shape[0])
    try:
        mapping = chromatic_profile(xy) if xy else None
    except ValueError as error:
        mapping, notes = None, (*notes, f"{path} - has {error}, read as Rec.709 - write its chromaticities again")
    return PictureFile(channels, PictureTags(".exr", size, size, header=header), "linear", None, mapping, notes)


def _plain(path: Path, data: bytes, wanted: Wanted, *, notes: bool) -> PictureFile:
    """Return a picture that OpenCV or Pillow decodes."""
    # Check the size before anything is decoded
    size = picture_size(data) or _size_by_pillow(data)
    if size is None:
        raise _unusable(path)
    PICTURE.check(str(path), size[0] * size[1], VideoError)
    # Decode; a matte keeps its alpha
    tags, turned = read_tags(data, path.suffix.lower(), size)
    codes = _decoded(path, data, matte=wanted == "matte" or notes)
    whole = np.iinfo(codes.dtype).max if codes.dtype.kind == "u" else 1.0
    clear = codes.shape[-1] == 4 and bool(codes[..., 3].min() < whole)
    codes = codes if wanted == "matte" else np.ascontiguousarray(codes[..., :3])
    try:
        unused = unused_parts(data, clear=clear) if notes else ()
    except ValueError as error:
        raise VideoError(f"{path} - {error}") from error
    # Turn it upright, then read its colours
    if turned > 1:
        codes = _upright(codes, turned)
        upright = (codes.shape[1], codes.shape[0])
        tags = replace(tags, size=upright, full_size=upright)
    found = PictureFile(codes, tags, notes=tuple(f"{path} - {one}" for one in unused))
    unstated = codes.dtype.kind == "f" and not tags.icc
    return found if unstated or wanted != "colour" else _coloured(path, found)


_BY_PILLOW = (OSError, SyntaxError, ValueError, IndexError, RuntimeError, struct.error)
"""What Pillow raises at files that are cut or damaged, beside its own error for large ones."""


def _size_by_pillow(data: bytes) -> tuple[int, int] | None:
    """Return the size of a TGA, JP2 or AVIF file, None where it is none of these."""
    from PIL import Image

    try:
        with quietly(), Image.open(io.BytesIO(data), formats=("TGA", "JPEG2000", "AVIF")) as picture:
            return picture.size
    except (*_BY_PILLOW, Image.DecompressionBombError):
        return None


def _decoded(path: Path, data: bytes, *, matte: bool) -> NDArray[Any]:
    """Return the codes (H, W, 3) of a picture as it lies in its file; of mattes with alpha (H, W, 4)."""
    import cv2

    form = tiff_form(data) if data[:4] in TIFF_STARTS else None
    if (
        form is not None
        and form.bits == 8
        and (form.samples in (2, 4) or form.planar or form.compression not in _TIFF_COMPRESSIONS)
    ):
        return _rgb_order(_decoded_by_pillow(path, data))  # OpenCV multiplies alpha in, and mixes planes up
    matte = matte or (form is not None and form.samples == 4)  # it does not leave the alpha of floats out
    flags = cv2.IMREAD_UNCHANGED if matte else cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    codes = _by_opencv(path, data, flags)
    if codes is None:
        codes = _decoded_by_pillow(path, data)
    codes = _to_full_scale(codes, _stored_bits(data))
    return _rgb_order(codes if codes.ndim == 3 else np.repeat(codes[..., None], 3, axis=-1))


def _rgb_order(codes: NDArray[Any]) -> NDArray[Any]:
    """Return channels in OpenCV's order as RGB(A)."""
    return np.ascontiguousarray(np.concatenate([codes[..., 2::-1], codes[..., 3:]], axis=-1))


def _stored_bits(data: bytes) -> int:
    """Return the bits of a sample of AVIF and JP2 files, which OpenCV leaves in 16 as they are; else 16."""
    if (at := data.find(b"av1C", 0, _HEAD_BYTES)) > 0 and len(data) > at + 6:
        flags = data[at + 6]  # AV1 Codec ISO Media File Format Binding, 2.3.3: high_bitdepth, twelve_bit
        return 12 if flags & 0x60 == 0x60 else 10 if flags & 0x40 else 8
    if (at := data.find(b"\xff\x4f\xff\x51", 0, _HEAD_BYTES)) >= 0 and len(data) > at + 42:
        return (data[at + 42] & 0x7F) + 1  # ISO/IEC 15444-1, A.5.1: depth of the first component, less one
    return 16


_HEAD_BYTES = 1 << 16


def _by_opencv(path: Path, data: bytes, flags: int) -> NDArray[Any] | None:
    """Return the codes of a picture by OpenCV, None where it reads none; raise `VideoError` where it is broken."""
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise _unusable(path) from error


def _to_full_scale(codes: NDArray[Any], bits: int) -> NDArray[Any]:
    """Return 16-bit codes whose full scale is 65535, of codes of fewer bits; all others as they are."""
    if codes.dtype != np.uint16 or not 8 < bits < 16:
        return codes
    top = (1 << bits) - 1
    return ((codes.astype(np.uint32) * 65535 + top // 2) // top).astype(np.uint16)


def _decoded_by_pillow(path: Path, data: bytes) -> NDArray[Any]:
    """Return the codes of a TGA file or a TIFF of 8 bits, in OpenCV's order of channels."""
    from PIL import Image

    try:
        with quietly(), Image.open(io.BytesIO(data), formats=("TGA", "TIFF")) as picture:
            rgba = np.asarray(picture.convert("RGBA" if "A" in picture.mode else "RGB"))
    except (*_BY_PILLOW, Image.DecompressionBombError) as error:
        raise _unusable(path) from error
    return np.concatenate([rgba[..., 2::-1], rgba[..., 3:]], axis=-1)


def _upright(codes: NDArray[Any], turned: int) -> NDArray[Any]:
    """Return a picture turned as its EXIF orientation, 2 to 8, says (EXIF 2.32, 4.6.4)."""
    if turned > 4:
        codes = codes.swapaxes(0, 1)
    if turned in (3, 4, 7, 8):
        codes = codes[::-1]
    if turned in (2, 3, 6, 7):
        codes = codes[:, ::-1]
    return np.ascontiguousarray(codes)


def _coloured(path: Path, found: PictureFile) -> PictureFile:
    """Return a picture with the colours that its profile or the chunks of a PNG name; cICP counts before all others."""
    chunks = dict(found.tags.png_colour)
    try:
        if b"cICP" in chunks:
            return _by_code_points(path, found, chunks[b"cICP"])
        if found.tags.icc:
            return replace(found, mapping=icc_profile(found.tags.icc))
        if b"sRGB" not in chunks and (b"gAMA" in chunks or b"cHRM" in chunks):
            return replace(found, mapping=_by_chromaticities(chunks))
        if not chunks and is_not_srgb(found.tags.exif):
            note = (
                f"{path} - says in its EXIF that its colours are not sRGB, and has no profile: it is read as sRGB - "
                "give it its profile, that of Adobe RGB as a rule"
            )
            return replace(found, notes=(*found.notes, note))
    except (ValueError, IndexError, struct.error) as error:
        name = f"its profile {icc_name(found.tags.icc)!r}" if found.tags.icc else "its colours"
        note = f"{path} - {name} cannot be used (got {error}), it is read as sRGB - convert it to sRGB before"
        return replace(found, notes=(*found.notes, note))
    return found


_XY: dict[int, tuple[float, ...]] = {
    1: REC709_XY, 5: REC709_XY, 6: REC709_XY, 7: REC709_XY, 9: XY_BY_NAME["rec2020"],
    11: (*XY_BY_NAME["p3d65"][:6], 0.314, 0.351), 12: XY_BY_NAME["p3d65"],
}  # fmt: skip
"""Chromaticities by their numbers in ITU-T H.273; those of standard definition are all but Rec.709's."""
_CURVES: dict[int, ToneCurve] = {
    1: SRGB, 6: SRGB, 13: SRGB, 14: SRGB, 15: SRGB, 4: ToneCurve(2.2), 5: ToneCurve(2.8), 8: ToneCurve(),
}  # fmt: skip
"""Curves by their numbers there; as for videos, pictures made for a display are read by the display's."""


def _by_code_points(path: Path, found: PictureFile, chunk: bytes) -> PictureFile:
    """Return a picture with the colours of a PNG's cICP chunk."""
    primaries, curve = chunk[0], chunk[1]
    if curve in HDR_CURVES and primaries in (1, 9):
        return replace(found, transfer=HDR_CURVES[curve], primaries="bt2020" if primaries == 9 else "bt709")
    if primaries not in _XY or curve not in _CURVES:
        raise ValueError(f"primaries {primaries} and curve {curve} of cICP")
    plain = _CURVES[curve] is SRGB and _XY[primaries] is REC709_XY
    if chunk[3:4] == b"\0":
        note = "says that its codes have video range (cICP), which is not used: 16 is grey - convert it to full range"
        found = replace(found, notes=(*found.notes, f"{path} - {note}"))
    return found if plain else replace(found, mapping=chromatic_profile(_XY[primaries], _CURVES[curve]))


_LIKE_SRGB = 0.0005
"""Difference from 1 / 2.2 of a PNG's gamma, which is written for the curve of sRGB."""


def _by_chromaticities(chunks: dict[bytes, bytes]) -> PlateMapping | None:
    """Return the map of a PNG's gAMA and cHRM chunks, which hold hundred thousandths; None where they are sRGB's."""
    gamma = struct.unpack(">I", chunks[b"gAMA"])[0] / 1e5 if b"gAMA" in chunks else 1.0 / 2.2
    if gamma <= 0.0:
        raise ValueError("a gamma of 0")
    curve = SRGB if abs(gamma - 1.0 / 2.2) < _LIKE_SRGB else ToneCurve(1.0 / gamma)
    stated = struct.unpack(">8I", chunks[b"cHRM"]) if b"cHRM" in chunks else ()
    xy = tuple(one / 1e5 for one in (*stated[2:], *stated[:2])) or REC709_XY
    if curve is SRGB and np.allclose(xy, REC709_XY, atol=1e-3):
        return None
    return chromatic_profile(xy, curve)


_RADIANCE_LINE = re.compile(rb"^([A-Z]+)\s*=\s*(.*?)\s*$")


def _radiance(path: Path, data: bytes, *, notes: bool) -> PictureFile:
    """Return a Radiance picture, upright, with the map of its exposure and primaries."""
    import cv2

    found = HDR_SIZE.search(data, 0, 1 << 16)
    size = picture_size(data)
    if found is None or size is None:
        raise _unusable(path)
    PICTURE.check(str(path), size[0] * size[1], VideoError)
    # OpenCV decodes rows from the top alone, and no XYZ: it gets the samples under a plain header
    lines = [line for line in data[: found.start()].split(b"\n")[1:] if line.strip()]
    entries = [(hit[1], hit[2]) for hit in map(_RADIANCE_LINE.match, lines) if hit]
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %b +X %b\n" % (found[3], found[6])
    rows = _without_old_runs(data[found.end() :], int(found[3]) * int(found[6]))
    codes = _by_opencv(path, head + rows, cv2.IMREAD_UNCHANGED)
    if codes is None:
        raise _unusable(path)
    codes = codes[..., ::-1]
    down, across = (found[1] == b"+", found[4] == b"-")
    if found[2] == b"X":
        codes, down, across = codes.swapaxes(0, 1), found[4] == b"+", found[1] == b"-"
    codes = np.ascontiguousarray(codes[:: -1 if down else 1, :: -1 if across else 1])
    # Light is what is stored over all exposures, in the primaries that are named
    said, mapping = _radiance_map(path, entries)
    kept = tuple(line for line in lines if not line.startswith(b"FORMAT") and _RADIANCE_LINE.match(line))
    kept += (b"FORMAT=32-bit_rle_xyze",) if dict(entries).get(b"FORMAT") == b"32-bit_rle_xyze" else ()
    tags = PictureTags(".hdr", size, size, lines=kept)
    return PictureFile(codes, tags, "linear", None, mapping, said if notes else ())


def _without_old_runs(rows: bytes, count: int) -> bytes:
    """Return the pixels of a Radiance file without the runs of its first versions; rows of other kinds as they are.

    A pixel (1, 1, 1, n) repeats the one before it n times, one that follows such a one n << 8 times, and so on.
    """
    pixels = np.frombuffer(rows, np.uint8, len(rows) // 4 * 4).reshape(-1, 4)
    if len(pixels) >= count or rows[:2] == b"\2\2":
        return rows
    runs = np.all(pixels[:, :3] == 1, axis=1)
    index = np.arange(len(pixels))
    since = index - np.maximum.accumulate(np.where(runs, 0, index))  # pixels since the last one that is no run
    times = np.where(runs, pixels[:, 3].astype(np.int64) << 8 * np.clip(since - 1, 0, 3), 1)
    if times.sum() != count or runs[0]:
        return rows
    return pixels[np.repeat(index - since, times)].tobytes()


def _radiance_map(path: Path, entries: list[tuple[bytes, bytes]]) -> tuple[tuple[str, ...], PlateMapping | None]:
    """Return lines on a Radiance header and the map that it says."""
    said = dict(entries)
    mapping: PlateMapping | None
    try:
        # A factor of 0, which no light survives, is refused below
        exposure = math.prod(float(value) for name, value in entries if name == b"EXPOSURE")
        gain = np.full(3, exposure)
        for _, value in (one for one in entries if one[0] == b"COLORCORR"):
            gain = gain * [float(v) for v in value.split()]
        aspect = float(said.get(b"PIXASPECT", b"1"))
        xy = tuple(float(v) for v in said.get(b"PRIMARIES", b"").split())
        xy = xy if any(xy) else REC709_XY  # Photoshop writes zeros
        with np.errstate(divide="ignore"):
            gain = 1.0 / gain
        if said.get(b"FORMAT") == b"32-bit_rle_xyze":
            mapping = linear_profile(rec709_from_xyz(np.ones(3)), gain)
        else:
            mapping = chromatic_profile(xy, gain=gain)
    except ValueError as error:
        raise VideoError(f"{path} - has a header that cannot be used (got {error}) - write it again") from error
    notes = []
    if exposure != 1.0:
        notes.append(
            f"{path} - was stored with an exposure of {exposure:g}, which is taken off again: its light is that over "
            f"{exposure:g} - set light.exposure, or remove EXPOSURE from its header, if it is too dark or too bright"
        )
    if said.get(b"GAMMA", b"1").split()[:1] not in ([b"1"], [b"1.0"]):
        what = said[b"GAMMA"].decode("latin-1")
        notes.append(f"{path} - names a gamma (got {what:.20}), which is not used: its light is linear - write it so")
    if aspect != 1.0:
        notes.append(f"{path} - says that its pixels are not square (got {aspect:g}), which is not used - resample it")
    return tuple(notes), mapping


_DPX_LOG, _DPX_LINEAR = (1, 3), 2
_DPX_DESCRIPTOR = 800  # of the first element (SMPTE ST 268-1): descriptor, transfer, colorimetry, bits


def _dpx(path: Path, data: bytes) -> PictureFile:
    """Return a DPX picture, decoded by FFmpeg; 10 and 12 bits become 16."""
    import av
    import av.error

    order = ">" if data.startswith(b"SDPX") else "<"
    if len(data) < 2048:
        raise _unusable(path)
    width, height = struct.unpack_from(f"{order}II", data, 772)
    PICTURE.check(str(path), width * height, VideoError)
    curve, bits = data[_DPX_DESCRIPTOR + 1], data[_DPX_DESCRIPTOR + 3]
    try:
        context = av.CodecContext.create("dpx", "r")
        frames = [*context.decode(av.Packet(data)), *context.decode(None)]
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise _unusable(path) from error
    if not frames:
        raise _unusable(path)
    codes = _rgb_of(frames[0], bits)
    tags = PictureTags(".dpx", (width, height), (width, height))
    log = f"{path} - holds log densities of film (curve {curve}), read as sRGB - name plate.lut or plate.ocio"
    linear: Transfer | None = "linear" if curve == _DPX_LINEAR else None
    return PictureFile(codes, tags, linear, notes=(log,) if curve in _DPX_LOG else ())


def _rgb_of(frame: Any, bits: int) -> NDArray[Any]:
    """Return the codes (H, W, 3) of FFmpeg's picture: uint8 of 8 bits, else uint16 whose full scale is 65535."""
    if bits == 8:
        return np.ascontiguousarray(frame.to_ndarray(format="rgb24"))
    planar = frame.format.name.startswith("gbrp")
    codes = frame.to_ndarray() if planar else frame.to_ndarray(format="rgb48le")
    return np.ascontiguousarray(_to_full_scale(codes[..., :3], bits if planar else 16))
