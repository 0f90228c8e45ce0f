# SPDX-License-Identifier: Apache-2.0
"""A plate whose pictures are made smaller, for drafts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.types import YuvImage
from mr360uw.video.clip import Clip
from mr360uw.video.read.reader import ReaderOver, VideoReader
from mr360uw.video.video_frame import VideoFrame

_LEAST_ROWS = 16


def scaled(plate: VideoReader, scale: float) -> VideoReader:
    """Return a plate with frames of `scale` times its width and height, rounded to even sizes; for 1 itself.

    Raises `ParameterError` unless 0 < scale <= 1 and at least 16 rows are left.
    """
    if scale == 1.0:
        return plate
    width, height = scaled_size(plate, scale)
    return _ScaledReader(plate, width=width, height=height)


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


class _ScaledReader(ReaderOver):
    """Reduces frames by `smaller`. Frames keep their index and time stamps."""

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        return (smaller(frame, self.width, self.height) for frame in self._plate.frames(start, stop))


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
