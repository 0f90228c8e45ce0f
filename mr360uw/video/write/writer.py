# SPDX-License-Identifier: Apache-2.0
"""The interface of outputs: a video, one picture, or a sequence of pictures.

Everything is written under a new temporary name and renamed when complete; when anything fails, or the program is
interrupted, the temporary file is removed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.types import Floats
from mr360uw.video.clip import Clip
from mr360uw.video.video_frame import VideoFrame


class VideoWriter(ABC):
    """An output; made by `create_video`, used in a `with` block: leaving it completes the output.

    path: the file or the pattern. notes: parts of the plate that it lacks, one line each. Use it from one thread.
    """

    path: Path
    notes: tuple[str, ...] = ()
    _clip: Clip
    _images = 0

    def write_image(self, image_linear: Floats) -> None:
        """Append a picture of linear Rec.709 light (H, W, 3) at the next position in time."""
        index, base = self._images, self._clip.time_base
        step = round(1 / (self._clip.frame_rate * base))
        pts = self._clip.start_pts + index * step
        linear = ColorSpec("bt709", True, "linear", 32)
        rgb = np.asarray(image_linear, np.float32)
        self.write(VideoFrame(index, pts, base, float(index * step * base), step, linear, rgb=rgb))
        self._images += 1

    @abstractmethod
    def write(self, frame: VideoFrame) -> None:
        """Append a frame. Frames come in order of presentation. VideoError where it cannot be written."""

    @abstractmethod
    def finish(self) -> None:
        """Complete the output and let it appear under its name."""

    @abstractmethod
    def abort(self) -> None:
        """Remove everything that is not complete."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self.abort()
