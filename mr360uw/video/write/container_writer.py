# SPDX-License-Identifier: Apache-2.0
"""Writes video files: encodes pictures, copies sound, marks the file as a 360 degree panorama."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error
from av.video.reformatter import ColorRange, Interpolation

from mr360uw.errors import VideoError
from mr360uw.video.clip import Clip
from mr360uw.video.metadata.spherical import V1_TAG, SphericalMetadata, v1_xml, write_spherical
from mr360uw.video.metadata.tags import BT709_TAGS, color_spec
from mr360uw.video.pixels.native import has_stereo_mark, native_frame, plane_views
from mr360uw.video.pixels.planes import planes_from_linear
from mr360uw.video.settings import ENCODERS, EncodeSettings
from mr360uw.video.video_frame import VideoFrame
from mr360uw.video.write.audio import CONTAINERS, AudioCopy, check_sound
from mr360uw.video.write.writer import VideoWriter

_ACCURATE = Interpolation.BICUBIC | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
_NO_PICTURE_TYPE = 0
_X265_DELAY = 3
"""Frames below which x265 4 leaves decoding time stamps uninitialised; such clips have no B-frames."""


class ContainerWriter(VideoWriter):
    """A video file as output; made by `create_video`.

    Pictures keep the plate's pixel format where the encoder has it, colour tags, time stamps and the container's time
    base (Matroska counts milliseconds).
    """

    def __init__(self, path: Path, like: Clip, settings: EncodeSettings, audio: bool, rebase: bool) -> None:
        self.path = path
        self._clip, self._settings, self._rebase = like, settings, rebase
        self._part = path.with_name(path.name + ".part")
        self._audio: AudioCopy | None = None
        self._container: Any = None
        self._last: VideoFrame | None = None
        self._shift = 0
        self._durations: dict[int, int] = {}
        self._count = 0
        kind = CONTAINERS.get(path.suffix.lower())
        if kind is None:
            raise VideoError(
                f"{path} - this kind of output is not known (got {path.suffix}) - take {', '.join(CONTAINERS)}"
            )
        self._boxes = kind in ("mp4", "mov")
        self._metadata = replace(like.spherical or SphericalMetadata(), stereo="mono")
        self.notes = (
            like.notes
            if self._boxes
            else (*like.notes, f"{path.suffix} gets the spherical metadata as a V1 tag, not as Projection elements")
        )
        sound = like.sound if audio and settings.sound else None
        try:
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
        self._container = av.open(str(self._part), "w", format=kind, options=options)
        self._container.metadata.update(_title_tags(like))
        if settings.codec == "av1":
            os.environ.setdefault("SVT_LOG", "1")  # SVT-AV1 writes its settings to stderr unless told not to
        try:
            stream = self._container.add_stream(ENCODERS[settings.codec], rate=like.frame_rate)
        except ValueError as error:
            raise VideoError(
                f"{self.path} - {self.path.suffix} cannot hold {settings.codec} (got {error}) - take .mov for prores, "
                ".mkv for ffv1, .mp4 for the others"
            ) from error
        context = stream.codec_context
        context.width, context.height = like.width, like.height
        context.pix_fmt = self._pixel_format(context.codec)
        context.time_base = like.time_base
        context.thread_type = "AUTO"
        context.thread_count = settings.threads
        context.options = settings.encoder_options()
        like.tags.write_to(context)
        # ProRes has no mark for full range: it is limited by definition.
        full_range = bool(like.pixel_format) and like.spec.full_range and settings.codec != "prores"
        context.color_range = int(ColorRange.JPEG if full_range else ColorRange.MPEG)
        if settings.codec == "h265" and self._boxes:
            context.codec_tag = "hvc1"
        if not self._boxes:
            stream.metadata[V1_TAG] = v1_xml(self._metadata)
        stream.time_base = like.time_base
        self._stream = stream
        if sound is not None:
            self._audio = AudioCopy(sound, self._container)
        self._container.start_encoding()

    def _pixel_format(self, codec: Any) -> str:
        """Return the format of the settings, or the encoder's that is closest to the plate's."""
        wanted = self._settings.pixel_format or self._clip.pixel_format or "yuv420p"
        known = [format_.name for format_ in codec.video_formats]
        plain = wanted.replace("yuvj", "yuv")
        deeper = [name for name in ("yuv420p10le", "yuv422p10le", "yuv444p10le") if name in known]
        if self._settings.pixel_format:
            deeper = []  # what was asked for by name is made, or refused
        for name in (wanted, plain, *(deeper if "10" in wanted or plain not in known else ())):
            if name in known:
                return name
        raise VideoError(
            f"{self.path} - {codec.name} cannot encode this pixel format (got {wanted}) - take one of "
            f"{', '.join(name for name in known if name.startswith('yuv4'))}"
        )

    def write(self, frame: VideoFrame) -> None:
        """Encode a frame and copy the sound up to it."""
        if self._container is None:
            raise VideoError(f"{self.path} - is already complete or given up - begin a new output")
        if frame.shape != (self._clip.height, self._clip.width):
            raise VideoError(
                f"{self.path} - frame {frame.index} has another size (got {frame.shape[1]}x{frame.shape[0]}) - write "
                f"frames of {self._clip.width}x{self._clip.height}"
            )
        with self._errors(f"written at frame {frame.index}"):
            if self._last is None:
                self._begin(frame)
            native = self._native(frame)
            native.pts, native.time_base = frame.pts - self._shift, frame.time_base
            native.pict_type = _NO_PICTURE_TYPE
            self._durations[native.pts] = frame.duration
            self._count += 1
            self._mux(self._stream.encode(native))
            if self._audio is not None:
                self._audio.advance(frame.pts * frame.time_base)
        self._last = frame

    def _begin(self, first: VideoFrame) -> None:
        whole = first.index == 0
        self._shift = first.pts - self._clip.start_pts if self._rebase and not whole else 0
        if self._audio is not None:
            start_s = None if whole else first.pts * first.time_base
            self._audio.begin(start_s, self._shift * first.time_base)

    def _mux(self, packets: list[Any]) -> None:
        for packet in packets:
            duration = self._durations.pop(packet.pts, 0)
            if self._count < _X265_DELAY and self._settings.codec == "h265":
                packet.dts = packet.pts
            if duration and packet.time_base == self._clip.time_base:
                packet.duration = duration
            self._container.mux(packet)

    def _native(self, frame: VideoFrame) -> Any:
        """Return the frame in the encoder's format; it shares memory with the plate where nothing was changed."""
        wanted = self._stream.codec_context.pix_fmt
        if frame.yuv is None:
            return _native_of_picture(frame, wanted)
        native = frame.native
        if native is None or has_stereo_mark(native):
            native = native_frame(frame.yuv, native.format.name if native is not None else None)
        if native.format.name == wanted:
            return native
        if native.format.name.replace("yuvj", "yuv") == wanted.replace("yuvj", "yuv"):
            return native_frame(frame.yuv, wanted)
        source_range = int(ColorRange.JPEG if frame.spec.full_range else ColorRange.MPEG)
        target_range = self._stream.codec_context.color_range
        return native.reformat(
            format=wanted, src_color_range=source_range, dst_color_range=target_range, interpolation=_ACCURATE
        )

    def finish(self) -> None:
        """Encode what is pending, copy the rest of the sound, mark the panorama and rename."""
        if self._container is None:
            return
        last = self._last
        if last is None:
            raise VideoError(f"{self.path} - no frame was written - check the range of frames")
        with self._errors("completed"):
            self._mux(self._stream.encode(None))
            if self._audio is not None:
                is_end = last.index + 1 == self._clip.frame_count
                self._audio.advance(None if is_end else _end_s(last, self._clip.frame_rate))
            self._container.close()
            self._container = None
            if self._boxes:
                write_spherical(self._part, self._metadata, self._settings.faststart)
            self._part.replace(self.path)

    def abort(self) -> None:
        """Close and remove the temporary file, if it is still there."""
        if self._audio is not None:
            self._audio.close()
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


def _native_of_picture(frame: VideoFrame, pixel_format: str) -> Any:
    """An RGB frame in BT.709, limited range; linear light by the sRGB curve."""
    height, width = frame.shape
    native = av.VideoFrame(width, height, pixel_format)
    transfer = "srgb" if frame.spec.transfer == "linear" else frame.spec.transfer
    spec = color_spec(Path(), pixel_format, BT709_TAGS, height, transfer)
    planes_from_linear(frame.image_linear, plane_views(native, spec), frame.wrap)
    return native


def _end_s(frame: VideoFrame, frame_rate: Fraction) -> Fraction:
    """When a frame is over, in seconds on the clock of its file."""
    duration = frame.duration * frame.time_base if frame.duration else 1 / frame_rate
    return frame.pts * frame.time_base + duration


def _title_tags(like: Clip) -> dict[str, str]:
    """Return the plate's text tags, such as title and date, without those of the container format."""
    own = {"major_brand", "minor_version", "compatible_brands", "encoder"}
    return {key: value for key, value in like.words.items() if key not in own}
