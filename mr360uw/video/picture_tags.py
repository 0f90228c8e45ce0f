# SPDX-License-Identifier: Apache-2.0
"""Metadata of pictures: colour profile, EXIF, XMP with the mark of a panorama, header entries of EXR and HDR files.

They are read from a file's bytes, travel with the frame, and are put into the bytes of an encoded picture. The mark of
a panorama is Google's "Photo Sphere XMP Metadata".
"""

from __future__ import annotations

import io
import math
import re
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

from mr360uw.base.input_files import (
    JPEG_FRAMES,
    JPEG_START,
    PNG_START,
    TIFF_STARTS,
    jpeg_segments,
    png_chunks,
    riff_chunks,
    tiff_entries,
)

_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_GPANO = "http://ns.google.com/photos/1.0/panorama/"
_JPEG_MORE_XMP = b"http://ns.adobe.com/xmp/extension/\0"
_JPEG_XMP, _JPEG_EXIF, _JPEG_ICC = b"http://ns.adobe.com/xap/1.0/\0", b"Exif\0\0", b"ICC_PROFILE\0"
_PNG_XMP = b"XML:com.adobe.xmp\0\0\0\0\0"  # keyword, not compressed, no language
_PNG_HEADER_END = 33  # signature and the IHDR chunk
_PNG_COLOUR = (b"cICP", b"gAMA", b"cHRM", b"sRGB", b"mDCV", b"cLLI")
_SEGMENT = 65533
"""Most bytes of a JPEG segment after its length."""
_XMP_TAG, _ICC_TAG, _EXIF_TAG, _GPS_TAG, _ORIENTATION = 700, 34675, 34665, 34853, 274
_STRIPS, _TIFF_HEAD = 273, 8
_BROKEN = (struct.error, zlib.error, ValueError, TypeError, KeyError, IndexError, SyntaxError, OSError)
"""What Pillow and `struct` raise at metadata that are cut or damaged."""
_ABOUT = (270, 271, 272, 305, 306, 315, 33432)
"""Tags of TIFF that say what a picture is and who made it: those that are carried to other kinds of files."""
HOLDING: dict[str, frozenset[str]] = {
    **dict.fromkeys((".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff"), frozenset({"icc", "exif", "xmp"})),
    ".exr": frozenset({"exif"}),
}
"""What pictures of a kind hold, by their ending."""


@dataclass(frozen=True, slots=True, eq=False)
class PictureTags:
    """Metadata of a picture as its file has them.

    kind: the file's ending. size: (width, height) of the picture in the file. full_size, origin: of the panorama that
    it is a part of, and its (column, row) there. icc, exif, xmp: bytes; EXIF without orientation, which is applied.
    png_colour: chunks of a PNG that say its colours, or what says the same in AVIF. header: entries of an EXR file.
    lines: of an HDR file's header. own: (kind, content) of texts, IPTC and XMP beyond 64 kB as JPEG, PNG or TIFF files
    alone hold them: the number of a JPEG's segment or a TIFF's tag, or the name of a PNG's chunk.
    """

    kind: str
    size: tuple[int, int]
    full_size: tuple[int, int]
    origin: tuple[int, int] = (0, 0)
    icc: bytes = b""
    exif: bytes = b""
    xmp: bytes = b""
    png_colour: tuple[tuple[bytes, bytes], ...] = ()
    header: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[bytes, ...] = ()
    own: tuple[tuple[int | bytes, bytes], ...] = ()

    @property
    def pano(self) -> dict[str, str]:
        """The mark of a panorama, by the names of its fields."""
        return _pano_fields(self.xmp) or _pano_fields(_extended_xmp(self.own))

    @property
    def pose_deg(self) -> tuple[float, float, float]:
        """Heading, pitch and roll of the camera by the mark, zeros where it has none.

        Pitch is + where the centre looks up, roll where the right side is down.
        """
        heading, pitch, roll = (
            number_of(self.pano.get(f"Pose{name}Degrees", "")) for name in ("Heading", "Pitch", "Roll")
        )
        return heading, pitch, roll

    def lost_in(self, suffix: str) -> tuple[str, ...]:
        """Return lines on what a picture with an ending, ".png" for example, does not hold."""
        held = HOLDING.get(suffix, frozenset())
        what = {"exif": ("EXIF", self.exif), "xmp": ("XMP", b"" if self._is_only_a_mark else self.xmp)}
        most = _SEGMENT - len(_JPEG_XMP) if suffix in (".jpg", ".jpeg") else math.inf
        lost = [name for key, (name, there) in what.items() if there and (key not in held or len(there) > most)]
        lost += dict.fromkeys(_OWN_NAMES.get(kind, "texts") for kind, _ in self.own if not _goes_into(suffix, kind))
        lost += ["header entries"] * (suffix != ".exr" and bool(self.header))
        kept = "an .exr keeps them" if lost == ["header entries"] else "a .jpg, .png, .tif or .webp keeps them"
        kept = f"a {self.kind} keeps them" if self.own and not {"EXIF", "XMP"} & set(lost) else kept
        return (f"{suffix} does not hold the plate's {' and '.join(lost)} - {kept}",) if lost else ()

    @property
    def _is_only_a_mark(self) -> bool:
        return b"GPano" in self.xmp and not re.search(rb"<(?!GPano:|x:|rdf:|\?|/)\w+:", self.xmp)


