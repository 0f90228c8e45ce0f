# SPDX-License-Identifier: Apache-2.0
"""The sound of the sample dive: a tone that swells, in AAC."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

_RATE_HZ = 48_000
_TONE_HZ = 110.0
_BLOCK = 1024


def write_tone(path: Path, duration_s: Fraction) -> None:
    """Write a mono AAC track in an MP4 container that lasts `duration_s`."""
    import av

    samples = int(_RATE_HZ * duration_s)
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("aac", rate=_RATE_HZ)
        stream.layout = "mono"
        for start in range(0, samples, _BLOCK):
            t = np.arange(start, min(start + _BLOCK, samples)) / _RATE_HZ
            swell = 0.2 * (0.6 + 0.4 * np.sin(2.0 * np.pi * 0.5 * t))
            wave = (swell * np.sin(2.0 * np.pi * _TONE_HZ * t)).astype(np.float32)
            frame = av.AudioFrame.from_ndarray(wave[None], format="fltp", layout="mono")
            frame.sample_rate, frame.pts, frame.time_base = _RATE_HZ, start, Fraction(1, _RATE_HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
