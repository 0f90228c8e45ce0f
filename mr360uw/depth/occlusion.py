# SPDX-License-Identifier: Apache-2.0
"""Distances of a plate's frame that bodies are compared with: sure ones alone, at the frame's size.

A map of another size is enlarged along the edges of the picture (`enlarging`), which makes these soft.
"""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.shot import Receiver
from mr360uw.depth.depth_files import DepthClip, Kind
from mr360uw.depth.enlarging import PlateSurfaces, enlarged
from mr360uw.depth.relief import ground_below, on_relief
from mr360uw.depth.sphere_stereo import SURE, DepthMap
from mr360uw.depth.warping import Map
from mr360uw.reading.cached_reads import CachedReads
from mr360uw.sphere import frame_from_direction
from mr360uw.track.key_frames import grey_picture
from mr360uw.types import Floats, View
from mr360uw.video import VideoFrame

_NEAR = np.arange(-1, 2)
"""Pixels about a direction whose distances are its own."""
_KEPT = 4
"""Frames whose distances are kept: two, of both eyes."""


def sure_surfaces(found: DepthMap, picture: Map) -> PlateSurfaces:
    """Return the surfaces of a map at the size of a grey picture (H, W), infinitely far where a map is not sure."""
    sure = np.where(found.confidence >= SURE, found.distance_m, np.float32(np.inf)).astype(np.float32)
    return PlateSurfaces(sure) if sure.shape == picture.shape else enlarged(sure, picture)


class PlateDepth:
    """The distances of a plate, in step with its frames, see `DepthClip`.

    right: whether its frames are those of the right eye. notes: what there is to know about the maps.
    """

    def __init__(
        self, path: Path, kind: Kind = "metric", scale_m: float = 1.0, right: bool = False,
        size: tuple[int, int] = (2, 1),
    ) -> None:  # fmt: skip
        self._clip, self._right, self._kept = DepthClip(path, kind, scale_m, size), right, Cache()
        self.notes = self._clip.notes
        self._ground, self._one_thread = CachedReads(), threading.RLock()

    @property
    def of_both_eyes(self) -> bool:
        """Whether there is a map for each eye."""
        return self._clip.of_both_eyes

    def check(self, stop: int) -> None:
        """Raise `VideoError` if a map is missing or does not fit up to the plate's frame `stop`."""
        self._clip.check(stop)

    def check_all(self, stop: int, count: int | None) -> None:
        """Raise `VideoError` with all that `DepthClip.check_all` finds. count: frames of the plate."""
        with self._one_thread:
            self._clip.check_all(stop, count)

    def at(self, index: int, plate: VideoFrame, eye: int = 0) -> Map:
        """Return the sure distances (H, W) [m] of a frame: the same array for the same picture and map.

        eye: 1 for the right one of two, else 0.
        """
        return self.surfaces(index, plate, eye).distance_m

    def surfaces(self, index: int, plate: VideoFrame, eye: int = 0) -> PlateSurfaces:
        """Return what `at` does, with the surfaces beside these in pixels along edges."""
        with self._one_thread:
            return self._kept.of(_of_frame, self.map_at(index, eye), plate, keep=_KEPT)

    def receiver_at(self, index: int, receiver: Receiver, view: View, eye: int = 0) -> Receiver:
        """Return a receiver as it is in a frame, with the relief of the plate: the same object while nothing changes.

        view: that of the frame. eye: 1 for the right one of two, else 0. For any thread.
        """
        with self._one_thread:
            return self._kept.of(on_relief, receiver, self.map_at(index, eye), view, keep=_KEPT)

    def ground_below(self, index: int, view: View) -> float | None:
        """Return how far [m] the ground is below the camera in a frame, None where the map does not tell (`relief`)."""
        with self._one_thread:
            return self._ground.of(_ground_below, self, index, np.array(view.world_from_camera[1]))

    def toward(self, index: int, direction: Floats) -> float:
        """Return the distance [m] of what a frame shows in a direction (3,) in the camera's axes.

        It is the median of the sure pixels of the map about it; infinite where there are none.
        """
        found = self.map_at(index)
        height, width = found.distance_m.shape
        x, y = frame_from_direction(direction, width, height)
        rows = np.clip(int(y) + _NEAR, 0, height - 1)[:, None]
        columns = (int(x) + _NEAR) % width
        near = found.distance_m[rows, columns][found.confidence[rows, columns] >= SURE]
        return float(np.median(near)) if len(near) else float("inf")

    def map_at(self, index: int, eye: int = 0) -> DepthMap:
        """Return the map of a frame at its own size. eye: 1 for the right one of two, else 0."""
        with self._one_thread:
            return self._clip.at(index, right=self._right or eye == 1)


def _ground_below(depth: PlateDepth, index: int, up: Floats) -> float | None:
    return ground_below(depth.map_at(index), up)


def _of_frame(found: DepthMap, plate: VideoFrame) -> PlateSurfaces:
    """Return the sure surfaces of a frame."""
    import cv2

    height, width = plate.image_linear.shape[:2] if plate.yuv is None else plate.yuv.y.shape
    grey = grey_picture(plate).astype(np.float32)
    if grey.shape != (height, width):
        grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    return sure_surfaces(found, grey)