_COMMENT, _APP1, _APP13, _TIFF_IPTC, _TIFF_PHOTOSHOP = 0xFE, 0xE1, 0xED, 33723, 34377
_OWN_NAMES: dict[int | bytes, str] = {
    _COMMENT: "comment", _APP1: "extended XMP", _APP13: "IPTC", _TIFF_IPTC: "IPTC", _TIFF_PHOTOSHOP: "IPTC",
}  # fmt: skip
_PNG_TEXTS = (b"tEXt", b"zTXt", b"iTXt")


def _goes_into(suffix: str, kind: int | bytes) -> bool:
    """Return whether files with an ending hold a part of `PictureTags.own` of a kind."""
    kinds = (".png",) if isinstance(kind, bytes) else (".tif", ".tiff") if kind > 0xFF else (".jpg", ".jpeg")
    return suffix in kinds


def _extended_xmp(own: Sequence[tuple[int | bytes, bytes]]) -> bytes:
    """Return the XMP that a JPEG's segments hold beyond the first 64 kB (XMP specification, part 3, 1.1.3.1)."""
    heads = len(_JPEG_MORE_XMP) + 32  # the digest; then the whole length, and where a part begins
    parts = [body[heads + 4 :] for kind, body in own if kind == _APP1]
    return b"".join(part[4:] for part in sorted(parts, key=lambda part: part[:4]))


def number_of(text: str) -> float:
    """Return the number that a text of metadata is, 0 where it is none or not finite."""
    try:
        found = float(text)
    except ValueError:
        return 0.0
    return found if math.isfinite(found) else 0.0


def _pano_fields(xmp_bytes: bytes) -> dict[str, str]:
    """Return the fields of Photo Sphere XMP, written as attributes or as elements; none of other XMP."""
    text = xmp_bytes.decode("utf-8", "replace")
    found = re.search(rf"xmlns:(\w+)\s*=\s*[\"']{re.escape(_GPANO)}[\"']", text)
    if found is None:
        return {}
    name = re.escape(found[1])
    said = re.findall(rf"\b{name}:(\w+)\s*=\s*[\"']([^\"']*)[\"']", text)
    return dict(said + re.findall(rf"<{name}:(\w+)>\s*([^<]*?)\s*</", text))


_KEPT_FIELDS = ("Pose", "Initial", "SourcePhotosCount", "FirstPhotoDate", "LastPhotoDate", "CaptureSoftware",
                "StitchingS")  # fmt: skip


def xmp(width: int, height: int, said: Mapping[str, str] | None = None) -> bytes:
    """Return the XMP of a full equirectangular panorama, with the view and the pose of fields that were `said`."""
    values: dict[str, object] = {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaImageWidthPixels": width,
        "CroppedAreaImageHeightPixels": height,
        "CroppedAreaLeftPixels": 0,
        "CroppedAreaTopPixels": 0,
    }
    values |= {name: text for name, text in (said or {}).items() if name.startswith(_KEPT_FIELDS) and '"' not in text}
    return b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="%s">%s</rdf:RDF></x:xmpmeta>' % (
        _RDF.encode(),
        _mark(values),
    )


def _mark(values: Mapping[str, object]) -> bytes:
    attributes = " ".join(f'GPano:{name}="{value}"' for name, value in values.items())
    return f'<rdf:Description rdf:about="" xmlns:GPano="{_GPANO}" {attributes}/>'.encode()


