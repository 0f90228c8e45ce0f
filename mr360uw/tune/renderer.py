# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures of the tuning page: a live preview, seen through one of the views."""

from __future__ import annotations

from mr360uw.preview.live import LivePreview, PlateClip
from mr360uw.preview.thumbnail import encoded
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene
from mr360uw.tune.pictures import Wanted
from mr360uw.video.write.image_writer import picture_codes


class PageRenderer:
    """A live preview and its pictures. backend: "auto", "gl" or "reference"."""

    def __init__(self, backend: str = "auto") -> None:
        self.preview = LivePreview(backend)

    def picture(self, wanted: Wanted, width: int) -> tuple[bytes, int, int]:
        """Return a picture of about a width as JPEG, with its width and height [pixels]."""
        frame = self.preview.frame(wanted.scene, wanted.index, width)
        codes = picture_codes(frame.picture, deep=False)
        return encoded(codes, ".jpg"), codes.shape[1], codes.shape[0]

    def close(self) -> None:
        """Let go of everything."""
        self.preview.close()


def clip_of(scene: Scene) -> PlateClip:
    """Return the length and size of a scene's plate; raise `VideoError`."""
    with open_plate(scene) as video:
        count, rate = video.frame_count, video.frame_rate
        return PlateClip(count, rate, video.width, video.height, None if count is None else float(count / rate))
