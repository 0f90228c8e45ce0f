# SPDX-License-Identifier: Apache-2.0
"""Plates: videos, image sequences and stills, all read alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Self

from mr360uw.color import ColorSpec, Transfer
from mr360uw.errors import VideoError
from mr360uw.video.frame import VideoFrame
from mr360uw.video.layout import Eye
from mr360uw.video.spherical import SphericalMetadata
from mr360uw.video.tags import ColorTags


class VideoReader(ABC):
    """A plate; made by `open_video`.

    path: the file, or the pattern of a sequence. width, height: of the panorama, after the choice of an eye.
    frame_rate: mean frames per second. time_base: unit of the time stamps. start_pts: time stamp of frame 0.
    spec: how the codes are read. tags: the file's colour tags. codec_name, pixel_format: FFmpeg's names; pixel_format
    is "" for RGB plates. has_audio: whether there is sound to copy. spherical: metadata found, or None. is_still: one
    picture, that `frames` repeats as often as asked. notes: what the file holds and a copy will not.
    container_metadata: title, date and other words about the file.
    """

    path: Path
    width: int
    height: int
    frame_rate: Fraction
    time_base: Fraction
    start_pts: int
    spec: ColorSpec
    tags: ColorTags
    codec_name: str
    pixel_format: str
    has_audio: bool = False
    spherical: SphericalMetadata | None = None
    is_still: bool = False
    notes: tuple[str, ...] = ()
    container_metadata: Mapping[str, str] = MappingProxyType({})

    @property
    @abstractmethod
    def frame_count(self) -> int | None:
        """Number of frames; None for a still, which has as many as are asked for."""

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
        """Nothing stays open between passes."""


def check_range(path: Path, start: int, stop: int | None, count: int) -> tuple[int, int]:
    """Return (start, stop), stop filled in with the count; VideoError unless 0 <= start < stop <= count."""
    end = count if stop is None else stop
    if not 0 <= start < end <= count:
        raise VideoError(
            f"{path} - frames outside the clip (got {start}:{'' if stop is None else stop}, the clip has {count} frames) "
            f"- take a range within 0:{count}"
        )
    return start, end


def open_video(
    path: str | Path,
    transfer: Transfer | None = None,
    *,
    eye: Eye | None = None,
    frame_rate: Fraction | float = 30,
    equirectangular: bool = True,
) -> VideoReader:
    """Open a plate: a video (mp4, mov, mkv, webm ...), one picture, or a sequence of pictures.

    path: a file, or the pattern of a sequence: "plate_%04d.png", "plate_####.exr" or "plate_*.png".
    transfer: curve from code values to linear light; by default sRGB, and none for EXR and HDR pictures.
    eye: "left" or "right" of a stereo plate. frame_rate: of pictures, which have none of their own.
    equirectangular: refuse what is not a 2:1 panorama.

    VideoError where the plate cannot be used.
    """
    from mr360uw.video.images import ImageReader, picture_files

    files = picture_files(Path(path))
    if files is not None:
        rate = Fraction(frame_rate).limit_denominator(1001)
        return ImageReader(Path(path), files, rate, transfer, eye, equirectangular)
    from mr360uw.video.container import ContainerReader

    return ContainerReader(Path(path), transfer, eye, equirectangular)
