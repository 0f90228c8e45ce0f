# SPDX-License-Identifier: Apache-2.0
"""Grey pictures of a clip, key frames chosen by motion, and pixels that stand still while the rest moves.

Grey values are the clip's luma codes, reduced to `WIDTH` columns at most: wider pictures take longer and gain little,
since a code's noise and the codec's blocks limit where a feature is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.sphere import direction_from_frame
from mr360uw.types import Floats
from mr360uw.video import VideoFrame, VideoReader

Grey = NDArray[np.uint8]
WIDTH = 1280
"""Widest picture that is tracked [px]: 0.28 degrees a pixel."""
_FLOW_WIDTH = 640
"""Width [px] of the pictures by which key frames are chosen."""
_CORNERS = 300
_KEY_TURN = np.radians(2.5)
"""Median motion of features [rad] after which a frame becomes a key frame. Half: twice the time, no better path."""
_LOST = 0.4
"""Share of features that are still followed below which a frame becomes a key frame."""
_LEAST_KEYS = 16
"""Key frames of a clip that hardly moves: evenly spaced, so that its motion is seen at all."""
LEAST_FRAMES = 4
"""Fewest frames of a clip that is tracked."""
_LEAST_CONTRAST = 1.5
"""Least standard deviation [codes] of a picture; below, it is of one colour."""
_LEAST_CORNERS = 25
"""Fewest corners of a picture with enough texture."""
_STILL_CODES = 3.0
"""Standard deviation over time [codes] up to which a pixel stands still: twice a codec's noise."""
_TEXTURED_CODES = 4.0
"""Least standard deviation [codes] around a pixel whose standing still means anything."""
_STILL_OF_TEXTURE = 0.35
"""Largest standard deviation over time over that around it of a pixel that stands still."""
_LARGEST_STILL = 0.5
"""Share of textured pixels that stand still above which nothing is left out: then the whole scene does."""
_LEAST_KEYS_OF_MASK = 6


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrames:
    """Key frames of a clip: their numbers (k,) and files in a folder, the times of all frames, and the fixed pixels.

    fixed (H, W): True where the picture stands still while the rest moves.
    """

    index: NDArray[np.int64]
    paths: tuple[Path, ...]
    time_s: Floats
    width: int
    height: int
    fixed: NDArray[np.bool_]


def grey_picture(frame: VideoFrame) -> Grey:
    """Return the luma codes of a frame, (H, W) uint8, at most `WIDTH` wide."""
    import cv2

    if frame.yuv is not None:
        luma = frame.yuv.y
        bits = frame.yuv.spec.bits
        grey = (luma >> max(bits - 8, 0)).astype(np.uint8) if luma.dtype != np.uint8 else luma
    else:
        green = np.clip(frame.image_linear[..., 1], 0.0, 1.0)
        grey = (255.0 * green ** (1.0 / 2.2) + 0.5).astype(np.uint8)
    if grey.shape[1] <= WIDTH:
        return np.ascontiguousarray(grey)
    return np.asarray(cv2.resize(np.ascontiguousarray(grey), (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA))


class _Motion:
    """Follows corners since the last key frame, in small pictures."""

    def __init__(self, small: Grey) -> None:
        import cv2

        self._last = small
        found = cv2.goodFeaturesToTrack(small, _CORNERS, 0.01, 8)
        self.start = np.zeros((0, 1, 2), np.float32) if found is None else found
        self._now, self._alive = self.start, np.ones(len(self.start), bool)

    def is_key(self, small: Grey) -> bool:
        """Follow the corners into the next picture; return whether they moved far enough or are lost."""
        import cv2

        if not self._alive.any():
            return True
        self._now, found, _ = cv2.calcOpticalFlowPyrLK(self._last, small, self._now, self._now.copy())
        self._alive &= found.ravel().astype(bool)
        self._last = small
        if np.mean(self._alive) < _LOST:
            return True
        height, width = small.shape
        a, b = (
            direction_from_frame(place[self._alive, 0, 0], place[self._alive, 0, 1], width, height)
            for place in (self.start, self._now)
        )
        # corners on a rig stand still: the upper quartile is that of what moves
        return bool(np.percentile(np.linalg.norm(a - b, axis=1), 75) > _KEY_TURN)


def read_key_frames(video: VideoReader, folder: Path, tell: Iterator[None]) -> KeyFrames:
    """Choose key frames of a clip and write them as PNG into a folder.

    tell: is advanced after every frame. Raises `ParameterError` for stills, clips that are too short, pictures of one
    colour and such without texture.
    """
    import cv2

    if video.is_still:
        raise ParameterError(f"{video.path} - is one picture, whose camera has no path - give a video")
    count = video.frame_count or 0
    if count < LEAST_FRAMES:
        raise ParameterError(f"{video.path} - is too short (got {count} frames) - give at least {LEAST_FRAMES}")
    every = set(np.linspace(0, count - 1, min(count, _LEAST_KEYS)).astype(int).tolist())
    keys, paths, times, motion, fixed = [], [], [], None, None
    contrast, corners = 0.0, 0
    for frame in video.frames():
        grey = grey_picture(frame)
        height, width = grey.shape
        scale = min(1.0, _FLOW_WIDTH / width)
        small = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
        times.append(frame.time_s)
        if motion is None or frame.index in every or motion.is_key(small):
            motion = _Motion(small)
            contrast, corners = max(contrast, float(small.std())), max(corners, len(motion.start))
            keys.append(frame.index)
            paths.append(folder / f"{frame.index:08d}.png")
            cv2.imwrite(str(paths[-1]), grey)
            fixed = _FixedPixels(small.shape) if fixed is None else fixed
            fixed.add(small)
        next(tell)
    if contrast < _LEAST_CONTRAST:
        raise ParameterError(f"{video.path} - is of one colour - give a clip that shows the floor, a wall or a reef")
    if corners < _LEAST_CORNERS or fixed is None:
        raise ParameterError(
            f"{video.path} - has no texture to follow (got {corners} corners) - give a clip that shows the floor"
        )
    mask = cv2.resize(fixed.mask().astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)
    return KeyFrames(np.array(keys), tuple(paths), np.array(times), width, height, mask)


class _FixedPixels:
    """Mean and variance over time of every pixel of small pictures."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._count, self._sum, self._squares = 0, np.zeros(shape), np.zeros(shape)

    def add(self, small: Grey) -> None:
        self._count += 1
        self._sum += small
        self._squares += np.square(small, dtype=np.float64)

    def mask(self) -> NDArray[np.bool_]:
        """Return where the picture stands still (H, W); nowhere if most of it does, or there are too few pictures."""
        import cv2

        nothing = np.zeros(self._sum.shape, bool)
        if self._count < _LEAST_KEYS_OF_MASK:
            return nothing
        mean = self._sum / self._count
        temporal = np.sqrt(np.maximum(self._squares / self._count - mean**2, 0.0))
        size = (9, 9)
        around = np.sqrt(np.maximum(cv2.blur(mean**2, size) - cv2.blur(mean, size) ** 2, 0.0))
        textured = np.maximum(around, temporal) > _TEXTURED_CODES
        still = textured & (temporal < _STILL_CODES) & (temporal < _STILL_OF_TEXTURE * around)
        if np.count_nonzero(still) > _LARGEST_STILL * np.count_nonzero(textured):
            return nothing
        closed = cv2.morphologyEx(still.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        closed = cv2.morphologyEx(closed, cv2.MORPH_CLOSE, np.ones((15, 15), np.uint8))
        return np.asarray(cv2.dilate(closed, np.ones((7, 7), np.uint8))).astype(bool)
