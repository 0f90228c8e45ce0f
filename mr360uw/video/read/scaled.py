# SPDX-License-Identifier: Apache-2.0
"""A plate whose pictures are made smaller, for drafts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.types import YuvImage
from mr360uw.video.clip import Clip
from mr360uw.video.read.reader import VideoReader
from mr360uw.video.video_frame import VideoFrame

_LEAST_ROWS = 16


def scaled(plate: VideoReader, scale: float) -> VideoReader:
    """Return a plate with frames of `scale` times its width and height, rounded to even sizes; for 1 itself.

    Raises `ParameterError` unless 0 < scale <= 1 and at least 16 rows are left.
    """
    if scale == 1.0:
        return plate
    return _ScaledReader(plate, *scaled_size(plate, scale))


def scaled_size(plate: Clip, scale: float) -> tuple[int, int]:
    """Return the width and height of the frames of `scaled`; raise as it does."""
    if scale == 1.0:
        return plate.width, plate.height
    if not 0.0 < scale <= 1.0:
        raise ParameterError(f"scale - must be > 0 and <= 1 (got {scale}) - give 0.25 for a quarter of the width")
    width, height = (2 * round(0.5 * scale * size) for size in (plate.width, plate.height))
    if height < _LEAST_ROWS:
        raise ParameterError(
            f"scale - leaves frames of {width}x{height} of {plate.width}x{plate.height} (got {scale}) - give at least "
            f"{_LEAST_ROWS / plate.height:.2g}"
        )
    return width, height


class _ScaledReader(VideoReader):
    """Reduces frames by `smaller`. Frames keep their index and time stamps."""

    def __init__(self, plate: VideoReader, width: int, height: int) -> None:
        kept: dict[str, Any] = {field.name: getattr(plate, field.name) for field in fields(Clip)}
        super().__init__(**(kept | {"width": width, "height": height}))
        self._plate = plate

    @property
    def frame_count(self) -> int | None:
        """Number of frames; None for a still."""
        return self._plate.frame_count

    @property
    def intact_frames(self) -> int | None:
        """Number of frames whose data are there; see `VideoReader`."""
        return self._plate.intact_frames

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there."""
        return self._plate.doubts

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; see `VideoReader`."""
        return self._plate.check_range(start, stop)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        return (smaller(frame, self.width, self.height) for frame in self._plate.frames(start, stop))

    def file_of(self, index: int) -> Path:
        """Return the file that holds a frame."""
        return self._plate.file_of(index)


def smaller(frame: VideoFrame, width: int, height: int) -> VideoFrame:
    """Return a frame reduced to an even size; every pixel is the mean of the codes that it covers."""
    if frame.shape == (height, width):
        return frame
    if frame.right is not None:
        frame = replace(frame, right=smaller(frame.right, width, height))
    if frame.yuv is None:
        assert frame.rgb is not None
        return replace(frame, rgb=_reduced(frame.rgb, width, height))
    old, (rows, columns) = frame.yuv, frame.shape
    y, u, v = (
        _reduced(plane, width * plane.shape[1] // columns, height * plane.shape[0] // rows)
        for plane in (old.y, old.u, old.v)
    )
    return replace(frame, yuv=YuvImage(y, u, v, old.spec), native=None)


def _reduced(plane: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    import cv2

    small = np.asarray(cv2.resize(np.ascontiguousarray(plane), (width, height), interpolation=cv2.INTER_AREA))
    small.flags.writeable = False
    return small
