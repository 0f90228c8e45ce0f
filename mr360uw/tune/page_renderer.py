# SPDX-License-Identifier: Apache-2.0
"""Pictures of the tuning page: what is asked for, what was made, and the live preview that makes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.errors import Mr360uwError
from mr360uw.preview.live import COARSE_WIDTH, LivePreview
from mr360uw.preview.thumbnail import encoded
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.scene.model import Scene
from mr360uw.tune.shown_frame import ShownFrame
from mr360uw.tune.situation import Situation, situation
from mr360uw.tune.views import CHARTS, VIEWS
from mr360uw.video.write.image_writer import picture_codes


@dataclass(frozen=True, slots=True)
class Wanted:
    """A picture to be made.

    revision: of the document whose scene it is. index: of the frame. view: a key of `views.VIEWS`. dark: its charts.
    width: [pixels] of the full picture. full: whether to make that once nothing else is asked for.
    """

    scene: Scene
    revision: int
    index: int
    view: str
    width: int
    full: bool = True
    dark: bool = True

    @property
    def draft_width(self) -> int:
        """Width [pixels] of a draft."""
        return min(self.width // 2, COARSE_WIDTH)


@dataclass(frozen=True, slots=True)
class MadePicture:
    """A picture that was made, as JPEG, with its size [pixels]; or, where none could be made, the problems.

    panorama: whether it is equirectangular. measured: whether its light is that of a clip that was measured. number: by
    which browsers fetch it. seconds: it took. stand_in: whether it is a draft of the nearest keyframe.
    """

    wanted: Wanted
    width: int = 0
    height: int = 0
    data: bytes = b""
    panorama: bool = True
    measured: bool = False
    number: int = 0
    draft: bool = False
    stand_in: bool = False
    seconds: float = 0.0
    problems: tuple[str, ...] = ()


_SHORT = 300
"""Frames of clips that are decoded whole for thumbnails where they have few keyframes; longer ones have more."""
_THUMBNAIL_WIDTH = 160


class PageRenderer:
    """A live preview and its pictures, for the thread that made it. backend: "auto", "gl" or "reference"."""

    def __init__(self, backend: str = "auto") -> None:
        self.preview = LivePreview(backend)

    def picture(self, wanted: Wanted, width: int) -> MadePicture:
        """Return a picture of about a width, without its number and kind; raises what `LivePreview.frame` raises."""
        preview = self.preview
        scene = preview.coarse(wanted.scene) if width <= COARSE_WIDTH and width < wanted.width else wanted.scene
        frame = preview.frame(scene, wanted.index, width)
        loaded = preview.loaded(scene, width).at(frame.plate.time_s)
        shown = ShownFrame(frame, loaded, preview.backend, preview.clip(wanted.scene).duration_s or 0.0, wanted.dark)
        codes = VIEWS[wanted.view](shown)
        size, measured = (codes.shape[1], codes.shape[0]), preview.has_measured(scene, width)
        return MadePicture(wanted, *size, encoded(codes, ".jpg"), wanted.view not in CHARTS, measured)

    def stand_in(self, wanted: Wanted) -> int:
        """Return the frame to show while the one that is wanted is decoded, or that one."""
        try:
            return self.preview.soonest(wanted.scene, wanted.index, wanted.draft_width)
        except (Mr360uwError, OSError):  # the picture says it
            return wanted.index

    def take_analysis(self, scene: Scene, analysis: ClipAnalysis) -> None:
        """Take what was measured of a scene's clip."""
        self.preview.take_analysis(scene, analysis)

    def plate(self, scene: Scene, index: int, width: int) -> bytes:
        """Return a frame of a scene's plate as JPEG; raise `VideoError`."""
        return encoded(picture_codes(self.preview.plate(scene, index, width), deep=False), ".jpg")

    def thumbnails(self, scene: Scene, count: int) -> list[tuple[int, bytes]]:
        """Return (frame, JPEG) of up to `count` small frames of a scene's plate; raise `VideoError`."""
        made, clip = self.preview.thumbnails(scene, count), self.preview.clip(scene)
        if len(made) < count and (clip.frame_count or 1) <= _SHORT:
            frames = np.unique(np.linspace(0, (clip.frame_count or 1) - 1, count).astype(int)).tolist()
            made = [self.preview.plate(scene, frame, _THUMBNAIL_WIDTH) for frame in frames]
        return [(frame.index, encoded(picture_codes(frame, deep=False), ".jpg")) for frame in made]

    def situation(self, scene: Scene, index: int, time_s: float) -> Situation:
        """Return camera, receiver and objects of a frame; raises what loading the scene raises."""
        return situation(self.preview, scene, index, time_s)

    def close(self) -> None:
        """Let go of everything."""
        self.preview.close()
