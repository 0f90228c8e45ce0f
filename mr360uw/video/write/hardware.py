# SPDX-License-Identifier: Apache-2.0
"""Availability of the hardware encoders of graphics cards, tested by encoding one grey picture with each."""

from __future__ import annotations

from fractions import Fraction

import av
import av.error

from mr360uw.errors import VideoError
from mr360uw.video.settings import ENCODERS, HARDWARE, EncodeSettings

_TRIAL_SIZE = (512, 256)
"""Of the picture that is tried [pixels]; some cards refuse pictures of less than 256 columns."""
_FORMATS = ("nv12", "yuv420p")


def refusal(name: str) -> str:
    """Return why an encoder of FFmpeg does not encode a grey picture here; "" where it does."""
    try:
        codec = av.Codec(name, "w")
    except ValueError:
        return "this FFmpeg does not have it"
    known = [format_.name for format_ in codec.video_formats or ()]
    wanted = next((format_ for format_ in _FORMATS if format_ in known), None)
    if wanted is None:
        return "it takes pictures that are in the card's memory alone"
    try:
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
    if settings.encoder == "software":
        return
    if reason := refusal(settings.encoder):
        codec = HARDWARE[settings.encoder]
        raise VideoError(
            f"output.encoder - {settings.encoder} does not open on this machine (got: {reason}) - check the card and "
            f'its driver, or set output.encoder = "software" and output.codec = "{codec}", which is {ENCODERS[codec]}'
        )


def opening_encoders() -> tuple[str, ...]:
    """Return the encoders of graphics cards that open on this machine."""
    return tuple(name for name in HARDWARE if not refusal(name))
