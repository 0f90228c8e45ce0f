# SPDX-License-Identifier: Apache-2.0
"""Recording synthetic pictures and a tone as a 360 camera would: H.264, BT.709, AAC, spherical metadata.

The sensor's noise is that of counted photons and of reading them out, on linear light before its curve.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.color import Transfer, encode, ycbcr_from_rgb
from mr360uw.files import whole_file
from mr360uw.types import Floats

_FULL_WELL = 6000.0
"""Electrons of a pixel that is white, of a small camera in good light. Half as many: noise is 1.4 times as strong."""
_READ = 3.0
"""Standard deviation of reading a pixel out, in electrons."""


def with_noise(image: Floats, strength: float, seed: int, index: int) -> Floats:
    """Return a linear image (H, W, 3) as a sensor counts it; `strength` is a factor on the variance.

    The variance of a value v is (v/N + (r/N)^2) strength: N electrons are white, r those of reading out. Normal
    deviates stand for counts. Seed and index decide them.
    """
    if strength <= 0.0:
        return image
    rng = np.random.default_rng((seed, index, 0x4E01))
    variance = strength * (np.maximum(image, 0.0) / _FULL_WELL + (_READ / _FULL_WELL) ** 2)
    return np.asarray(image + np.sqrt(variance, dtype=np.float32) * rng.standard_normal(image.shape, np.float32))


_SOUND_RATE_HZ = 48_000
_TONE_HZ = 110.0
_BT709 = 1
"""FFmpeg's number of BT.709 among matrices, primaries and transfer curves."""
_FORMATS = {8: "yuv420p", 10: "yuv420p10le"}
_LIMITED = 1
"""FFmpeg's number of limited range (16 to 235)."""


def record(
    path: Path, images: Iterable[Floats], frame_rate: Fraction, seed: int, transfer: Transfer = "srgb",
    bits: Literal[8, 10] = 8,
) -> int:  # fmt: skip
    """Write linear images (H, W, 3) as an MP4 with a tone of the same length; return how many there were.

    Values above 1 clip, as in a camera. transfer, bits: of the codes. The file appears when it is complete.
    """
    from mr360uw.video import SphericalMetadata, write_spherical
    from mr360uw.video.read.probe import create_local

    count = 0
    with whole_file(path) as partial:
        with create_local(partial, "mp4") as container:
            sound = container.add_stream("aac", rate=_SOUND_RATE_HZ)
            sound.layout = "mono"
            video = container.add_stream("libx264", rate=frame_rate, options={"crf": "14", "preset": "veryfast"})
            video.pix_fmt = _FORMATS[bits]
            context = video.codec_context
            context.colorspace = context.color_primaries = context.color_trc = _BT709
            context.color_range = _LIMITED
            for image in images:
                if count == 0:
                    video.height, video.width = image.shape[:2]
                container.mux(video.encode(_picture(image, transfer, bits, (seed, count))))
                count += 1
            container.mux(video.encode(None))
            samples = int(_SOUND_RATE_HZ * count / frame_rate)
            for start in range(0, samples, 1024):
                container.mux(sound.encode(_tone(start, min(start + 1024, samples))))
            container.mux(sound.encode(None))
        write_spherical(partial, SphericalMetadata())
    return count


def _picture(image: Floats, transfer: Transfer, bits: Literal[8, 10], seed: tuple[int, int]) -> object:
    """Return a frame of planes, 4:2:0, limited range, each with a dither of its own.

    Dither goes onto Y', Cb and Cr, not onto RGB: in deep blue water a step of Cr is a tenth of the red.
    """
    import av

    code = encode(np.clip(image, 0.0, 1.0), transfer).astype(np.float32)
    luma, blue, red = np.moveaxis(code @ ycbcr_from_rgb("bt709").T.astype(np.float32), -1, 0)
    rng = np.random.default_rng(seed)
    frame = av.VideoFrame(code.shape[1], code.shape[0], _FORMATS[bits])
    step, kind = 2 ** (bits - 8), np.uint8 if bits == 8 else np.uint16
    for plane, values in zip(
        frame.planes, (16.0 + 219.0 * luma, *(128.0 + 224.0 * _halved(c) for c in (blue, red))), strict=True
    ):
        codes = np.clip(np.floor(step * values + rng.random(values.shape, np.float32)), step, 255 * step - 1)
        rows = np.zeros((plane.height, plane.line_size // np.dtype(kind).itemsize), kind)
        rows[:, : plane.width] = codes
        plane.update(rows.tobytes())
    return frame


def _halved(chroma: Floats) -> Floats:
    """Return half the rows and columns of a panorama's chroma, sited left: weights 1, 2, 1 across, 1, 1 down."""
    across = 0.25 * np.roll(chroma, 1, axis=1) + 0.5 * chroma + 0.25 * np.roll(chroma, -1, axis=1)
    return 0.5 * (across[0::2, 0::2] + across[1::2, 0::2])


def _tone(start: int, stop: int) -> object:
    """Return samples [start, stop) of a low tone that swells every two seconds."""
    import av

    t = np.arange(start, stop) / _SOUND_RATE_HZ
    swell = 0.2 * (0.6 + 0.4 * np.sin(np.pi * t))
    wave = (swell * np.sin(2.0 * np.pi * _TONE_HZ * t)).astype(np.float32)
    frame = av.AudioFrame.from_ndarray(wave[None], format="fltp", layout="mono")
    frame.sample_rate, frame.pts, frame.time_base = _SOUND_RATE_HZ, start, Fraction(1, _SOUND_RATE_HZ)
    return frame