def xmp_of(tags: PictureTags | None, size: tuple[int, int], *, panorama: bool) -> bytes:
    """Return the XMP of a picture of a size (width, height): the plate's own, marked anew where it is of another size.

    panorama: whether the picture is a whole panorama, which is marked. Pictures of both eyes, and views, are not.
    """
    own = b"" if tags is None else tags.xmp
    marked = b"" if tags is None or not tags.pano else own
    if tags is not None and marked and size == tags.size:
        return own
    if not panorama:
        return b"" if marked else own
    mark = xmp(*size, None if tags is None else tags.pano)
    at = own.rfind(b"</rdf:RDF>")
    if marked or at < 0:
        return mark
    inside = mark[mark.index(b"<rdf:Description") : mark.index(b"</rdf:RDF>")]
    return own[:at] + inside + own[at:]


def read_tags(data: bytes, suffix: str, size: tuple[int, int]) -> tuple[PictureTags, int]:
    """Return the metadata of a file's bytes, and how the picture is to be turned (EXIF, 1 to 8).

    size: (width, height) of the picture in the file, before it is turned. Metadata that are broken are left out.
    """
    try:
        if data[:4] in TIFF_STARTS:
            return _tiff_tags(data, suffix, size)
        parts = _parts(data)
    except _BROKEN:
        return PictureTags(suffix, size, size), 1
    turned, exif = _upright(parts.get("exif", b""))
    try:
        _exif_parts(exif)
    except _BROKEN:
        exif = b""
    colour = tuple(chunk for chunk in png_chunks(data) if chunk[0] in _PNG_COLOUR)
    colour = colour if colour or parts.get("icc") else _avif_colour(data)
    known = parts.get("icc", b""), exif, parts.get("xmp", b"")
    return PictureTags(suffix, size, size, (0, 0), *known, colour, own=tuple(_own_parts(data))), turned


def _parts(data: bytes) -> dict[str, bytes]:
    """Return the profile, EXIF and XMP of a JPEG, PNG, WebP or AVIF file."""
    # JPEG: application segments, the profile in several
    if data.startswith(JPEG_START):
        bodies = [body for _, body in jpeg_segments(data)]
        parts = sorted(body for body in bodies if body.startswith(_JPEG_ICC))
        found = {
            name: next((body[len(head) :] for body in bodies if body.startswith(head)), b"")
            for name, head in (("exif", _JPEG_EXIF), ("xmp", _JPEG_XMP))
        }
        return found | {"icc": b"".join(body[len(_JPEG_ICC) + 2 :] for body in parts)}
    # PNG: chunks, or texts in which older programs kept them
    if data.startswith(PNG_START):
        chunks = dict(reversed(list(png_chunks(data))))
        texts = [body for kind, body in png_chunks(data) if kind == b"iTXt" and body.startswith(b"XML:com.adobe.xmp\0")]
        profile = chunks.get(b"iCCP", b"").partition(b"\0")[2][1:]
        found = {"exif": chunks.get(b"eXIf", b"").removeprefix(_JPEG_EXIF), "xmp": _text(texts[0]) if texts else b""}
        found |= {name: old for name, old in _raw_profiles(data).items() if not found[name]}
        return found | {"icc": _inflated(profile) if profile else b""}
    # WebP: RIFF chunks
    if data[:4] == b"RIFF":
        names = {b"ICCP": "icc", b"EXIF": "exif", b"XMP ": "xmp"}
        found = {names[kind]: body for kind, body in riff_chunks(data) if kind in names}
        return found | {"exif": found.get("exif", b"").removeprefix(_JPEG_EXIF)}
    # AVIF: Pillow finds the boxes
    if data[4:8] != b"ftyp":
        return {}
    from PIL import Image

    with Image.open(io.BytesIO(data)) as picture:
        found = {name: picture.info.get(key) or b"" for name, key in (("icc", "icc_profile"), ("xmp", "xmp"))}
        return found | {"exif": (picture.info.get("exif") or b"").removeprefix(_JPEG_EXIF)}


def _own_parts(data: bytes) -> Iterator[tuple[int | bytes, bytes]]:
    """Yield the comments, texts, IPTC and extended XMP of a JPEG or PNG; what has become EXIF or XMP is no text."""
    if data.startswith(JPEG_START):
        for marker, body in jpeg_segments(data):
            if marker in (_COMMENT, _APP13) or (marker == _APP1 and body.startswith(_JPEG_MORE_XMP)):
                yield marker, body
    for kind, body in png_chunks(data):
        if kind in _PNG_TEXTS and not body.startswith((b"XML:com.adobe.xmp\0", *_RAW_PROFILES)):
            yield kind, body


