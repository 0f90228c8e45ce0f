# SPDX-License-Identifier: Apache-2.0
"""Writes video files: pictures, copied sound, and the mark of a panorama; the layer alone as a video with alpha."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import av
import av.error
import numpy as np
from av.stream import Disposition
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from mr360uw.base.color import REC709_XY, encode, rec709_from_chromaticities
from mr360uw.base.files import check_outputs, is_pattern, matching_files, new_file, publish, whole_file, writing
from mr360uw.base.input_files import FRAMES
from mr360uw.base.parameters import checked
from mr360uw.errors import VideoError
from mr360uw.types import Floats
from mr360uw.video.clip import BT709_TAGS, CONTAINERS, Clip, EncodeSettings, checked_rate
from mr360uw.video.demux import create_local
from mr360uw.video.encoder import Encoder, check_encoder, chosen_encoder, codec_note, resolved
from mr360uw.video.exr import primaries_of, read_exr
from mr360uw.video.other_tracks import TrackCopy, check_sound, embed_spatial, other_tracks
from mr360uw.video.reader import VideoFrame
from mr360uw.video.spherical import (
    V1_TAG,
    Box,
    SphericalMetadata,
    carry_tags,
    edit_moov,
    embed,
    read_moov,
    v1_xml,
    write_spherical,
)
from mr360uw.video.writer import Segment, VideoWriter, decoding_stamps

_OWN_WORDS = frozenset({"major_brand", "minor_version", "compatible_brands", "encoder"})
"""Tags of the container's format, of which each file has its own."""
_USUAL_WORDS = _OWN_WORDS | frozenset(
    ("creation_time", "title", "artist", "comment", "date", "copyright", "description", "location")
)
"""Tags that FFmpeg writes into every kind of MP4 and QuickTime file unasked."""


