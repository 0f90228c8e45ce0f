# SPDX-License-Identifier: Apache-2.0
"""Grey pictures of a clip, and its shots with key frames chosen by motion.

Grey values are the clip's luma codes, reduced to `WIDTH` columns at most: wider pictures take longer and gain little,
since a code's noise and the codec's blocks limit where a feature is. Cuts are where
the picture changes at once and stays changed.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.files import write_whole
from mr360uw.base.input_files import read_json
from mr360uw.base.progress import Steps
from mr360uw.base.sphere import direction_from_frame
from mr360uw.errors import ParameterError
from mr360uw.types import Floats
from mr360uw.video import VideoFrame, VideoReader

_STILL_CODES = 3.0
"""Standard deviation over time [codes] up to which a pixel stands still: twice a codec's noise."""
_TEXTURED_CODES = 4.0
"""Least standard deviation [codes] around a pixel whose standing still means anything."""
_STILL_OF_TEXTURE = 0.35
"""Largest standard deviation over time over that around it of a pixel that stands still."""
_LARGEST_STILL = 0.5
"""Share of textured pixels that stand still above which nothing is left out: then the whole scene does."""
_LEAST_KEYS_OF_MASK = 6


def fixed_pixels(pictures: Iterable[NDArray[np.uint8]]) -> NDArray[np.bool_]:
    """Return the pixels that stand still while the rest of pictures (H, W) of one size moves, (H, W): a rig, a hand.

    Nowhere if most of the picture stands still; nothing, (0, 0), for fewer than six pictures.
    """
    count, total, squares = 0, np.zeros(()), np.zeros(())
    for picture in pictures:
        count, total, squares = count + 1, total + picture, squares + np.square(picture, dtype=np.float64)
    if count < _LEAST_KEYS_OF_MASK:
        return np.zeros((0, 0), bool)
    mean = total / count
    temporal = np.sqrt(np.maximum(squares / count - mean**2, 0.0))
    size = (9, 9)
    around = np.sqrt(np.maximum(cv2.blur(mean**2, size) - cv2.blur(mean, size) ** 2, 0.0))
    textured = np.maximum(around, temporal) > _TEXTURED_CODES
    still = textured & (temporal < _STILL_CODES) & (temporal < _STILL_OF_TEXTURE * around)
    if np.count_nonzero(still) > _LARGEST_STILL * np.count_nonzero(textured):
        return np.zeros(mean.shape, bool)
    closed = cv2.morphologyEx(still.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    closed = cv2.morphologyEx(closed, cv2.MORPH_CLOSE, np.ones((15, 15), np.uint8))
    return np.asarray(cv2.dilate(closed, np.ones((7, 7), np.uint8))).astype(bool)


_SIZE = (32, 16)
_LEAST_CHANGE = 0.3
"""Mean change of a thumbnail, in its standard deviations, of a cut. Two pictures that have nothing in common differ by
1.1; a car that drives out from under a bridge reaches 0.15."""
_OVER_USUAL = 4.0
"""Least change of a cut over the median change of the clip."""
_CERTAIN_CHANGE = 0.8
"""Change that is a cut in any clip: the fastest swimming over a chequered floor reaches 0.3."""
_NOISE_CODES = 4.0


def thumbnail(grey: NDArray[np.uint8]) -> Floats:
    """Return a picture's (16, 32) means over blocks, less their mean, over their standard deviation."""
    small = np.asarray(cv2.resize(grey, _SIZE, interpolation=cv2.INTER_AREA), np.float64)
    return np.asarray((small - small.mean()) / (small.std() + _NOISE_CODES))


def find_picture_cuts(thumbnails: Floats) -> tuple[int, ...]:
    """Return the first frames after cuts, of thumbnails (n, 16, 32).

    A flash in one frame is none. Where most frames differ by half as much as a cut, as noise does, there are none.
    """
    if len(thumbnails) < 3:
        return ()
    change = np.abs(np.diff(thumbnails, axis=0)).mean(axis=(1, 2))
    limit = min(max(_LEAST_CHANGE, _OVER_USUAL * float(np.median(change))), _CERTAIN_CHANGE)
    if float(np.median(change)) > 0.5 * limit:
        return ()
    cuts: list[int] = []
    for k in (np.flatnonzero(change > limit) + 1).tolist():
        stays = np.abs(thumbnails[min(k + 1, len(thumbnails) - 1)] - thumbnails[k - 1]).mean() > limit
        returned = k >= 2 and np.abs(thumbnails[k] - thumbnails[k - 2]).mean() < limit and change[k - 2] > limit
        if stays and not returned:
            cuts.append(k)
    return tuple(cuts)


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
_LEAST_FRAMES = 4
"""Fewest frames of a clip that is tracked."""
_LEAST_CONTRAST = 1.5
"""Least standard deviation [codes] of a picture; below, it is of one colour."""
_LEAST_CORNERS = 25
"""Fewest corners of a picture with enough texture."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrames:
    """Key frames of a shot: their numbers in it (k,) and files, the times of all its frames, and the fixed pixels.

    first: number of the shot's first frame in the clip. fixed (H, W): True where the picture stands still while the
    rest moves.
    """

    first: int
    index: NDArray[np.int64]
    paths: tuple[Path, ...]
    time_s: Floats
    width: int
    height: int
    fixed: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Reading:
    """First reading of a clip: numbers of key frames, times [s] of all frames, first frames after cuts, size [px]."""

    keys: list[int]
    times_s: list[float]
    cuts: list[int]
    width: int
    height: int

    @property
    def shots(self) -> list[tuple[int, int]]:
        """First frame of each shot, and the frame after its last."""
        edges = [0, *self.cuts, len(self.times_s)]
        return list(itertools.pairwise(edges))


def grey_picture(frame: VideoFrame) -> Grey:
    """Return the luma codes of a frame, (H, W) uint8, at most `WIDTH` wide."""
    grey = luma_codes(frame)
    if grey.shape[1] <= WIDTH:
        return grey
    return np.asarray(cv2.resize(grey, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA))


def luma_codes(frame: VideoFrame) -> Grey:
    """Return the luma codes of a frame, or those of its green, (H, W) uint8."""
    if frame.yuv is not None:
        luma = frame.yuv.y
        grey = luma if luma.dtype == np.uint8 else (luma >> max(frame.yuv.spec.bits - 8, 0)).astype(np.uint8)
    else:
        grey = (255.0 * np.clip(frame.image_linear[..., 1], 0.0, 1.0) ** (1.0 / 2.2) + 0.5).astype(np.uint8)
    return np.ascontiguousarray(grey)


class _Motion:
    """Follows corners since the last key frame, in small pictures."""

    def __init__(self, small: Grey) -> None:
        self._last = small
        found = cv2.goodFeaturesToTrack(small, _CORNERS, 0.01, 8)
        self.start = np.zeros((0, 1, 2), np.float32) if found is None else found
        self._now, self._alive = self.start, np.ones(len(self.start), bool)

    def is_key(self, small: Grey) -> bool:
        """Follow the corners into the next picture; return whether they moved far enough or are lost."""
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


def read_key_frames(video: VideoReader, folder: Path, steps: Steps) -> Reading:
    """Choose key frames of a clip and write them as PNG into a folder, unless a run before did; find its cuts.

    Raises `ParameterError` for stills, clips that are too short, pictures of one
    colour and such without texture.
    """
    if video.is_still:
        raise ParameterError(f"{video.path} - is one picture, whose camera has no path - give a video")
    count = video.frame_count or 0
    if count < _LEAST_FRAMES:
        raise ParameterError(f"{video.path} - is too short (got {count} frames) - give at least {_LEAST_FRAMES}")
    stored = folder / "keys.json"
    if stored.is_file():
        return Reading(**read_json(stored, ParameterError))
    reading = _read(video, count, folder, steps)
    write_whole(stored, json.dumps(asdict(reading)))
    return reading


def _read(video: VideoReader, count: int, folder: Path, steps: Steps) -> Reading:
    # Keep a first picture, some spread evenly, and those that the motion asks for
    every = set(np.linspace(0, count - 1, min(count, _LEAST_KEYS)).astype(int).tolist())
    keys, times, thumbnails, motion = [], [], [], None
    contrast, corners = 0.0, 0
    for frame in video.frames():
        grey = grey_picture(frame)
        small = _small(grey)
        times.append(float(frame.time_s))
        thumbnails.append(thumbnail(small))
        if motion is None or frame.index in every or motion.is_key(small):
            motion = _Motion(small)
            contrast, corners = max(contrast, float(small.std())), max(corners, len(motion.start))
            keys.append(int(frame.index))
            cv2.imwrite(str(_key_path(folder, frame.index)), grey)
        steps.done()
    # Refuse clips without anything to follow
    if contrast < _LEAST_CONTRAST:
        raise ParameterError(f"{video.path} - is of one colour - give a clip that shows the floor, a wall or a reef")
    if corners < _LEAST_CORNERS:
        raise ParameterError(
            f"{video.path} - has no texture to follow (got {corners} corners) - give a clip that shows the floor"
        )
    height, width = grey.shape
    return Reading(keys, times, list(find_picture_cuts(np.array(thumbnails))), width, height)


def _small(grey: Grey) -> Grey:
    scale = min(1.0, _FLOW_WIDTH / grey.shape[1])
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _key_path(folder: Path, index: int) -> Path:
    """Return the file of a key frame."""
    return folder / f"{index:08d}.png"


def key_frames_of_shot(reading: Reading, folder: Path, start: int, stop: int, where: str) -> KeyFrames:
    """Return the key frames of the frames start <= index < stop; raise `ParameterError`, as of `where`, if too few."""
    if stop - start < _LEAST_FRAMES:
        raise ParameterError(f"{where} - is too short (got {stop - start} frames) - give at least {_LEAST_FRAMES}")

    index = np.array([k for k in reading.keys if start <= k < stop], np.int64)
    if len(index) < 2:
        raise ParameterError(f"{where} - is too short (got {len(index)} key frames) - give it as a clip of its own")
    paths = tuple(_key_path(folder, k) for k in index.tolist())
    fixed = fixed_pixels(_small(np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)) for path in paths)
    size = (reading.width, reading.height)
    if fixed.size:
        fixed = cv2.resize(fixed.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    times = np.array(reading.times_s[start:stop])
    return KeyFrames(start, index - start, paths, times, reading.width, reading.height, fixed)
