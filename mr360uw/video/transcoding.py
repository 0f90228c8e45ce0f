# SPDX-License-Identifier: Apache-2.0
"""Decodes a plate and encodes it again unchanged: the time and quality that any compositing is compared with."""

from __future__ import annotations

from pathlib import Path

from mr360uw.video.read.opening import open_video
from mr360uw.video.settings import EncodeSettings
from mr360uw.video.write.creating import create_video


def transcode(
    source: str | Path,
    target: str | Path,
    settings: EncodeSettings | None = None,
    *,
    start: int = 0,
    stop: int | None = None,
    overwrite: bool = False,
    equirectangular: bool = True,
) -> int:
    """Decode and encode the frames start <= index < stop of a plate, with sound; returns their number."""
    count = 0
    with open_video(source, equirectangular=equirectangular) as video:
        frames = video.frames(start, stop)
        span = video.check_range(start, stop)
        with create_video(target, video, settings, overwrite=overwrite, frames=span) as out:
            for frame in frames:
                out.write(frame)
                count += 1
    return count
