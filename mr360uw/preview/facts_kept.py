# SPDX-License-Identifier: Apache-2.0
"""Facts of a clip, measured once and used while the settings that they depend on stay as they were."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mr360uw.cache import Cache, Same
from mr360uw.preview.drafts import coarse
from mr360uw.progress import Progress
from mr360uw.reading.kept_reads import stamp
from mr360uw.render.calm import CalmPlate
from mr360uw.render.first_pass import ClipAnalysis, clip_facts
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_pattern import waves_of
from mr360uw.video import VideoReader


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Facts, and what they depend on, of the scene and of its draft. of_ground: what the calm ground depends on
    besides.
    """

    of_clip: tuple[Hashable, Hashable]
    of_ground: tuple[Hashable, Hashable]
    facts: ClipAnalysis


class KeptFacts:
    """The facts of the clip that was measured last. kept: holds its calm ground at the size of frames."""

    def __init__(self, kept: Cache) -> None:
        self._kept = kept
        self._last: _Measured | None = None

    def measure(
        self, loaded: Loaded, plate: VideoReader, video: VideoReader, progress: Progress | None
    ) -> ClipAnalysis:
        """Return the facts of a scene's clip, and keep them. plate: at full size. video: at the scene's own."""
        facts = clip_facts(loaded, video, progress)
        self.take(loaded, plate, facts)
        return facts

    def take(self, loaded: Loaded, plate: VideoReader, facts: ClipAnalysis) -> None:
        """Keep facts that were measured of a scene's clip. plate: at full size."""
        draft = replace(loaded, scene=coarse(loaded.scene))
        of_clip = _of_clip(plate, loaded), _of_clip(plate, draft)
        self._last = _Measured(of_clip, (_of_ground(loaded), _of_ground(draft)), facts)

    def holds(self, loaded: Loaded, plate: VideoReader) -> bool:
        """Return whether there are facts of a scene's clip."""
        return self._last is not None and _of_clip(plate, loaded) in self._last.of_clip

    def of(self, loaded: Loaded, plate: VideoReader) -> ClipAnalysis:
        """Return the facts for frames of a scene; those that are not known for its settings are left out."""
        last = self._last
        if last is None or not self.holds(loaded, plate):
            return ClipAnalysis()
        calm = last.facts.calm
        if calm is None or _of_ground(loaded) not in last.of_ground:
            return replace(last.facts, calm=None)
        return replace(last.facts, calm=self._kept.of(_reduced, calm, loaded.width, loaded.height))


def _of_clip(plate: VideoReader, loaded: Loaded) -> Hashable:
    scene, plan = loaded.scene, loaded.plan
    files = tuple((path, stamp(path)) for path in loaded.other_files)
    look = plan.match.runs and (scene.match.measures, scene.match.reading)
    wanted = plan.track_sun.runs, plan.track_gain.runs, look
    return Same(plate), scene.camera, scene.water, scene.light, scene.keys, files, wanted


def _of_ground(loaded: Loaded) -> Hashable:
    return loaded.plan.pattern.runs, loaded.scene.receiver, waves_of(loaded.scene)


def _reduced(calm: CalmPlate, width: int, height: int) -> CalmPlate:
    import cv2

    if calm.mean is None or calm.mean.shape[:2] == (height, width):
        return calm
    small: Any = cv2.resize(calm.mean.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return replace(calm, mean=small.astype(np.float16))
