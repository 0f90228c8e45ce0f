# SPDX-License-Identifier: Apache-2.0
"""Encodes pictures with the plate's pixel format, colour tags and time stamps.

Hardware encoders of graphics cards are available if one grey picture can be encoded with them.
"""

from __future__ import annotations

import contextlib
import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
from av.video.reformatter import ColorRange, Interpolation

from mr360uw.errors import VideoError
from mr360uw.video.clip import BT709_TAGS, CODECS, CONTAINERS, HARDWARE, Clip, Codec, EncodeSettings, color_spec
from mr360uw.video.planes import has_stereo_mark, native_frame, plane_views, planes_from_linear
from mr360uw.video.reader import VideoFrame, whole_frame

_TRIAL_SIZE = (512, 256)
"""Of the picture that is tried [pixels]; some cards refuse pictures of less than 256 columns."""
_FORMATS = ("nv12", "yuv420p")


def refusal(name: str) -> str:
    """Return why an encoder of FFmpeg does not encode a grey picture here; "" where it does."""
    # Look the encoder up, and a format of pictures in memory that it takes
    try:
        codec = av.Codec(name, "w")
    except ValueError:
        return "this FFmpeg does not have it"
    known = [format_.name for format_ in codec.video_formats or ()]
    wanted = next((format_ for format_ in _FORMATS if format_ in known), None)
    if wanted is None:
        return "it takes pictures that are in the card's memory alone"
    try:
        # Encode one grey picture: hardware says only now that it is missing
        context = av.CodecContext.create(codec, "w")
        context.width, context.height = _TRIAL_SIZE
        context.pix_fmt, context.time_base, context.framerate = wanted, Fraction(1, 30), Fraction(30)
        picture = av.VideoFrame(*_TRIAL_SIZE, wanted)
        for plane in picture.planes:
            plane.update(bytes([128]) * plane.buffer_size)
        picture.pts = 0
        context.encode(picture)
        context.encode(None)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        return str(getattr(error, "strerror", None) or error)
    return ""


def check_encoder(settings: EncodeSettings) -> None:
    """Raise `VideoError` where the settings name an encoder of a graphics card that does not open here."""
    if settings.encoder not in HARDWARE:
        return
    if reason := refusal(settings.encoder):
        codec = HARDWARE[settings.encoder]
        software = CODECS[codec].software
        raise VideoError(
            f"output.encoder - {settings.encoder} does not open on this machine (got: {reason}) - check the card and "
            f'its driver, or set output.encoder = "software" and output.codec = "{codec}", which is {software}'
        )


def chosen_encoder(settings: EncodeSettings, like: Clip, path: Path) -> tuple[EncodeSettings, str]:
    """Return settings whose encoder is named, and a line on what was taken for "auto", "" where the settings name one.

    "auto" is the first encoder of a card that encodes a picture here in the codec of the settings and their target, or
    else FFmpeg's in software. path: of the output.
    """
    if settings.encoder != "auto":
        return settings, ""
    meant = resolved(settings, like, path)
    codec, refusals = meant.codec, dict[str, list[str]]()
    for name in (name for name, made in HARDWARE.items() if made == codec):
        if not (reason := refusal(name) or _refused_format(name, meant, like)):
            said = f'output.encoder = "auto" took {name}: the file differs from those of machines without it'
            return settings.model_copy(update={"encoder": name}), said
        refusals.setdefault(reason, []).append(name)
    why = "; ".join(f"{', '.join(names)}: {reason}" for reason, names in refusals.items())
    said = f'output.encoder = "auto" took {CODECS[codec].software}: no card encodes {codec} here{why and f" ({why})"}'
    return settings.model_copy(update={"encoder": "software"}), said


def _refused_format(name: str, settings: EncodeSettings, like: Clip) -> str:
    """Return why an encoder does not take the pictures of a plate; "" where it does."""
    known = [format_.name for format_ in av.Codec(name, "w").video_formats or ()]
    return "" if _pixel_format(known, settings, like) else f"it does not take {_plain_format(settings, like)}"


