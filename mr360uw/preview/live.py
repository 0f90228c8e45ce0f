# SPDX-License-Identifier: Apache-2.0
"""Composited frames of a scene that changes: of every change only the stages that it touches are run again."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from typing import Self

from mr360uw.preview.frames_kept import KeptFrames
from mr360uw.reading.kept_reads import KeptReads
from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import ClipFacts
from mr360uw.render.frame import Frame, finished, frame_stages
from mr360uw.render.loaded import Loaded, Loader
from mr360uw.scene.model import Scene, at_scale
from mr360uw.threads import one_blas_thread
from mr360uw.video import VideoFrame

_KINDS = 2
"""Kinds of frames that take turns, whole ones and drafts: what each needs is kept."""


@dataclass(frozen=True, slots=True)
class PlateClip:
    """A scene's plate. width, height: [pixels], at full size. frame_count, duration_s: None for a still, which has as
    many frames as are asked for. frame_rate: [1/s].
    """

    frame_count: int | None
    frame_rate: Fraction
    width: int
    height: int
    duration_s: float | None


class LivePreview:
    """Renders single frames of scenes, one after the other; what a change of the scene leaves as it was is kept.

    A frame depends on its scene, its number and its width alone, never on the frames before it. Files that are changed
    meanwhile are read again. After an error the preview goes on working. It belongs to the thread that made it, as its
    renderer does. backend: "auto", "gl" or "reference"; raises what `make_backend` raises. note: the reason where auto
    fell back to the reference, else "".
    """

    def __init__(self, backend: str = "auto") -> None:
        self.backend, self.note = make_backend(backend, _KINDS)
        self._reads = KeptReads(_KINDS)
        self._plates = KeptFrames(self._reads)

    @property
    def made(self) -> Counter[str]:
        """How often each part was made: "plate" (decoded), "light" (measured in it), "medium" (solved), "water"
        (matched to the light), "caustics", "layer" (drawn), "picture" (layer over plate), and parts of loaded scenes.
        """
        return self._reads.cache.made

    def frame(self, scene: Scene, index: int, width: int | None = None) -> Frame:
        """Return a composited frame of a scene, `width` pixels wide; None takes the scene's own width.

        Sun and veil are measured in this frame alone: a composite of the clip takes them from all of it, so that its
        light may differ a little. There is no motion blur. Raises what `composite_video` raises.
        """
        with one_blas_thread():
            loaded = self.loaded(scene, width)
            loaded.check(index + 1)
            plate, facts = self.plate(scene, index, width), ClipFacts.of_frame("scene", None)
            return finished(frame_stages(loaded, facts, self.backend, plate, 0.0, kept=self._reads.cache))

    def loaded(self, scene: Scene, width: int | None = None) -> Loaded:
        """Return a scene resolved for frames of a width, as `frame` draws it; raises what loading raises."""
        columns, rows = self._plates.size(scene, width)
        scaled = at_scale(scene, columns / self._plates.reader(scene).width)
        return Loader(columns, rows, clip=False, kept=self._reads).load(scaled)

    def plate(self, scene: Scene, index: int, width: int | None = None) -> VideoFrame:
        """Return a frame of a scene's plate, `width` pixels wide; raise `VideoError`."""
        return self._plates.at(scene, index, self._plates.size(scene, width))

    def clip(self, scene: Scene) -> PlateClip:
        """Return the length and size of a scene's plate; raise `VideoError`."""
        reader = self._plates.reader(scene)
        count, rate = reader.frame_count, reader.frame_rate
        return PlateClip(count, rate, reader.width, reader.height, None if count is None else float(count / rate))

    def close(self) -> None:
        """Let go of everything that is kept, and of open files."""
        self._plates.close()
        self._reads.cache.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
