# SPDX-License-Identifier: Apache-2.0
"""Outputs: the interface of videos and pictures, encoded parts of a video, and the writer of pictures.

Everything is written under a new temporary name and renamed when complete; when anything fails, or the program is
interrupted, the temporary file is removed.
"""

from __future__ import annotations

import hashlib
import io
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import av
import av.error
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import HDR_CURVES, ColorSpec, in_plate_primaries
from mr360uw.base.disk_cache import read_arrays, write_arrays
from mr360uw.base.files import NewFile, is_pattern, matching_files, numbered, whole_file, writing
from mr360uw.base.input_files import HDR_SIZE
from mr360uw.errors import OutputExistsError, VideoError
from mr360uw.types import Floats
from mr360uw.video.clip import FLOAT_SUFFIXES, WRITTEN_SUFFIXES, Clip, EncodeSettings
from mr360uw.video.encoder import Encoder, resolved
from mr360uw.video.exr import write_exr
from mr360uw.video.other_tracks import exr_attributes
from mr360uw.video.picture_tags import HOLDING, exr_entries, with_tags, xmp_of
from mr360uw.video.planes import codes_from_linear
from mr360uw.video.reader import VideoFrame, whole_frame
from mr360uw.yuv.file_profile import FileProfile


class VideoWriter(ABC):
    """An output; made by `create_video`, used in a `with` block: leaving it completes the output.

    path: the file or the pattern. notes: parts of the plate that it lacks, one line each. Use it from one thread.
    """

    path: Path
    notes: tuple[str, ...] = ()
    _clip: Clip
    _images = 0

    def write_image(self, image_linear: Floats) -> None:
        """Append a picture of linear Rec.709 light (H, W, 3) at the next position in time."""
        index, base = self._images, self._clip.time_base
        step = round(1 / (self._clip.frame_rate * base))
        pts = self._clip.start_pts + index * step
        frame = VideoFrame.of_linear(np.asarray(image_linear, np.float32), index, float(index * step * base))
        self.write(replace(frame, pts=pts, time_base=base, duration=step))
        self._images += 1

    @abstractmethod
    def write(self, frame: VideoFrame) -> None:
        """Append a frame. Frames come in order of presentation. VideoError where it cannot be written."""

    @abstractmethod
    def finish(self) -> None:
        """Complete the output and let it appear under its name."""

    @abstractmethod
    def abort(self) -> None:
        """Remove everything that is not complete."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self.abort()


# Encoded parts of a video, each decodable on its own, that are joined without encoding them again.
#
# A segment is two files: its packets one after the other, and a table of them, which is written last, when the packets
# are on the disk. A segment is complete when its table is there and holds the hash of its name and its packets.

_DATA, _TABLE = ".packets", ".npz"


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Encoded frames [start, stop) of a plate.

    data: file of the packets. packets: (n, 4) int64 in decoding order: time stamp of presentation and duration in the
    plate's time base, whether decoding can start here, size in bytes.
    """

    start: int
    stop: int
    data: Path
    packets: NDArray[np.int64]


