# SPDX-License-Identifier: Apache-2.0
"""Reads pictures as the frames of a plate: a still, or a numbered sequence (PNG, JPEG, TIFF, EXR, HDR)."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec, Primaries, Transfer
from mr360uw.constants import MOST_LIGHT
from mr360uw.errors import VideoError
from mr360uw.reading.input_files import read_data
from mr360uw.reading.limits import FRAMES, PICTURE
from mr360uw.reading.numbered_files import is_pattern, matching_files
from mr360uw.reading.picture_size import picture_size
from mr360uw.shapes import checked, is_light
from mr360uw.video.read.layout import Eye, Layout, output_layout, panorama_crops
from mr360uw.video.read.picture_shape import shape_of_codes
from mr360uw.video.read.projection import PICTURE_SUFFIXES
from mr360uw.video.read.reader import VideoReader, check_range
from mr360uw.video.video_frame import VideoFrame


def picture_files(path: Path) -> list[Path] | None:
    """Return the pictures that a path, pattern or wildcard names, or None where it names no pictures."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        return None
    if path.exists():
        return [path]
    if is_pattern(path):
        hits = matching_files(path)
        for (number, _), (following, _) in pairwise(hits):
            if following != number + 1:
                raise VideoError(
                    f"{path} - picture {number + 1} of the sequence is missing (got {number}, then {following}) - "
                    "render it, or name the parts one by one"
                )
        files = [file for _, file in hits]
    elif set(path.name) & set("*?["):
        files = sorted(path.parent.glob(path.name))
    else:
        return [path]
    if not files:
        raise VideoError(f"{path} - no picture has such a name - check the path and the number of digits")
    return files


@checked
def read_picture(path: Path, *, depth: bool = False) -> NDArray[Any]:
    """Return the RGB codes of a picture, (H, W, 3): uint8, uint16, or linear float32 of EXR and HDR files.

    depth: EXR files are read by their channel Z where they have one.
    """
    from mr360uw.video.exr import read_rgb
    from mr360uw.video.read.probe import check_file

    check_file(path)
    if path.suffix.lower() == ".exr":
        return read_rgb(path, depth=depth)
    import cv2

    unusable = f"{path} - is not a picture that can be read, or it is cut short - save or copy it again"
    data = read_data(path, VideoError)
    size = picture_size(data)
    if size is None:
        raise VideoError(unusable)
    PICTURE.check(str(path), size[0] * size[1], VideoError)
    try:
        codes = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        raise VideoError(unusable) from error
    if codes is None:
        raise VideoError(unusable)
    if codes.dtype not in (np.uint8, np.uint16, np.float32):
        raise VideoError(
            f"{path} - samples of this kind are not supported (got {codes.dtype}) - save it with 8 or 16 bits"
        )
    return np.ascontiguousarray(codes[..., ::-1])


class ImageReader(VideoReader):
    """A still or a sequence of pictures as a plate; made by `open_video`. Frame k is the k-th picture by number."""

    def __init__(
        self,
        path: Path,
        files: list[Path],
        frame_rate: Fraction,
        transfer: Transfer | None,
        primaries: Primaries | None,
        eye: Eye | None,
        equirectangular: bool,
        depth: bool = False,
        layout: Layout | None = None,
    ) -> None:
        first = read_picture(files[0], depth=depth)
        self._files, self._wrap, self._depth = files, equirectangular, depth
        self._crop, self._beside, stereo = panorama_crops(
            path, (first.shape[1], first.shape[0]), None, eye, equirectangular=equirectangular, layout=layout,
            look=lambda: shape_of_codes(first, 8 * first.dtype.itemsize),
        )  # fmt: skip
        own = transfer or ("linear" if first.dtype.kind == "f" else "srgb")
        super().__init__(
            path=path,
            width=self._crop.width,
            height=self._crop.height,
            frame_rate=frame_rate,
            time_base=1 / frame_rate,
            spec=ColorSpec("bt709", True, own, 8 * first.dtype.itemsize, primaries),
            codec_name=files[0].suffix.lower().lstrip("."),
            is_still=len(files) == 1,
            panorama=equirectangular,
            stereo=output_layout(stereo) if self._beside is not None else "mono",
        )

    @property
    def frame_count(self) -> int | None:
        """Number of pictures; None for a still, which has as many frames as are asked for."""
        return None if self.is_still else len(self._files)

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop), stop filled in; VideoError where the sequence does not hold all of these frames."""
        if not self.is_still:
            return check_range(self.path, start, stop, len(self._files))
        start, stop = check_range(self.path, start, start + 1 if stop is None else stop, sys.maxsize)
        FRAMES.check(f"{self.path} frames", stop, VideoError)
        return start, stop

    def file_of(self, index: int) -> Path:
        """Return the picture of a frame."""
        return self._files[0 if self.is_still else min(index, len(self._files) - 1)]

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop; a still repeats, one frame by default."""
        return self._read(*self.check_range(start, stop))

    def _read(self, start: int, stop: int) -> Iterator[VideoFrame]:
        codes = self._codes(self._files[0]) if self.is_still else None
        for index in range(start, stop):
            both = codes if codes is not None else self._codes(self._files[index])
            time_s = float(index * self.time_base)
            eyes = [
                VideoFrame(index, index, self.time_base, time_s, 1, self.spec, rgb=rgb, wrap=self._wrap) for rgb in both
            ]
            yield replace(eyes[0], right=eyes[1]) if len(eyes) > 1 else eyes[0]

    def _codes(self, path: Path) -> list[NDArray[Any]]:
        """Return the codes of a picture, of both eyes where they are read."""
        codes = read_picture(path, depth=self._depth)
        if (codes.shape[1], codes.shape[0]) != self._crop.frame_size or 8 * codes.dtype.itemsize != self.spec.bits:
            raise VideoError(
                f"{path} - differs from the first picture of the sequence (got {codes.shape[1]}x{codes.shape[0]} "
                f"{codes.dtype}) - use pictures of one size and depth"
            )
        if self._wrap and codes.dtype.kind == "f" and not is_light(codes):
            got = f"got NaN, infinity or more than {MOST_LIGHT:g}"
            raise VideoError(f"{path} - holds samples that are no light ({got}) - repair the picture")
        codes.flags.writeable = False
        return [crop.window(codes) for crop in (self._crop, self._beside) if crop is not None]