def _pixel_format(known: list[str], settings: EncodeSettings, like: Clip) -> str:
    """Return the format of the settings, or that of the known ones which is closest to the plate's; "" for neither."""
    wanted = _plain_format(settings, like)
    plain = wanted.replace("yuvj", "yuv")
    deeper = [name for name in ("yuv420p10le", "yuv422p10le", "yuv444p10le") if name in known]
    if settings.pixel_format:
        deeper = []  # what was asked for by name is made, or refused
    paired = _IN_PAIRS.get(plain, plain)  # the same samples, with Cb and Cr side by side, as cards take them
    several = (wanted, plain, paired, *(deeper if "10" in wanted or plain not in known else ()))
    return next((name for name in several if name in known), "")


def opening_encoders() -> tuple[str, ...]:
    """Return the encoders of graphics cards that open on this machine."""
    return tuple(name for name in HARDWARE if not refusal(name))


_ACCURATE = Interpolation.BICUBIC | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
_NO_PICTURE_TYPE = 0
_IN_PAIRS = {"yuv420p": "nv12", "yuv420p10le": "p010le"}
_X265_DELAY = 3
"""Frames below which x265 4 leaves decoding time stamps uninitialised; such clips have no B-frames."""


class Encoder:
    """An encoder for pictures of a plate. context: FFmpeg's, of the settings' codec, not yet open.

    path: the output, for messages. Packets have the frames' own time stamps and durations, in the plate's time base.
    """

    def __init__(self, path: Path, like: Clip, settings: EncodeSettings, context: Any) -> None:
        self._path, self._clip, self._settings, self._context = path, like, settings, context
        self._durations: dict[int, int] = {}
        self._count = 0
        if settings.codec == "av1":
            os.environ.setdefault("SVT_LOG", "1")  # SVT-AV1 writes its settings to stderr unless told not to
        context.width, context.height = like.frame_size
        context.pix_fmt = self._pixel_format(context.codec)
        self._check_size(*like.frame_size)
        if like.pixel_aspect:
            context.sample_aspect_ratio = like.pixel_aspect
        context.time_base = like.time_base
        context.framerate = like.frame_rate
        context.thread_type = "AUTO"
        context.thread_count = 0
        delivery = delivery_of(settings, like)
        context.options = settings.encoder_options(like.hdr, None if delivery is None else delivery[2])
        like.tags.write_to(context)
        # ProRes has no mark for full range: it is limited by definition.
        full_range = bool(like.pixel_format) and like.spec.full_range and settings.codec != "prores"
        context.color_range = int(ColorRange.JPEG if full_range else ColorRange.MPEG)

    def _pixel_format(self, codec: Any) -> str:
        """Return the format that pictures are encoded in; raise `VideoError` where the codec takes none that fits."""
        known = [format_.name for format_ in codec.video_formats]
        if found := _pixel_format(known, self._settings, self._clip):
            return found
        raise VideoError(
            f"{self._path} - {codec.name} cannot encode this pixel format (got "
            f"{_plain_format(self._settings, self._clip)}) - take one of "
            f"{', '.join(name for name in known if name.startswith('yuv4') or name in _IN_PAIRS.values())}"
        )

    def _check_size(self, width: int, height: int) -> None:
        """Raise `VideoError` where colour at half resolution does not come out even."""
        chroma = av.VideoFormat(self._context.pix_fmt, width, height).components[-1]
        if (chroma.width < width and width % 2) or (chroma.height < height and height % 2):
            raise VideoError(
                f"{self._path} - {self._context.pix_fmt} has colour at half resolution: columns and rows must be even "
                f"(got {width}x{height}) - crop or resize the plate, or write pictures"
            )

    def encode(self, frame: VideoFrame, pts: int) -> list[Any]:
        """Return the packets that are ready once a frame is encoded, with the time stamp `pts` in place of its own."""
        frame, (width, height) = whole_frame(frame, self._clip.stereo), self._clip.frame_size
        if frame.shape != (height, width):
            raise VideoError(
                f"{self._path} - frame {frame.index} has another size (got {frame.shape[1]}x{frame.shape[0]}) - write "
                f"frames of {width}x{height}"
            )
        native = self._native(frame)
        native.pts, native.time_base = pts, frame.time_base
        native.pict_type = _NO_PICTURE_TYPE
        self._durations[pts] = frame.duration
        self._count += 1
        packets = self._context.encode(native)
        if self._count == 1 and self._settings.codec == "av1":
            _without_real_time_priority()
        return self._timed(packets)

    def flush(self) -> list[Any]:
        """Return the packets that are left."""
        return self._timed(self._context.encode(None)) if self._count else []

    def _timed(self, packets: list[Any]) -> list[Any]:
        for packet in packets:
            duration = self._durations.pop(packet.pts, 0)
            if self._count < _X265_DELAY and self._settings.codec == "h265":
                packet.dts = packet.pts
            if duration and packet.time_base == self._clip.time_base:
                packet.duration = duration
        return packets

    def _native(self, frame: VideoFrame) -> Any:
        """Return the frame in the encoder's format; it shares memory with the plate where nothing was changed."""
        wanted = self._context.pix_fmt
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
        target_range = self._context.color_range
        return native.reformat(
            format=wanted, src_color_range=source_range, dst_color_range=target_range, interpolation=_ACCURATE
        )