_RAW_PROFILES = {
    b"Raw profile type xmp\0": "xmp",
    **dict.fromkeys((b"Raw profile type exif\0", b"Raw profile type APP1\0"), "exif"),
}
"""Keywords of texts in which ImageMagick keeps metadata, as hexadecimal digits."""


def _raw_profiles(data: bytes) -> dict[str, bytes]:
    """Return the EXIF and XMP that the texts of a PNG hold."""
    found = {}
    for kind, body in png_chunks(data):
        name = next((name for head, name in _RAW_PROFILES.items() if body.startswith(head)), None)
        if name is not None and kind in (b"tEXt", b"zTXt"):
            text = body.partition(b"\0")[2]
            words = (_inflated(text[1:]) if kind == b"zTXt" else text).split(None, 2)
            content = bytes.fromhex(words[2].decode("ascii"))
            found["xmp" if content.startswith(_JPEG_XMP) else name] = content.removeprefix(_JPEG_XMP)
    return {name: content.removeprefix(_JPEG_EXIF) for name, content in found.items()}


def _avif_colour(data: bytes) -> tuple[tuple[bytes, bytes], ...]:
    """Return the code points of an AVIF file (its box colr of kind nclx) as the chunk of a PNG that says the same."""
    at = data.find(b"colrnclx", 0, 1 << 16) if data[4:8] == b"ftyp" else -1
    if at < 0 or len(data) < at + 12:
        return ()
    primaries, curve = struct.unpack_from(">HH", data, at + 8)
    known = 2 not in (primaries, curve) and max(primaries, curve) < 256  # 2: not specified
    return ((b"cICP", bytes([primaries, curve, 0, 1])),) if known else ()


_INKS = 4
_MOST_BYTES = 1 << 26
"""Bytes of metadata that are unpacked: profiles have up to some millions."""


def _inflated(data: bytes) -> bytes:
    return zlib.decompressobj().decompress(data, _MOST_BYTES)


def _text(chunk: bytes) -> bytes:
    """Return the text of an iTXt chunk (PNG specification, 11.3.3.4)."""
    _, _, rest = chunk.partition(b"\0")
    text = rest[2:].partition(b"\0")[2].partition(b"\0")[2]
    return _inflated(text) if rest[:1] == b"\1" else text


def unused_parts(data: bytes, *, clear: bool) -> tuple[str, ...]:
    """Return what of a picture's file is not used, one line each: alpha that is not opaque, further pictures.

    clear: whether it has such alpha. Raises `ValueError` where its colours are those of a printer.
    """
    inside = False
    if data.startswith(JPEG_START):
        bodies = list(jpeg_segments(data))
        if any(marker in JPEG_FRAMES and len(body) > 5 and body[5] == _INKS for marker, body in bodies):
            raise ValueError("is CMYK, the colours of a printer - save it as RGB")
        further = any(body.startswith(b"MPF\0") for _, body in bodies)
        inside = any(_INSIDE_XMP.search(body) for marker, body in bodies if marker == _APP1)
    elif data[:4] in TIFF_STARTS:
        further = tiff_form(data).more
    else:
        kinds = dict(riff_chunks(data) if data[:4] == b"RIFF" else png_chunks(data))
        further, clear = bool({b"acTL", b"ANIM"} & set(kinds)), clear or b"tRNS" in kinds
    alpha = "has transparency, which is left out - flatten it if that is wrong"
    more = "holds further pictures (frames, pages, a gain map or a preview) - the first is read, outputs have it alone"
    eye = "holds a right eye, depth or sound in its XMP (VR180 photo, Cardboard) - the left eye's picture alone is read"
    return (*[alpha] * clear, *[more] * further, *[eye] * inside)


_INSIDE_XMP = re.compile(rb"\bG(?:Image|Depth|Audio):(?:Data|Mime)\b")


@dataclass(frozen=True, slots=True)
class TiffForm:
    """How a TIFF's first picture is stored, by the numbers of TIFF 6.0. bits: of a sample. more: further pictures."""

    photometric: int = 2
    bits: int = 8
    samples: int = 3
    sample_format: int = 1
    compression: int = 1
    planar: bool = False
    more: bool = False


def tiff_form(data: bytes) -> TiffForm:
    """Return how a TIFF is stored; that of a plain one where its directory is broken."""
    try:
        directory = _directory(data)
        first = {
            tag: value[0] if isinstance(value, tuple) else value for tag, value in directory.items() if value != ()
        }
        samples = int(first.get(277, 1))
        return TiffForm(
            int(first.get(262, 2)), int(first.get(258, 1)), samples, int(first.get(339, 1)), int(first.get(259, 1)),
            samples > 1 and first.get(284) == 2, bool(directory.next) or 330 in first,
        )  # fmt: skip
    except _BROKEN:
        return TiffForm()


