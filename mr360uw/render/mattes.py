# SPDX-License-Identifier: Apache-2.0
"""Grey pictures in step with the plate: mattes in front of the objects, and distance maps of the receiver."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.input_files import Stamp, stamp
from mr360uw.composite.receiver.shape import load_receiver, map_range, without_steps
from mr360uw.composite.settings import HoldoutSettings, ReceiverSettings
from mr360uw.composite.shot import Receiver
from mr360uw.errors import VideoError
from mr360uw.types import Floats
from mr360uw.video import VideoFrame, VideoReader, open_video
from mr360uw.video.layout import Eye

_LOSSY_STEPS = 2.0
"""Uncertainty of a value of a lossy video, in codes; that of a lossless picture is one code."""
_APART = 4
"""Frames that the thread that measures a plate's light may be ahead of the one that draws, and their pictures kept."""
_FINEST = 1.0 / 4096.0
"""Step, as a fraction of the range, above which a distance map is smoothed: 12 bits and coarser."""


@dataclass(frozen=True, slots=True, eq=False)
class Grey:
    """One picture. values: (h, w) float32, as fractions of white. step: their rounding step; 0 of floating point files,
    whose values are as stored.
    """

    values: Floats
    step: float


class GreyClip:
    """A still, sequence or video with one grey picture for each frame of the plate; a still serves all frames.

    depth: take the channel Z of EXR pictures if there is one; else alpha counts where it is not opaque. both: pictures
    hold both eyes of a stereo plate, whose frames have width x height each: the left one above the right, or at its
    left. Raises `VideoError`.
    """

    def __init__(self, path: Path, width: int, height: int, *, depth: bool = False, both: bool = False) -> None:
        self._reader: VideoReader = open_video(
            path, transfer="linear", equirectangular=False, depth=depth, matte=not depth
        )
        self._frames: Iterator[VideoFrame] | None = None
        self._last = -1
        self._kept, self._one_thread = Cache(), threading.Lock()
        shape = (self._reader.width, self._reader.height)
        self._axis = next((axis for axis in (0, 1) if both and _is_like(shape, width, height, axis)), None)
        if self._axis is None and (both or shape[0] * height != shape[1] * width):
            eyes = "both eyes of " if both else ""
            raise VideoError(
                f"{path} - has not the plate's shape (got {shape[0]}x{shape[1]} for {eyes}{width}x{height}) - render "
                "it from the same frames"
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines on what the files hold that is not used."""
        return self._reader.notes

    def check(self, stop: int) -> None:
        """Raise `VideoError` if the clip ends before the plate's frame `stop`."""
        count = self._reader.frame_count
        if not self._reader.is_still and count is not None and stop > count:
            raise VideoError(
                f"{self._reader.path} - ends before the plate (got {count} frames for frame {stop - 1} of the plate) - "
                f"add the missing ones, or take frames 0:{count}"
            )

    def at(self, index: int, eye: int = 0) -> Grey:
        """Return the picture of a frame, the same object while it is unchanged; ascending frames are decoded once.

        eye: 1 for the right one of two. For any thread: one may be some frames ahead of the other.
        """
        if self._reader.is_still:
            index = 0
        with self._one_thread:
            return self._kept.of(self._decoded, index, stamp(self._reader.file_of(index)), keep=_APART)[eye]

    def _decoded(self, index: int, _: Stamp) -> tuple[Grey, ...]:
        """Return the pictures of a frame, one an eye, as its file is by its stamp."""
        self.check(index + 1)
        if self._frames is None or index != self._last + 1:
            self._frames = iter(self._reader.frames(index))
        frame, self._last = next(self._frames), index
        step = 0.0
        if frame.spec.bits != 32:
            step = (1.0 if frame.yuv is None else _LOSSY_STEPS) / ((1 << frame.spec.bits) - 1)
        whole = frame.image_linear.mean(axis=-1)
        parts = [whole] if self._axis is None else np.split(whole, 2, axis=self._axis)
        return tuple(Grey(part, step) for part in parts)


def _is_like(shape: tuple[int, int], width: int, height: int, axis: int) -> bool:
    """Return whether a picture (width, height) is two of the shape width x height, above each other for axis 0."""
    wide, high = (2 * width, height) if axis else (width, 2 * height)
    return shape[1 - axis] % 2 == 0 and shape[0] * high == shape[1] * wide


def distances(grey: Grey, range_m: tuple[float, float]) -> Floats:
    """Return the distances (h, w) [m] of a map, infinite where it holds no surface (0, infinity, NaN).

    range_m: distances of black and white; a floating point picture holds metres. Values within half a step of 0 count
    as 0.
    """
    metres = map_range(grey.values, range_m) if grey.step else grey.values
    nothing = 0.5 * grey.step * abs(range_m[1] - range_m[0])
    return np.where(np.isfinite(metres) & (metres > nothing), metres, np.inf)


class Mattes:
    """All holdouts of a scene, in step with the plate."""

    def __init__(self, holdouts: Sequence[HoldoutSettings], width: int, height: int, eye: Eye | None = None) -> None:
        self._size, self._kept = (width, height), Cache()
        self._clips = [
            (one, GreyClip(one.path, width, height, depth=one.kind == "distance", both=eye == "both"))
            for one in holdouts
        ]

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines on what mattes hold that is not used, and on masks that hide nothing or nearly all in frame 0."""
        found: dict[str, None] = {}
        for settings, clip in self._clips:
            found |= dict.fromkeys(clip.notes)
            if settings.kind == "mask":
                found |= dict.fromkeys(_doubts(settings, clip.at(0)))
        return tuple(found)

    def check(self, stop: int) -> None:
        """Raise `VideoError` where a matte ends before the plate's frame `stop`."""
        for _, clip in self._clips:
            clip.check(stop)

    def at(self, index: int, eye: int = 0) -> tuple[Floats | None, Floats | None]:
        """Return the mask (H, W) in [0, 1] and the distances (H, W) [m] of a frame, each None where there is none.

        eye: 1 for the right one of two. Several masks combine to their maximum, several distances to their minimum: the
        same arrays while the pictures are unchanged.
        """
        if not self._clips:
            return None, None
        found: dict[str, list[Floats]] = {"mask": [], "distance": []}
        for settings, clip in self._clips:
            matte = self._kept.of(_matte_of, settings, self._size, clip.at(index, eye), keep=2 * len(self._clips))
            found[settings.kind].append(matte)
        mask, metres = (self._kept.of(_combined, kind, tuple(mattes), keep=4) for kind, mattes in found.items())
        return mask, metres


_LEAST_HIDDEN, _MOST_HIDDEN = 1.0 / 255.0, 0.9
"""Largest weight of a mask that hides nothing, and mean weight of one that hides nearly all: one that is inverted."""


def _doubts(settings: HoldoutSettings, grey: Grey) -> Iterator[str]:
    """Yield a line where a mask hides nothing, or nearly all that is drawn."""
    weight = 1.0 - grey.values if settings.invert else grey.values
    turn = "remove invert" if settings.invert else "set invert = true for the holdout"
    if float(weight.max()) < _LEAST_HIDDEN:
        yield f"{settings.path} - hides nothing in frame 0 (it is black all over) - {turn} if it is inverted"
    elif float(weight.mean()) > _MOST_HIDDEN:
        share = f"{100.0 * float(weight.mean()):.0f} %"
        yield f"{settings.path} - hides {share} of frame 0, and what is drawn there - {turn} if it is inverted"


def _combined(kind: str, mattes: Sequence[Floats]) -> Floats | None:
    """Return the largest weight of several masks, or the smallest of several distances; None for none."""
    return (np.max if kind == "mask" else np.min)(mattes, axis=0) if mattes else None


def _matte_of(settings: HoldoutSettings, size: tuple[int, int], grey: Grey) -> Floats:
    """Return the matte (H, W) of a holdout's picture, at a size (W, H): weights in [0, 1], or metres."""
    import cv2

    same = grey.values.shape == size[::-1]
    if settings.kind == "distance":
        metres = distances(grey, settings.range_m)
        return metres if same else cv2.resize(metres, size, interpolation=cv2.INTER_NEAREST_EXACT)
    weight = grey.values if same else cv2.resize(grey.values, size, interpolation=cv2.INTER_LINEAR)
    return 1.0 - weight if settings.invert else weight


class ReceiverClip:
    """A scene's receiver, frame by frame: the same object while its shape does not change.

    Caches of renderers use the identity of that object as their key.
    """

    def __init__(self, settings: ReceiverSettings, width: int, height: int, eye: Eye | None = None) -> None:
        self._settings, self._receiver = settings, load_receiver(settings)
        self._clip: GreyClip | None = None
        self._kept, self._one_thread = Cache(), threading.Lock()
        if settings.kind == "distance":
            assert settings.path is not None
            self._clip = GreyClip(settings.path, width, height, depth=True, both=eye == "both")

    def check(self, stop: int) -> None:
        """Raise `VideoError` where a distance map ends before the plate's frame `stop`."""
        if self._clip is not None:
            self._clip.check(stop)

    def at(self, index: int, eye: int = 0) -> Receiver:
        """Return the receiver of a frame, for any thread. eye: 1 for the right one of two."""
        if self._clip is None:
            return self._receiver
        grey = self._clip.at(index, eye)
        with self._one_thread:
            return self._kept.of(self._shaped, grey, keep=2 * _APART)

    def _shaped(self, grey: Grey) -> Receiver:
        low, high = self._settings.range_m
        metres = distances(grey, self._settings.range_m)
        if grey.step > _FINEST:
            metres = without_steps(metres, grey.step * abs(high - low))
        return replace(self._receiver, distance_m=metres)
