# SPDX-License-Identifier: Apache-2.0
"""Recording synthetic pictures and a tone as a 360 camera would: H.264, BT.709, AAC, spherical metadata."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from mr360uw.color import encode
from mr360uw.files import whole_file
from mr360uw.types import Floats

_SOUND_RATE_HZ = 48_000
_TONE_HZ = 110.0
_BT709 = 1
"""FFmpeg's number of BT.709 among matrices, primaries and transfer curves."""
_LIMITED = 1
"""FFmpeg's number of limited range (16 to 235)."""


def record(path: Path, images: Iterable[Floats], frame_rate: Fraction, seed: int) -> int:
    """Write linear images (H, W, 3) as an MP4 with a tone of the same length; return how many there were.

    Values above 1 clip, as in a camera. The file appears when it is complete.
    """
    import av

    from mr360uw.video import SphericalMetadata, write_spherical

    count = 0
    with whole_file(path) as partial:
        with av.open(str(partial), "w", format="mp4") as container:
            sound = container.add_stream("aac", rate=_SOUND_RATE_HZ)
            sound.layout = "mono"
            video = container.add_stream("libx264", rate=frame_rate, options={"crf": "14", "preset": "veryfast"})
            video.pix_fmt = "yuv420p"
            context = video.codec_context
            context.colorspace = context.color_primaries = context.color_trc = _BT709
            context.color_range = _LIMITED
            for image in images:
                if count == 0:
                    video.height, video.width = image.shape[:2]
                container.mux(video.encode(_picture(image, count, seed)))
                count += 1
            container.mux(video.encode(None))
            samples = int(_SOUND_RATE_HZ * count / frame_rate)
            for start in range(0, samples, 1024):
                container.mux(sound.encode(_tone(start, min(start + 1024, samples))))
            container.mux(sound.encode(None))
        write_spherical(partial, SphericalMetadata())
    return count


def _picture(image: Floats, index: int, seed: int) -> object:
    """Return a frame of 8-bit code values with a dither of its own."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    code = 255.0 * encode(np.clip(image, 0.0, 1.0), "srgb")
    dither = np.random.default_rng((seed, index)).random(code.shape[:2])[..., None]
    rgb = np.clip(np.floor(code + dither), 0, 255).astype(np.uint8)
    frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
    return frame.reformat(
        format="yuv420p",
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        interpolation="AREA",
    )


def _tone(start: int, stop: int) -> object:
    """Return samples [start, stop) of a low tone that swells every two seconds."""
    import av

    t = np.arange(start, stop) / _SOUND_RATE_HZ
    swell = 0.2 * (0.6 + 0.4 * np.sin(np.pi * t))
    wave = (swell * np.sin(2.0 * np.pi * _TONE_HZ * t)).astype(np.float32)
    frame = av.AudioFrame.from_ndarray(wave[None], format="fltp", layout="mono")
    frame.sample_rate, frame.pts, frame.time_base = _SOUND_RATE_HZ, start, Fraction(1, _SOUND_RATE_HZ)
    return frame