def jpeg_bits(data: bytes) -> int:
    """Return the bits of a sample of a JPEG, 8 where it does not say."""
    return next((body[0] for marker, body in jpeg_segments(data) if marker in JPEG_FRAMES and body), 8)


def _upright(exif: bytes) -> tuple[int, bytes]:
    """Return the orientation in EXIF, 1 where it has none, and the same EXIF with orientation 1."""
    if exif[:4] not in TIFF_STARTS:
        return 1, b""
    try:
        order, entries = tiff_entries(exif)
        for tag, kind, at in entries:
            (turned,) = struct.unpack_from(f"{order}H", exif, at)
            if (tag, kind) == (_ORIENTATION, 3):
                upright = exif[:at] + struct.pack(f"{order}H", 1) + exif[at + 2 :]
                return (turned if 1 <= turned <= 8 else 1), upright
    except struct.error:
        return 1, b""
    return 1, exif


def _directory(data: bytes) -> Any:
    """Return the first directory of a TIFF file, as Pillow reads it."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    directory = ImageFileDirectory_v2(data[:8])
    file = io.BytesIO(data)
    file.seek(directory.next)
    with quietly():
        directory.load(file)
        for tag in list(directory):
            directory[tag]  # entries are decoded, and written again, once they were asked for
    return directory


def quietly() -> AbstractContextManager[None]:
    """Return a context in which Pillow warns of nothing: damage that matters is an error."""
    return warnings.catch_warnings(action="ignore")


def _tiff_tags(data: bytes, suffix: str, size: tuple[int, int]) -> tuple[PictureTags, int]:
    from PIL import Image

    directory, exif, file = _directory(data), Image.Exif(), Image.Exif()
    file.load(_JPEG_EXIF + data)
    for tag in _ABOUT:
        if tag in directory:
            exif[tag] = directory[tag]
    for tag in (_EXIF_TAG, _GPS_TAG):
        if tag in directory and (inner := file.get_ifd(tag)):
            exif[tag] = dict(inner)
    icc, own_xmp = (bytes(directory.get(tag, b"")) for tag in (_ICC_TAG, _XMP_TAG))
    own = tuple(
        (tag, bytes(directory[tag])) for tag in (_TIFF_IPTC, _TIFF_PHOTOSHOP) if isinstance(directory.get(tag), bytes)
    )
    turned = int(directory.get(_ORIENTATION, 1))
    written = exif.tobytes().removeprefix(_JPEG_EXIF) if len(exif) else b""
    tags = PictureTags(suffix, size, size, (0, 0), icc, written, own_xmp, own=own)
    return tags, turned if 1 <= turned <= 8 else 1


def with_tags(
    picture: bytes, suffix: str, icc: bytes, exif: bytes, xmp_bytes: bytes, png_colour: Any = (), own: Any = ()
) -> bytes:
    """Return the bytes of a JPEG, PNG or TIFF with metadata in them; other kinds come back unchanged.

    suffix: the file's ending. png_colour: (kind, content) of chunks that a PNG gets instead of a profile. own: parts of
    a plate, see `PictureTags`; those of the same kind of file are taken.
    """
    own = [one for one in own if _goes_into(suffix, one[0])]
    if picture.startswith(JPEG_START):
        if b"HasExtendedXMP" not in xmp_bytes:  # what names them is not there
            own = [one for one in own if one[0] != _APP1]
        segments = b"".join((*_jpeg_segments(icc, exif, xmp_bytes), *(_segment(*one) for one in own)))
        return JPEG_START + segments + picture[2:]
    if picture.startswith(PNG_START):
        chunks = [*png_colour] or [(b"iCCP", b"ICC profile\0\0" + zlib.compress(icc))] * bool(icc)
        chunks += [(b"eXIf", exif)] * bool(exif) + [(b"iTXt", _PNG_XMP + xmp_bytes)] * bool(xmp_bytes) + own
        return picture[:_PNG_HEADER_END] + b"".join(_chunk(*one) for one in chunks) + picture[_PNG_HEADER_END:]
    if picture[:4] in TIFF_STARTS and (icc or exif or xmp_bytes or own):
        return _with_tiff_tags(picture, exif, {_XMP_TAG: xmp_bytes, _ICC_TAG: icc, **dict(own)})
    return picture


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _jpeg_segments(icc: bytes, exif: bytes, xmp_bytes: bytes) -> Iterator[bytes]:
    """Yield the segments of metadata; what is longer than a segment, but for a profile, is left out."""
    step = _SEGMENT - len(_JPEG_ICC) - 2
    parts = [icc[at : at + step] for at in range(0, len(icc), step)]
    bodies = [(0xE1, _JPEG_EXIF + exif)] * bool(exif) + [(0xE1, _JPEG_XMP + xmp_bytes)] * bool(xmp_bytes)
    bodies += [(0xE2, _JPEG_ICC + bytes([k + 1, len(parts)]) + part) for k, part in enumerate(parts)]
    for marker, body in bodies:
        if len(body) <= _SEGMENT:
            yield _segment(marker, body)


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def _with_tiff_tags(picture: bytes, exif: bytes, more: Mapping[int, bytes]) -> bytes:
    """Return a TIFF file whose directory is written anew before its pixels, with more tags."""
    directory, (about, *inner) = _directory(picture), _exif_parts(exif)
    for tag in _ABOUT:
        if tag in about:
            directory[tag] = about[tag]
    for tag, entries in zip((_EXIF_TAG, _GPS_TAG), inner, strict=True):
        if entries:
            directory.tagtype[tag] = 4
            directory[tag] = entries
    for tag, content in more.items():
        if content:
            directory.tagtype[tag] = 7 if tag == _ICC_TAG else 1
            directory[tag] = content
    # Pillow counts the places of strips from the end of the directory that it writes
    strips = directory[_STRIPS]
    directory[_STRIPS] = tuple(at - _TIFF_HEAD for at in (strips if isinstance(strips, tuple) else (strips,)))
    order = "<" if picture.startswith(b"II") else ">"
    head = picture[:4] + struct.pack(f"{order}I", _TIFF_HEAD)
    return head + directory.tobytes(_TIFF_HEAD) + picture[_TIFF_HEAD:]


def exr_entries(exif: bytes) -> dict[str, Any]:
    """Return the header entries of an EXR file that say what EXIF says: camera, date, exposure, place."""
    from PIL.ExifTags import Base

    said, taken, place = _exif_parts(exif)
    found: dict[str, Any] = {
        "cameraMake": said.get(271), "cameraModel": said.get(272), "comments": said.get(270), "owner": said.get(33432),
        "capDate": taken.get(Base.DateTimeOriginal, said.get(306)), "lensModel": taken.get(Base.LensModel),
        "expTime": taken.get(Base.ExposureTime), "aperture": taken.get(Base.FNumber),
        "isoSpeed": taken.get(Base.ISOSpeedRatings), "altitude": place.get(6),
        "latitude": _degrees(place, 1, "S"), "longitude": _degrees(place, 3, "W"),
    }  # fmt: skip
    texts = {name: value.strip("\0 ") for name, value in found.items() if isinstance(value, str)}
    numbers = {name: float(value) for name, value in found.items() if isinstance(value, Real)}
    return {name: value for name, value in texts.items() if value} | {
        name: value for name, value in numbers.items() if math.isfinite(value)
    }


def is_not_srgb(exif: bytes) -> bool:
    """Return whether EXIF says that colours are not sRGB: cameras say so instead of a profile of Adobe RGB."""
    return bool(exif) and _exif_parts(exif)[1].get(_COLOUR_SPACE) == _UNCALIBRATED


_COLOUR_SPACE, _UNCALIBRATED = 40961, 65535


def _exif_parts(exif: bytes) -> tuple[Mapping[int, Any], Mapping[int, Any], Mapping[int, Any]]:
    """Return the tags of EXIF's three directories: of the picture, of the exposure, of the place."""
    from PIL import Image

    said = Image.Exif()
    said.load(_JPEG_EXIF + exif)
    return dict(said), dict(said.get_ifd(_EXIF_TAG)), dict(said.get_ifd(_GPS_TAG))


def _degrees(place: Mapping[int, Any], tag: int, negative: str) -> float | None:
    """Return an angle of GPS [deg] from its letter, `tag`, and its degrees, minutes and seconds, the tag after it."""
    parts = place.get(tag + 1)
    if not isinstance(parts, tuple) or len(parts) != 3 or not all(isinstance(part, Real) for part in parts):
        return None
    angle = sum(float(part) / 60.0**k for k, part in enumerate(parts))
    return -angle if str(place.get(tag, "")).startswith(negative) else angle