class ContainerWriter(VideoWriter):
    """A video file as output; made by `create_video`.

    Pictures keep the plate's pixel format where the encoder has it, colour tags, time stamps and the container's time
    base (Matroska counts milliseconds). folder: of the incomplete file; default: that of `path`. frames:
    (start, stop) of those that will be written, which time code and chapters follow; default: all of the plate's.
    """

    def __init__(
        self,
        path: Path,
        like: Clip,
        settings: EncodeSettings,
        *,
        rebase: bool = True,
        overwrite: bool = False,
        folder: Path | None = None,
        frames: tuple[int, int] | None = None,
    ) -> None:
        # Choose the encoder: what is asked for, as this machine and the plate allow
        self.path = path
        wished = settings.codec
        settings, taken = chosen_encoder(settings, like, path)
        settings = resolved(settings, like, path)
        self._clip, self._settings, self._rebase, self._overwrite = like, settings, rebase, overwrite
        self._copies: list[TrackCopy] = []
        self._container: Any = None
        self._next = 0
        self._end_s: Fraction | None = None
        self._shift = 0
        # Find what this kind of container can keep of the plate's other tracks
        kind = CONTAINERS.get(path.suffix.lower())
        if kind is None:
            raise VideoError(
                f"{path} - this kind of output is not known (got {path.suffix}) - take {', '.join(CONTAINERS)}"
            )
        self._boxes = kind in ("mp4", "mov")
        sphere = replace(like.spherical or SphericalMetadata(), stereo=like.stereo)
        self._metadata = sphere if like.panorama else None
        sound = like.sound if settings.sound else None
        span = frames or (0, like.frame_count or 0)
        others = other_tracks(like, kind, wanted=settings.data, sound=sound, frames=span)
        self._data, self._timecode, self._chapters, self._spatial, self.notes = others
        self.notes += tuple(filter(None, [taken, codec_note(wished, settings, like)]))
        if not self._boxes and self._metadata is not None:
            posed = " its pose is not kept: write .mp4 or .mov" if any(self._metadata.pose_deg) else ""
            said = f"{path.suffix} gets the spherical metadata as a V1 tag, not as Projection elements"
            self.notes += (f"{said};{posed}" if posed else said,)
        # Begin a file of a temporary name; leave none where that fails
        with self._errors("begun"):
            self._part = new_file(path, folder)
        try:
            check_encoder(settings)
            with self._errors("begun"):
                if sound is not None:
                    check_sound(sound, path)
                self._open(kind, sound)
        except BaseException:
            self.abort()
            raise

    def _open(self, kind: str, sound: Path | None) -> None:
        like, settings = self._clip, self._settings
        scale = str(like.time_base.denominator)
        options = {"movie_timescale": scale, "video_track_timescale": scale} if self._boxes else {}
        tagged = like.pixel_format and like.path.is_file()
        self._tagged = read_moov(like.path) if self._boxes and tagged else None
        if self._boxes and self._tagged is None and like.words.keys() - _USUAL_WORDS:
            options["movflags"] = "use_metadata_tags"  # all of them as keys of QuickTime
        self._container = create_local(self._part, kind, options)
        self._container.metadata.update(
            {key: text for key, text in like.words.items() if key.lower() not in _OWN_WORDS}
        )
        try:
            stream = self._container.add_stream(settings.encoder_name, rate=like.frame_rate)
        except ValueError as error:
            raise VideoError(
                f"{self.path} - {self.path.suffix} cannot hold {settings.codec} (got {error}) - take .mov for prores, "
                ".mkv for ffv1, .mp4 for the others"
            ) from error
        self._encoder = Encoder(self.path, like, settings, stream.codec_context)
        if settings.codec == "h265" and self._boxes:
            stream.codec_context.codec_tag = "hvc1"
        if not self._boxes and self._metadata is not None:
            stream.metadata[V1_TAG] = v1_xml(self._metadata)
        stream.metadata.update(like.track_words)
        stream.disposition = Disposition.default
        stream.time_base = like.time_base
        self._stream = stream
        if sound is not None:
            self._copies.append(TrackCopy(sound, self._container))
        if self._data:
            self._copies.append(TrackCopy(like.path, self._container, self._data))
        self._container.set_chapters(list(self._chapters))
        if self._timecode:
            stream.metadata["timecode"] = self._timecode
        self._container.start_encoding()

    def write(self, frame: VideoFrame) -> None:
        """Encode a frame and copy the sound up to it."""
        self._check_open()
        with self._errors(f"written at frame {frame.index}"):
            if self._end_s is None:
                self._begin(frame.index, frame.pts)
            self._mux(self._encoder.encode(frame, frame.pts - self._shift))
            self._copy_until(frame.pts * frame.time_base)
        self._next, self._end_s = frame.index + 1, self._end(frame.pts, frame.duration)

    def write_segments(self, segments: Sequence[Segment]) -> None:
        """Append encoded segments, which follow each other, as they are; copy the sound in step with them."""
        self._check_open()
        packets = np.concatenate([segment.packets for segment in segments])
        stamps = iter(decoding_stamps(packets[:, 0]))
        base = self._clip.time_base
        self._begin(segments[0].start, int(packets[:, 0].min()))
        with self._errors("joined"):
            for segment in segments:
                with segment.data.open("rb") as data:
                    for pts, duration, key, size in segment.packets.tolist():
                        packet = av.Packet(data.read(size))
                        packet.pts, packet.dts = pts - self._shift, int(next(stamps)) - self._shift
                        packet.duration, packet.is_keyframe, packet.time_base = duration, bool(key), base
                        self._mux([packet])
                        self._copy_until((packet.dts + self._shift) * base)
        last = packets[np.argmax(packets[:, 0])]
        self._next, self._end_s = segments[-1].stop, self._end(int(last[0]), int(last[1]))

    def _check_open(self) -> None:
        if self._container is None:
            raise VideoError(f"{self.path} - is already complete or given up - begin a new output")

    def _begin(self, index: int, pts: int) -> None:
        whole, base = index == 0, self._clip.time_base
        self._shift = pts - self._clip.start_pts if self._rebase and not whole else 0
        for copy in self._copies:
            copy.begin(None if whole else pts * base, self._shift * base)

    def _copy_until(self, until_s: Fraction | None) -> None:
        for copy in self._copies:
            copy.advance(until_s)

    def _end(self, pts: int, duration: int) -> Fraction:
        """When a frame is over, in seconds on the clock of its file."""
        clip = self._clip
        return pts * clip.time_base + (duration * clip.time_base if duration else 1 / clip.frame_rate)

    def _mux(self, packets: list[Any]) -> None:
        for packet in packets:
            packet.stream = self._stream
            self._container.mux(packet)

    def finish(self) -> None:
        """Encode what is pending, copy the rest of the sound, mark the panorama and rename."""
        if self._container is None:
            return
        if self._end_s is None:
            raise VideoError(f"{self.path} - no frame was written - check the range of frames")
        with self._errors("completed"):
            self._mux(self._encoder.flush())
            self._copy_until(None if self._next == self._clip.frame_count else self._end_s)
            self._container.close()
            self._container = None
            if self._boxes:
                edit_moov(self._part, self._mark, front=True)
            publish(self._part, self.path, overwrite=self._overwrite)

    def _mark(self, moov: Box) -> None:
        """Mark a panorama and spatial audio in a file's index, and copy the tags of the plate's file."""
        if self._tagged is not None:
            carry_tags(moov, self._tagged)
        embed_spatial(moov, self._spatial)
        if self._metadata is not None:
            embed(moov, self._metadata)

    def abort(self) -> None:
        """Close and remove the temporary file, if it is still there."""
        for copy in self._copies:
            copy.close()
        if self._container is not None:
            with suppress(av.error.FFmpegError, OSError, ValueError):
                self._container.close()
            self._container = None
        self._part.unlink(missing_ok=True)

    @contextmanager
    def _errors(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (av.error.FFmpegError, OSError) as error:
            reason = getattr(error, "strerror", None) or error
            raise VideoError(
                f"{self.path} - cannot be {doing} (got {reason}) - check the space left, the folder's rights, and that "
                f"{self.path.suffix} can hold {self._settings.codec}"
            ) from error


# EXR layers of a composite as Apple ProRes 4444 with alpha, for editors that read no EXR.
#
# Colours are the layer's, linear Rec.709 with the water in front, encoded as sRGB, the curve by which plates are read,
# and tagged BT.709. Alpha is linear. Straight: the codes are those of the colour itself. Premultiplied: those codes
# times alpha, so that an editor lays codes over codes. Light without coverage, as of shafts, is premultiplied only.

Alpha = Literal["straight", "premultiplied"]

_ENCODER, _PIXEL_FORMAT = "prores_ks", "yuva444p10le"
_OPTIONS = {"profile": "4444", "alpha_bits": "16"}
_PEAK = 65535


@checked
def layer_video(
    layers: str | Path,
    path: str | Path,
    *,
    alpha: Alpha = "straight",
    frame_rate: Fraction | float = 30,
    eye: Literal["left", "right"] | None = None,
    overwrite: bool = False,
) -> tuple[int, int]:
    """Write EXR layers as a video with alpha, ProRes 4444 in a .mov; return (frames, those of them without a file).

    layers: the pattern that `composite --layers` was given. A number without a file, between the first and the last,
    is a transparent frame. alpha: straight or premultiplied. frame_rate: frames a second. eye: of layers of two eyes.
    VideoError where the layers cannot be read or the video cannot be written.
    """
    layers, path = Path(layers), Path(path)
    files = dict(matching_files(layers)) if is_pattern(layers) else {}
    if not files or layers.suffix.lower() != ".exr":
        raise VideoError(f"{layers} - names no numbered EXR files - give the pattern of --layers, as layers_%04d.exr")
    rate = checked_rate(frame_rate, path)
    if path.suffix.lower() != ".mov":
        raise VideoError(f"{path} - ProRes with alpha is a .mov (got {path.suffix}) - name it {path.stem}.mov")
    check_outputs([path], inputs=[layers], overwrite=overwrite)
    first, last = min(files), max(files)
    FRAMES.check(f"{layers} frames", last - first + 1, VideoError)  # before a range, whose length has 63 bits
    numbers = range(first, last + 1)
    with writing(path, av.error.FFmpegError), whole_file(path, overwrite=overwrite) as part:
        _encode(part, [files.get(number) for number in numbers], alpha, rate, eye)
        write_spherical(part, SphericalMetadata(), front=True)
    return len(numbers), len(numbers) - len(files)


def _encode(part: Path, files: list[Path | None], alpha: Alpha, rate: Fraction, eye: str | None) -> None:
    size: tuple[int, int] | None = None
    first = next(file for file in files if file is not None)
    with create_local(part, "mov") as container:
        stream = container.add_stream(_ENCODER, rate=rate, options=_OPTIONS)
        context = stream.codec_context
        # The first layer sets the size of all; a frame without one is empty
        for index, file in enumerate(files):
            rgba = _rgba(first if file is None else file, eye)
            if size is None:
                size = (rgba.shape[1], rgba.shape[0])
                context.width, context.height = size
                context.pix_fmt, context.time_base = _PIXEL_FORMAT, 1 / rate
                BT709_TAGS.write_to(context)
            if (rgba.shape[1], rgba.shape[0]) != size:
                raise VideoError(
                    f"{file} - differs from the first layer (got {rgba.shape[1]}x{rgba.shape[0]}) - name one run's"
                )
            # Let FFmpeg turn RGB into Y'CbCr with alpha
            codes = _layer_codes(rgba if file is not None else np.zeros_like(rgba), alpha)
            native = av.VideoFrame.from_ndarray(codes, format="rgba64le")
            native = native.reformat(
                format=_PIXEL_FORMAT, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
            native.pts, native.time_base = index, 1 / rate
            container.mux(stream.encode(native))
        container.mux(stream.encode(None))


def _layer_codes(rgba: Floats, alpha: Alpha) -> NDArray[np.uint16]:
    """Return 16-bit codes (H, W, 4) of premultiplied linear light and alpha (H, W, 4)."""
    cover = np.clip(rgba[..., 3:], 0.0, 1.0).astype(np.float64)
    covered = cover > 0.0
    light = np.where(covered, rgba[..., :3] / np.where(covered, cover, 1.0), rgba[..., :3])
    codes = encode(np.clip(light, 0.0, 1.0), "srgb")
    codes = codes * np.where(covered, cover, 1.0) if alpha == "premultiplied" else np.where(covered, codes, 0.0)
    return np.round(np.concatenate([codes, cover], axis=-1) * _PEAK).astype(np.uint16)


def _rgba(file: Path, eye: str | None) -> NDArray[Any]:
    parts = read_exr(file)
    name = "rgba" if eye is None else f"rgba.{eye}"
    if name not in parts or "RGBA" not in parts[name]:
        eyes = [part for part in parts if part.startswith("rgba.")]
        todo = "name an eye, left or right" if eyes and eye is None else "give the layers of `composite --layers`"
        raise VideoError(f"{file} - has no part {name} (got {', '.join(list(parts)[:6])}) - {todo}")
    rgba = np.array(parts[name]["RGBA"], np.float32)
    own = primaries_of(file)
    if own != REC709_XY:
        rgba[..., :3] = rgba[..., :3] @ rec709_from_chromaticities(np.reshape(own, (4, 2))).T
    return rgba