def _without_real_time_priority() -> None:
    """Set threads of this process that run at real-time priority back to the usual one.

    SVT-AV1 gives it to itself and to the thread that opens it, where it may: as root. All else would wait for them.
    """
    threads = Path("/proc/self/task").iterdir() if hasattr(os, "sched_setscheduler") else ()
    for thread in (int(path.name) for path in threads):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            if os.sched_getscheduler(thread) == os.SCHED_FIFO:
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


def _native_of_picture(frame: VideoFrame, pixel_format: str) -> Any:
    """An RGB frame in BT.709, limited range; linear light, and that of a picture's profile, by the sRGB curve."""
    height, width = frame.shape
    native = av.VideoFrame(width, height, pixel_format)
    spec = color_spec(Path(), pixel_format, BT709_TAGS, height, (frame.spec.picture_transfer, None))
    mapping = frame.spec.mapping
    spec = spec.mapped(mapping) if mapping is not None and mapping.is_wide else spec
    planes_from_linear(frame.image_linear, plane_views(native, spec), frame.wrap)
    return native


# Codec, bit rate and key frames that YouTube and Meta recommend for 360 uploads: `output.target`.
#
# youtube-360: Google, "YouTube recommended upload encoding settings", answer 1722171 of its help: MP4 with the index in
# front, H.264 High with two B frames, 4:2:0, closed groups of half a second, the upper ends of its bit rates; for high
# dynamic range H.265 in 10 bits. quest: Meta, "Encoding high-resolution 360 and 180 video", on its blog for creators:
# MP4, H.265, short groups; here 10 bits where the plate has them, and the same bit rates. Bit rates between the sizes
# of the table, and beyond, follow the number of pixels on logarithmic axes.

_PIXELS = np.array([1280 * 720, 1920 * 1080, 2560 * 1440, 3840 * 2160, 7680 * 4320])
# Mbit/s, answer 1722171, the upper end where it gives two: 24 to 30 frames a second, and 48 to 60.
_SDR = np.array([(5.0, 7.5), (8.0, 12.0), (16.0, 24.0), (45.0, 68.0), (160.0, 240.0)])
_HDR = np.array([(6.5, 9.5), (10.0, 15.0), (20.0, 30.0), (56.0, 85.0), (200.0, 300.0)])
_FAST = 40.0  # frames a second from which the rates are those of 48 to 60
_PEAK, _BUFFER_S = 1.5, 2.0  # of the mean bit rate; a buffer shorter than a group makes key frames poor


