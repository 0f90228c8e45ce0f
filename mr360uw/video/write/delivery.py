# SPDX-License-Identifier: Apache-2.0
"""Codec, bit rate and key frames that YouTube and Meta recommend for 360 uploads: `output.target`.

youtube-360: Google, "YouTube recommended upload encoding settings", answer 1722171 of its help: MP4 with the index in
front, H.264 High with two B frames, 4:2:0, closed groups of half a second, the upper ends of its bit rates; for high
dynamic range H.265 in 10 bits. quest: Meta, "Encoding high-resolution 360 and 180 video", on its blog for creators:
MP4, H.265, short groups; here 10 bits where the plate has them, and the same bit rates. Bit rates between the sizes of
the table, and beyond, follow the number of pixels on logarithmic axes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mr360uw.errors import VideoError
from mr360uw.video.clip import Clip
from mr360uw.video.settings import HARDWARE, Codec, EncodeSettings

_PIXELS = np.array([1280 * 720, 1920 * 1080, 2560 * 1440, 3840 * 2160, 7680 * 4320])
# Mbit/s, answer 1722171, the upper end where it gives two: 24 to 30 frames a second, and 48 to 60.
_SDR = np.array([(5.0, 7.5), (8.0, 12.0), (16.0, 24.0), (45.0, 68.0), (160.0, 240.0)])
_HDR = np.array([(6.5, 9.5), (10.0, 15.0), (20.0, 30.0), (56.0, 85.0), (200.0, 300.0)])
_FAST = 40.0  # frames a second from which the rates are those of 48 to 60
_SUFFIXES = (".mp4", ".m4v")
_PEAK, _BUFFER_S = 1.5, 2.0  # of the mean bit rate; a buffer shorter than a group makes key frames poor


def delivery_of(settings: EncodeSettings, like: Clip) -> tuple[Codec, str, dict[str, str]] | None:
    """Return what the target of an output asks for; None without one.

    It is the codec, the pixel format, and FFmpeg's options of every encoder: bit rate, closed groups, two B frames.
    """
    if settings.target == "none":
        return None
    hdr = like.spec.transfer in ("pq", "hlg")
    ten = hdr or (settings.target == "quest" and like.spec.bits > 8)
    width, height = like.frame_size
    rates = (_HDR if hdr else _SDR)[:, int(like.frame_rate > _FAST)]
    place = np.log(width * height / _PIXELS)
    i = int(np.clip(np.searchsorted(-place, 0.0) - 1, 0, len(_PIXELS) - 2))
    slope = np.log(rates[i + 1] / rates[i]) / np.log(_PIXELS[i + 1] / _PIXELS[i])
    rate = float(rates[i] * np.exp(slope * place[i]))
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


def plain_format(settings: EncodeSettings, like: Clip) -> str:
    """Return FFmpeg's name of the pixel format that an output is wanted in; those of more than 8 bits end in "le"."""
    return settings.pixel_format or like.pixel_format or "yuv420p"


def codec_note(wished: Codec, settings: EncodeSettings, like: Clip) -> str:
    """Return a note on the codec of pictures with more than 8 bits, "" of others.

    wished: as the user named it. settings: resolved.
    """
    wanted = plain_format(settings, like)
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
        deep = plain_format(settings, like).endswith("le")
        own = ("h265" if deep else "h264") if settings.codec == "auto" else settings.codec
        return settings.model_copy(update={"codec": HARDWARE.get(settings.encoder, own)})
    codec, pixel_format, _ = delivery
    if path is not None and path.suffix.lower() not in _SUFFIXES:
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
