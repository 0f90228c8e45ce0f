# SPDX-License-Identifier: Apache-2.0
"""Plates: videos, image sequences and stills, all read alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Self

from mr360uw.color import Transfer
from mr360uw.errors import VideoError
from mr360uw.video.clip import Clip
from mr360uw.video.frame import VideoFrame
from mr360uw.video.read.layout import Eye


class VideoReader(Clip, ABC):
    """A plate; made by `open_video`. What is known of it: see `Clip`."""

    @abstractmethod
    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; VideoError where the plate does not hold all of these frames."""

    @abstractmethod
    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop (to the end by default).

        Frame k is the same however it is reached. The range is checked at once, the frames are decoded as they are
        asked for. Use each iterator from one thread; several may run side by side.
        """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the plate; no file stays open between passes."""
        return


def check_range(path: Path, start: int, stop: int | None, count: int) -> tuple[int, int]:
    """Return (start, stop), stop filled in with the count; VideoError unless 0 <= start < stop <= count."""
    end = count if stop is None else stop
    if not 0 <= start < end <= count:
        raise VideoError(
            f"{path} - frames outside the clip (got {start}:{'' if stop is None else stop}, the clip has "
            f"{count} frames) - take a range within 0:{count}"
        )
    return start, end


def open_video(
    path: str | Path,
    transfer: Transfer | None = None,
    *,
    eye: Eye | None = None,
    frame_rate: Fraction | float = 30,
    equirectangular: bool = True,
    depth: bool = False,
) -> VideoReader:
    """Open a plate: a video (mp4, mov, mkv, webm ...), one picture, or a sequence of pictures.

    path: a file, or the pattern of a sequence: "plate_%04d.png", "plate_####.exr" or "plate_*.png".
    transfer: curve from code values to linear light; by default sRGB, and none for EXR and HDR pictures.
    eye: "left" or "right" of a stereo plate. frame_rate: of pictures, which have none of their own.
    equirectangular: refuse what is not a 2:1 panorama. depth: read EXR pictures by their channel Z if they have one.

    VideoError where the plate cannot be used.
    """
    from mr360uw.video.read.images import ImageReader, picture_files

    files = picture_files(Path(path))
    if files is not None:
        rate = Fraction(frame_rate).limit_denominator(1001)
        return ImageReader(Path(path), files, rate, transfer, eye, equirectangular, depth)
    from mr360uw.video.read.container import ContainerReader

    return ContainerReader(Path(path), transfer, eye, equirectangular)
