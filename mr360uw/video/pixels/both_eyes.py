# SPDX-License-Identifier: Apache-2.0
"""Joins the pictures of two eyes into one, as stereo files hold them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import YuvImage
from mr360uw.video.metadata.spherical import Stereo
from mr360uw.video.video_frame import VideoFrame


def whole_frame(frame: VideoFrame, stereo: Stereo) -> VideoFrame:
    """Return a frame with its right eye beside or below it, arranged as `stereo` says; itself for mono.

    The codes are copied. The result is no panorama: its edges do not meet.
    """
    right = frame.right
    if right is None:
        return frame
    axis = 0 if stereo == "top-bottom" else 1

    def joined(left: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
        both = np.concatenate([left, other], axis=axis)
        both.flags.writeable = False
        return both

    down, across = (frame.shape[0], 0) if axis == 0 else (0, frame.shape[1])
    beside = tuple((r._replace(row=r.row + down, column=r.column + across), light) for r, light in right.clipped)
    clipped = frame.clipped + beside
    if frame.yuv is None or right.yuv is None:
        assert frame.rgb is not None
        assert right.rgb is not None
        return replace(frame, rgb=joined(frame.rgb, right.rgb), native=None, wrap=False, right=None, clipped=clipped)
    a, b = frame.yuv, right.yuv
    planes = YuvImage(joined(a.y, b.y), joined(a.u, b.u), joined(a.v, b.v), a.spec)
    return replace(frame, yuv=planes, native=None, wrap=False, right=None, clipped=clipped)
