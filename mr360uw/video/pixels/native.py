# SPDX-License-Identifier: Apache-2.0
"""Converts between PyAV frames and planes."""

from __future__ import annotations

from typing import Any

import av
import numpy as np
from av.sidedata.sidedata import Type
from numpy.typing import NDArray

from mr360uw.color import ColorSpec
from mr360uw.types import YuvImage


def plane_views(native: Any, spec: ColorSpec) -> YuvImage:
    """Return the planes of a PyAV frame as arrays that share its memory and keep it alive."""
    dtype = np.dtype(np.uint8 if spec.bits <= 8 else np.uint16)
    y, u, v = (_view(plane, dtype) for plane in native.planes)
    return YuvImage(y, u, v, spec)


def _view(plane: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    rows = np.frombuffer(plane, dtype).reshape(plane.height, plane.line_size // dtype.itemsize)
    return rows[:, : plane.width]


def pixel_format(image: YuvImage) -> str:
    """Return FFmpeg's name of the planes' layout; full range of 8 bits has a name of its own."""
    (height, width), (rows, columns) = image.y.shape, image.u.shape
    kind = "444" if columns == width else "422" if rows == height else "420"
    if image.spec.bits == 8:
        return f"yuv{'j' if image.spec.full_range else ''}{kind}p"
    return f"yuv{kind}p{image.spec.bits}le"


def native_frame(image: YuvImage, name: str | None = None) -> Any:
    """Return a new PyAV frame with a copy of the planes, optionally under another name of the same layout."""
    height, width = image.y.shape
    native = av.VideoFrame(width, height, name or pixel_format(image))
    for plane, source in zip(native.planes, (image.y, image.u, image.v), strict=True):
        np.copyto(_view(plane, source.dtype), source)
    return native


def has_stereo_mark(native: Any) -> bool:
    """Return whether a decoded frame has a mark of how its eyes are arranged.

    x264 takes a new arrangement for a change of settings in mid-stream, after which "lossless" loses a few codes.
    """
    return native.side_data.get(Type.STEREO3D) is not None


def copy_planes(image: YuvImage, name: str | None = None) -> tuple[Any, YuvImage]:
    """Return a new PyAV frame with a copy of the planes (see `native_frame`), and writable views of it."""
    native = native_frame(image, name)
    return native, plane_views(native, image.spec)