def delivery_of(settings: EncodeSettings, like: Clip) -> tuple[Codec, str, dict[str, str]] | None:
    """Return what the target of an output asks for; None without one.

    It is the codec, the pixel format, and FFmpeg's options of every encoder: bit rate, closed groups, two B frames.
    """
    if settings.target == "none":
        return None
    # Interpolate the bit rate that the target recommends, over pixels on logarithmic axes
    hdr = like.spec.transfer in ("pq", "hlg")
    ten = hdr or (settings.target == "quest" and like.spec.bits > 8)
    width, height = like.frame_size
    rates = (_HDR if hdr else _SDR)[:, int(like.frame_rate > _FAST)]
    place = np.log(width * height / _PIXELS)
    i = int(np.clip(np.searchsorted(-place, 0.0) - 1, 0, len(_PIXELS) - 2))
    slope = np.log(rates[i + 1] / rates[i]) / np.log(_PIXELS[i + 1] / _PIXELS[i])
    rate = float(rates[i] * np.exp(slope * place[i]))
    # Half a second between closed groups of pictures
    bit_rate, gop = round(rate * 1e6), max(1, round(like.frame_rate / 2))
    options = {
        "b": str(bit_rate),
        "maxrate": str(round(_PEAK * bit_rate)),
        "bufsize": str(round(_BUFFER_S * bit_rate)),
        "g": str(gop),
        "bf": "2",
        "flags": "+cgop",
    }
    codec: Codec = "h265" if hdr or settings.target == "quest" else "h264"
    return codec, "yuv420p10le" if ten else "yuv420p", options


def _plain_format(settings: EncodeSettings, like: Clip) -> str:
    """Return FFmpeg's name of the pixel format that an output is wanted in; those of more than 8 bits end in "le"."""
    return settings.pixel_format or like.pixel_format or "yuv420p"


def codec_note(wished: Codec, settings: EncodeSettings, like: Clip) -> str:
    """Return a note on the codec of pictures with more than 8 bits, "" of others.

    wished: as the user named it. settings: resolved.
    """
    wanted = _plain_format(settings, like)
    if settings.target != "none" or not wanted.endswith("le"):
        return ""
    if settings.codec == "h264":
        return (
            f"output.codec - is H.264 of {wanted}, which browsers, phones and headsets do not decode - take h265, or "
            'output.pixel_format = "yuv420p"'
        )
    if settings.codec == "h265" and wished == "auto":
        return (
            f"output.codec - h265 is taken, as players do not decode H.264 of more than 8 bits (got {wanted}) - "
            'set output.pixel_format = "yuv420p" for h264 of 8'
        )
    return ""


def resolved(settings: EncodeSettings, like: Clip, path: Path | None = None) -> EncodeSettings:
    """Return settings with the codec and the pixel format that their target and their encoder mean.

    path: of the output, whose kind is checked. VideoError where the target takes another kind or another encoder.
    """
    delivery = delivery_of(settings, like)
    if delivery is None:
        deep = _plain_format(settings, like).endswith("le")
        own = ("h265" if deep else "h264") if settings.codec == "auto" else settings.codec
        return settings.model_copy(update={"codec": HARDWARE.get(settings.encoder, own)})
    codec, pixel_format, _ = delivery
    if path is not None and CONTAINERS.get(path.suffix.lower()) != "mp4":
        raise VideoError(
            f'{path} - output.target = "{settings.target}" is an mp4 (got {path.suffix}) - name it '
            f"{path.stem}.mp4, or leave the target out"
        )
    if HARDWARE.get(settings.encoder, codec) != codec:
        fits = [name for name, made in HARDWARE.items() if made == codec]
        raise VideoError(
            f'output.encoder - output.target = "{settings.target}" takes {codec} for this plate (got '
            f"{settings.encoder}) - take one of {', '.join(fits)}, or software"
        )
    return settings.model_copy(update={"codec": codec, "pixel_format": pixel_format})
