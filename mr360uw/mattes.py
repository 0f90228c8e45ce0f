# SPDX-License-Identifier: Apache-2.0
"""The mattes of a scene's holdouts, frame by frame: what is really there and in front of the objects."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mr360uw.composite.holdout import feathered
from mr360uw.composite.objects import map_range
from mr360uw.composite.settings import HoldoutSettings
from mr360uw.errors import VideoError
from mr360uw.scene import Scene
from mr360uw.types import Floats
from mr360uw.video import VideoFrame, VideoReader, open_video


class Mattes:
    """Reads every holdout in step with the plate; a still serves all frames."""

    def __init__(self, scene: Scene, width: int, height: int) -> None:
        self._holdouts = [_Holdout(settings, width, height) for settings in scene.holdouts]

    def at(self, index: int) -> tuple[Floats | None, Floats | None]:
        """Return the mask (H, W) in [0, 1] and the distances (H, W) [m] of a frame, each None where there is none.

        Several masks add up to the strongest, several distances to the nearest.
        """
        masks = [h.at(index) for h in self._holdouts if h.settings.kind == "mask"]
        distances = [h.at(index) for h in self._holdouts if h.settings.kind == "distance"]
        return (
            np.max(masks, axis=0) if masks else None,
            np.min(distances, axis=0) if distances else None,
        )


class _Holdout:
    """One holdout; frames asked for in ascending order are decoded once."""

    def __init__(self, settings: HoldoutSettings, width: int, height: int) -> None:
        self.settings = settings
        self._size = (width, height)
        self._reader: VideoReader = open_video(settings.path, transfer="linear", equirectangular=False)
        self._frames: Iterator[VideoFrame] | None = None
        self._index = -1
        self._matte: Floats = np.zeros((0, 0))
        shape = (self._reader.width, self._reader.height)
        if shape[0] * height != shape[1] * width:
            raise VideoError(
                f"{settings.path} - a matte has the plate's shape (got {shape[0]}x{shape[1]} for {width}x{height}) - "
                "render it from the same frames"
            )

    def at(self, index: int) -> Floats:
        """Return the matte (H, W) of a frame: weights in [0, 1], or metres."""
        if self._reader.is_still:
            index = 0
        if index != self._index:
            if self._frames is None or index != self._index + 1:
                self._frames = iter(self._reader.frames(index))
            self._matte, self._index = self._read(next(self._frames)), index
        return self._matte

    def _read(self, frame: VideoFrame) -> Floats:
        import cv2

        grey = frame.image_linear.mean(axis=-1)
        if grey.shape != self._size[::-1]:
            grey = cv2.resize(grey, self._size, interpolation=cv2.INTER_LINEAR)
        if self.settings.kind == "distance":
            return map_range(grey, self.settings.range_m)
        return feathered(1.0 - grey if self.settings.invert else grey, self.settings.feather_px)
