# SPDX-License-Identifier: Apache-2.0
"""The mean of a plate over the waves, where its camera stands: free of caustics, with all else of the ground."""

from __future__ import annotations

import numpy as np

from mr360uw.color import luminance
from mr360uw.types import Floats
from mr360uw.video import VideoFrame

FRAMES = 240
"""Frames of a clip, from its start, that its mean is taken over: ten seconds, several periods of the waves."""
_EVERY = 8
"""Frames between those that are read: caustics a third of a second apart have little in common."""
_LEAST_FRAMES = 6
"""Frames below which a mean still shows the caustics themselves."""
_COLUMNS = 256
_SHIFT = 2
_STANDS = 0.8
"""Fraction of the frames that must lie best on the mean without a shift for the camera to count as standing."""


class CalmSeries:
    """Collects the mean of a clip's first frames."""

    def __init__(self) -> None:
        self._sum: Floats | None = None
        self._small: list[Floats] = []

    def add(self, frame: VideoFrame) -> None:
        """Take a frame into the mean, where it is one of those that are."""
        import cv2

        if frame.index >= FRAMES or frame.index % _EVERY:
            return
        linear = frame.image_linear
        self._sum = linear.copy() if self._sum is None else self._sum + linear
        size = (_COLUMNS, _COLUMNS // 2)
        below = cv2.resize(luminance(linear).astype(np.float32), size, interpolation=cv2.INTER_AREA)[_COLUMNS // 4 :]
        self._small.append(below - cv2.GaussianBlur(below, (0, 0), 4.0))

    def mean(self) -> Floats | None:
        """Return the mean (H, W, 3), float16, or None where there is too little of it, or the camera moves."""
        if self._sum is None or len(self._small) < _LEAST_FRAMES or not stands(self._small):
            return None
        return (self._sum / np.float32(len(self._small))).astype(np.float16)


def stands(pictures: list[Floats]) -> bool:
    """Return whether small pictures (h, w), less their own blur, show one scene from one place.

    Each is laid over the mean of the others at shifts of up to two pixels; where it fits best without one, nothing has
    moved.
    """
    total, unmoved = np.sum(pictures, axis=0), 0
    shifts = [(j, i) for j in range(-_SHIFT, _SHIFT + 1) for i in range(-_SHIFT, _SHIFT + 1)]
    inside = slice(_SHIFT, -_SHIFT)
    for picture in pictures:
        others = total - picture
        fits = [float(np.sum(np.roll(picture, shift, (0, 1))[inside] * others[inside])) for shift in shifts]
        unmoved += shifts[int(np.argmax(fits))] == (0, 0)
    return unmoved >= _STANDS * len(pictures)