class SegmentWriter(VideoWriter):
    """Segments as output, each complete as soon as its last frame is written.

    path: of the folder that gets their files. parts: frames [start, stop) of each. An output that is given up ends the
    segment that is not complete with the frames that it has.
    """

    _encoder: Encoder
    _start: int

    def __init__(self, folder: Path, parts: Iterable[tuple[int, int]], like: Clip, settings: EncodeSettings) -> None:
        self.path, self._stops, self._clip, self._settings = folder, dict(parts), like, resolved(settings, like)
        self._file: BinaryIO | None = None

    def write(self, frame: VideoFrame) -> None:
        """Encode a frame into its segment."""
        if self._file is None:
            self._file = self._begun(frame.index)
        self._keep(self._file, self._encoder.encode(frame, frame.pts))
        self._next = frame.index + 1
        if self._next == self._stops[self._start]:
            self._complete(self._file)

    def _begun(self, start: int) -> BinaryIO:
        """Return the file of the packets of a segment, and make its encoder."""
        self._start = self._next = start
        self._data, self._lacks_packets = _data_path(self.path, start, self._stops[start]), False
        context = av.CodecContext.create(self._settings.encoder_name, "w")
        # parameter sets go into the header of the joined file, as its containers want
        context.flags |= av.codec.context.Flags.global_header
        self._encoder = Encoder(self._data, self._clip, self._settings, context)
        self._packets: list[tuple[int, int, int, int]] = []
        self._hash = hashlib.sha256()
        with self._errors():
            return self._data.open("wb")

    def _keep(self, file: BinaryIO, packets: list[Any]) -> None:
        with self._errors():
            for packet in packets:
                data = bytes(packet)
                size = file.write(data)
                self._hash.update(data)
                self._packets.append((packet.pts, packet.duration or 0, int(packet.is_keyframe), size))

    def _complete(self, file: BinaryIO) -> None:
        """Encode what is pending and write the table."""
        self._keep(file, self._encoder.flush())
        with self._errors():
            file.flush()
            os.fsync(file.fileno())  # after a power cut, no table stands beside packets that are not there
            file.close()
            mark = _mark(self._data, self._hash)
            table: dict[str, NDArray[Any]] = {"packets": np.array(self._packets, np.int64), "sha256": mark}
            write_arrays(self._data.with_suffix(_TABLE), table)
        self._file = None
        del self._encoder  # its memory is free before that of the next segment is taken

    def finish(self) -> None:
        """Nothing is left to do: every segment is complete."""
        if self._file is not None:
            lacking = self._stops[self._start] - self._next
            raise VideoError(f"{self._data} - lacks frames (got {lacking} too few) - render the segment again")

    def abort(self) -> None:
        """Complete the segment that has been begun with the frames that it has, under a name that says so.

        Without any, and where packets could not be written, it is removed.
        """
        if self._file is not None and self._next > self._start and not self._lacks_packets:
            with suppress(VideoError), self._errors():  # the error that ends the run says that the disk is full
                self._data = self._data.rename(_data_path(self.path, self._start, self._next))
                self._complete(self._file)
        if self._file is not None:
            with suppress(OSError):  # what is left in a buffer cannot be written where the disk is full
                self._file.close()
            self._data.unlink(missing_ok=True)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        with writing(self._data):
            try:
                yield
            except OSError:
                self._lacks_packets = True
                raise


def _data_path(folder: Path, start: int, stop: int) -> Path:
    return folder / f"{start:08d}-{stop:08d}{_DATA}"


def stored_segments(folder: Path) -> list[Segment]:
    """Return the complete segments in a folder by their first frame; damaged ones are left out."""
    found = []
    for table in sorted(folder.glob(f"????????-????????{_TABLE}")):
        data, stored = table.with_suffix(_DATA), read_arrays(table)
        try:
            start, stop = map(int, table.stem.split("-"))
            with data.open("rb") as file:
                mark = _mark(data, hashlib.file_digest(file, "sha256"))
        except (OSError, ValueError):
            continue
        if stored is not None and np.array_equal(stored.get("sha256", ()), mark):
            found.append(Segment(start, stop, data, stored["packets"]))
    return found


def _mark(data: Path, found: hashlib._Hash) -> NDArray[np.uint8]:
    """Return the hash (32,) of a segment's name and of its packets, whose own hash is given."""
    return np.frombuffer(hashlib.sha256(data.stem.encode() + found.digest()).digest(), np.uint8)


