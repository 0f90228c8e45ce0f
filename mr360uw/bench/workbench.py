# SPDX-License-Identifier: Apache-2.0
"""A sample dive in a temporary folder, in which a whale swims, and a renderer: what stages are measured on."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mr360uw.cache import Cache
from mr360uw.composite.over import over
from mr360uw.render.backends import Backend
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import Frame, composite_frame
from mr360uw.render.loaded import load
from mr360uw.sample import sample_dive
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, load_scene
from mr360uw.types import Floats
from mr360uw.video import VideoFrame

_RUNS, _QUICK_RUNS = 5, 3
_WIDTH, _QUICK_WIDTH = 1024, 512
"""Width [pixels] of the dive's frames: shadows and edges cost and err as in larger ones, in a fraction of the time."""
_SWIMS = "object.0.key=[{time_s=0, position_m=[0.4, -0.6, -3.6]}, {time_s=1, position_m=[1.4, -0.4, -3.2]}]"
"""Motion of the whale: nothing of a frame can be kept for the next because it stands still."""


class Workbench:
    """What stages are measured on. folder: an empty one, for the dive. quick: smaller frames, fewer runs.

    runs: timed runs of each setting. width: of the dive's frames [pixels].
    """

    def __init__(self, folder: Path, backend: Backend, *, quick: bool = False) -> None:
        self.backend, self.quick, self.runs = backend, quick, _QUICK_RUNS if quick else _RUNS
        self.width = _QUICK_WIDTH if quick else _WIDTH
        self._folder = folder

    @functools.cached_property
    def scene_file(self) -> Path:
        """The scene of the dive, made when it is first asked for: a plate of a frame for each run, a whale, sand."""
        return sample_dive(self._folder / "dive", width=self.width, frames=self.runs + 1).scene

    def scene(self, knobs: Mapping[str, Any]) -> Scene:
        """Return the scene of the dive with settings."""
        given = [f"{name}={value}" for name, value in knobs.items() if value is not None]
        return load_scene(self.scene_file, [_SWIMS, *given])

    @functools.cached_property
    def plates(self) -> list[VideoFrame]:
        """The frames of the dive's plate."""
        with open_plate(self.scene({})) as video:
            return list(video.frames(0, self.runs + 1))

    def frames(self, knobs: Mapping[str, Any]) -> Callable[[int], Frame]:
        """Return a function that composites frame k of the dive with settings, decoding not included.

        What frames share is kept from one to the next, as in a composite of the clip.
        """
        scene = self.scene(knobs)
        with open_plate(scene) as video:
            loaded = load(scene, video.width, video.height)
            analysis = clip_analysis(loaded, video)
            plates = list(video.frames(0, self.runs + 1))
        cache = Cache()
        return lambda k: composite_frame(loaded, analysis, self.backend, plates[k], 0.0, cache=cache)


def picture_of(frame: Frame) -> Floats:
    """Return a frame's picture (H, W, 3) before it is rounded to codes: linear radiance."""
    return over(frame.plate.image_linear, frame.layer)