def decoding_stamps(pts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return time stamps of decoding (n,) for packets with time stamps of presentation (n,) in decoding order.

    They rise, none is after its packet's presentation, and the delay between both is as short as can be.
    """
    shown = np.sort(pts)
    place = np.arange(len(pts))
    delay = int(np.max(place - np.searchsorted(shown, pts)))
    step = int(np.min(np.diff(shown))) if len(pts) > 1 else 1
    before = shown[0] - step * np.arange(delay, 0, -1)
    return np.concatenate([before, shown[: len(pts) - delay]])


_DEEP_SUFFIXES = (".png", ".tif", ".tiff")


class ImageWriter(VideoWriter):
    """One picture, or a sequence numbered as the plate's files; each appears complete or not at all.

    EXR: linear Rec.709, objects not clipped, with frame number, rate, time code and the `envmap` attribute, in single
    precision for plates of floats, which then keep every bit and their own primaries, else in half. PNG and TIFF: 8
    bits, or 16 for plates with more. A plate's profile, EXIF and XMP are kept where the format holds them. Panoramas
    are marked (XMP), except pictures of two eyes, for which there is no mark. file: opens incomplete pictures.
    """

    def __init__(self, path: Path, like: Clip, overwrite: bool, file: NewFile = whole_file) -> None:
        self.path, self._clip, self._file = path, like, file
        self._many = is_pattern(path)
        self._written, suffix = 0, path.suffix.lower()
        if suffix not in WRITTEN_SUFFIXES:
            raise VideoError(f"{path} - this kind of picture is not written (got {suffix}) - take .png, .jpg or .exr")
        there = matching_files(path)[:1] if self._many else []
        if there and not overwrite:
            raise OutputExistsError(f"{there[0][1]} - is already there - choose another name or allow overwriting")
        lost = like.picture_tags.lost_in(suffix) if like.picture_tags is not None else ()
        self.notes = (*like.notes, *lost, *(["pictures carry no sound"] if like.sound is not None else []))

    def write(self, frame: VideoFrame) -> None:
        """Write the frame's picture."""
        if self._written and not self._many:
            raise VideoError(
                f"{self.path} - one picture cannot hold several frames - name a pattern such as "
                f"{self.path.stem}_%04d{self.path.suffix}"
            )
        path = numbered(self.path, frame.index + self._clip.first_number) if self._many else self.path
        told = exr_attributes(self._clip, frame.index) if path.suffix.lower() == ".exr" else None
        write_picture(path, whole_frame(frame, self._clip.stereo), self._file, told)
        self._written += 1

    def finish(self) -> None:
        """Nothing is left to do: every picture is complete."""
        if not self._written:
            raise VideoError(f"{self.path} - no frame was written - check the range of frames")

    def abort(self) -> None:
        """Nothing is left to remove: every picture is complete."""


def write_picture(
    path: Path, frame: VideoFrame, file: NewFile = whole_file, attributes: Mapping[str, Any] | None = None
) -> None:
    """Write a frame as a picture, by a temporary name and a rename; the kind follows the suffix.

    file: opens the temporary file. attributes: more entries of an EXR file's header.
    """
    if path.suffix.lower() == ".exr":
        _write_exr(path, frame, file, attributes or {})
        return
    with writing(path), file(path) as part:
        part.write_bytes(_encoded(path, frame))


def _write_exr(path: Path, frame: VideoFrame, file: NewFile, attributes: Mapping[str, Any]) -> None:
    """Write a frame in the plate's own primaries where the plate is an EXR that names some, else in Rec.709."""
    tags, profile = frame.picture_tags, frame.spec.mapping
    light, entries = frame.light, dict(attributes)
    if tags is not None:
        entries |= tags.header if tags.kind == ".exr" else exr_entries(tags.exif)
    if frame.rgb is not None and isinstance(profile, FileProfile) and profile.xy:
        light, entries["chromaticities"] = frame.rgb, profile.xy
    depth = np.float32 if frame.spec.bits == 32 else np.float16
    write_exr(path, light.astype(depth, copy=False), latlong=frame.wrap, file=file, attributes=entries)


def _encoded(path: Path, frame: VideoFrame) -> bytes:
    """Return the bytes of a picture with the plate's metadata; of a part of a panorama, that part."""
    suffix, tags = path.suffix.lower(), frame.picture_tags
    held, own = HOLDING.get(suffix, frozenset()), frame.spec.bits != 32 and tags is not None
    chunks = tags.png_colour if own and tags is not None and suffix == ".png" else _code_points(frame.spec, suffix)
    icc = tags.icc if own and tags is not None and "icc" in held else b""
    # Take the codes as the file is going to say them
    if suffix in FLOAT_SUFFIXES:
        as_stored = tags is not None and tags.kind == suffix and frame.rgb is not None and frame.spec.bits == 32
        pixels = frame.rgb if as_stored and frame.rgb is not None else frame.light
    else:
        pixels = picture_codes(frame, suffix in _DEEP_SUFFIXES, labelled=bool(icc or chunks))
    size, whole = (pixels.shape[1], pixels.shape[0]), frame.wrap
    if tags is not None and tags.size != tags.full_size == size:
        (column, row), size, whole = tags.origin, tags.size, False
        pixels = pixels[row : row + size[1], column : column + size[0]]
    # Encode them, and put the metadata in
    exif = tags.exif if tags is not None and "exif" in held else b""
    mark = xmp_of(tags, size, panorama=whole) if "xmp" in held else b""
    data = _webp(pixels, icc, exif, mark) if suffix == ".webp" else _by_opencv(path, pixels)
    if not data:
        raise VideoError(
            f"{path} - pictures of this kind are not so large (got {size[0]}x{size[1]}) - take .png, .tif or .exr"
        )
    if suffix == ".hdr":
        return _radiance(data, tags.lines if tags is not None and tags.kind == suffix else (), size)
    return with_tags(data, suffix, icc, exif, mark, chunks, () if tags is None else tags.own)


def _by_opencv(path: Path, pixels: NDArray[Any]) -> bytes:
    """Return the bytes of RGB pixels as a path's kind of picture; none where OpenCV does not encode it."""
    import cv2

    done, data = cv2.imencode(path.suffix, np.ascontiguousarray(pixels[..., ::-1]))
    return data.tobytes() if done else b""


def _webp(pixels: NDArray[Any], icc: bytes, exif: bytes, mark: bytes) -> bytes:
    """Return a lossless WebP; none where it is larger than its format allows."""
    from PIL import Image

    out = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    with suppress(ValueError):
        picture.save(out, "WEBP", lossless=True, quality=100, exif=exif, xmp=mark, icc_profile=icc)
    return out.getvalue()


def _radiance(data: bytes, lines: tuple[bytes, ...], size: tuple[int, int]) -> bytes:
    """Return a Radiance file with lines of a plate's header, exposure and primaries for example, in its own."""
    found = HDR_SIZE.search(data)
    assert found is not None  # OpenCV wrote it
    stored = () if any(line.startswith(b"FORMAT") for line in lines) else (b"FORMAT=32-bit_rle_rgbe",)
    head = b"\n".join((b"#?RADIANCE", *lines, *stored, b""))
    return head + b"\n-Y %d +X %d\n" % (size[1], size[0]) + data[found.end() :]


def _code_points(spec: ColorSpec, suffix: str) -> tuple[tuple[bytes, bytes], ...]:
    """Return the chunk of a PNG that says the curve of high dynamic range (ITU-T H.273); none for other curves."""
    number = next((number for number, curve in HDR_CURVES.items() if curve == spec.transfer), None)
    if suffix != ".png" or number is None or spec.gamut not in ("bt709", "bt2020"):
        return ()
    return ((b"cICP", bytes([9 if spec.gamut == "bt2020" else 1, number, 0, 1])),)


def picture_codes(frame: VideoFrame, deep: bool = True, *, labelled: bool = False) -> NDArray[Any]:
    """Return the RGB code values of a frame, (H, W, 3): uint8, or uint16 where the plate has more and `deep` allows.

    Integer RGB plates keep their codes; linear plates are encoded as sRGB, and so are those of a profile, unless the
    picture is labelled with it.
    """
    dtype, spec = np.uint16 if deep and frame.spec.bits > 8 else np.uint8, frame.spec
    converted = spec.mapping is not None and not spec.mapping.is_wide and not labelled
    if frame.rgb is not None and frame.rgb.dtype == dtype and not converted:
        return frame.rgb
    own = not converted and spec.bits != 32 and (frame.rgb is not None or spec.mapping is not None)
    light = in_plate_primaries(frame.image_linear, spec) if own else frame.image_linear
    curve = spec.transfer if own and spec.mapping is not None else spec.picture_transfer
    return codes_from_linear(light, curve, dtype, frame.index)
