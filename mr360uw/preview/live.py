# SPDX-License-Identifier: Apache-2.0
"""Composited frames of a scene that changes: of every change only the stages that it touches are run again.

The clip's analysis is measured once and used while the settings that it depends on stay as they were.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from dataclasses import replace
from typing import Any, Self

import numpy as np

from mr360uw.cache import Cache, Same
from mr360uw.preview.cached_frames import KeptFrames, PlateClip
from mr360uw.progress import Progress
from mr360uw.reading.cached_reads import CachedReads, stamp
from mr360uw.render.backends import close_backend, make_backend
from mr360uw.render.first_pass import ClipAnalysis, clip_analysis
from mr360uw.render.frame import Frame, composite_frame
from mr360uw.render.loaded import Loaded, Loader
from mr360uw.render.plate_pattern import Background, waves_of
from mr360uw.render.stages.match_stage import grade_in_frame, patch_frames
from mr360uw.scene.model import Scene, at_scale
from mr360uw.threads import one_blas_thread
from mr360uw.video import VideoFrame, VideoReader
from mr360uw.video.read.reader import scaled

COARSE_WIDTH = 512
"""Width [pixels] of drafts."""
_SAMPLES, _SUN_SAMPLES = 5, 8
_CAUSTIC_SIZE, _CAUSTIC_GRID, _PLANES = 128, 96, 2
_SHAFT_NODES, _SHAFT_SLICES = 128, 16
"""Settings of drafts, at most. A pixel of theirs is as wide as two of a frame: detail is lost anyhow."""
_BANDS = 21
"""Wavelengths of drafts, at most: veils of Jerlov's waters differ by up to 0.8 % from those of 61 wavelengths. With 16
it is 1.7 %; the time to solve and tabulate a water goes with their number."""


def coarse(scene: Scene) -> Scene:
    """Return a scene with the settings of a draft, for frames `COARSE_WIDTH` wide while a value is being moved.

    Edges, soft shadows, caustics and shafts are drawn with fewer samples, and the water is solved at fewer wavelengths
    and orders of light about the sun. Shafts of waves and bodies alone are left out: at their physical strength a draft
    would hardly show them.
    """
    draw, caustics, water = scene.draw, scene.caustics, scene.water
    fewer = {"samples": min(draw.samples, _SAMPLES), "sun_samples": min(draw.sun_samples, _SUN_SAMPLES)}
    coarser = {
        "size": min(caustics.size, _CAUSTIC_SIZE),
        "grid": min(caustics.grid or _CAUSTIC_GRID, _CAUSTIC_GRID),
        "planes": min(caustics.planes, _PLANES),
    }
    shafts: dict[str, int | str] = {
        "resolution": min(scene.shafts.resolution, _SHAFT_NODES),
        "slices": min(scene.shafts.slices, _SHAFT_SLICES),
    }
    if not (scene.lamps or scene.shafts.on_plate or scene.shafts.strength > 1.0):
        shafts = {"mode": "off"}
    drafts = {
        "shafts": scene.shafts.model_copy(update=shafts),
        "draw": draw.model_copy(update=fewer),
        "caustics": caustics.model_copy(update=coarser),
        "water": water.model_copy(update={"bands": min(water.bands, _BANDS), "rough": True}),
    }
    return scene.model_copy(update=drafts)


def _of_clip(plate: VideoReader, loaded: Loaded) -> Hashable:
    scene, plan = loaded.scene, loaded.plan
    files = tuple((path, stamp(path)) for path in loaded.other_files)
    look = plan.match.runs and (scene.match.measures, scene.match.reading)
    wanted = plan.track_sun.runs, plan.track_gain.runs, look
    return Same(plate), scene.camera, scene.water, scene.light, scene.keys, files, wanted


def _of_ground(loaded: Loaded) -> Hashable:
    return loaded.plan.pattern.runs, loaded.scene.receiver, waves_of(loaded.scene)


def _reduced(background: Background, width: int) -> Background:
    import cv2

    if background.mean is None or background.mean.shape[1] == width:
        return background
    height = round(len(background.mean) * width / background.mean.shape[1])
    small: Any = cv2.resize(background.mean.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return replace(background, mean=small.astype(np.float16))


_KINDS = 2
"""Kinds of frames that take turns, whole ones and drafts: what each needs is kept."""


class LivePreview:
    """Renders single frames of scenes, one after the other; what a change of the scene leaves as it was is kept.

    A frame depends on its scene, its number and its width alone, never on the frames before it. Files that are changed
    meanwhile are read again. After an error the preview goes on working. It belongs to the thread that made it, as its
    renderer does. backend: "auto", "gl" or "reference"; raises what `make_backend` raises. note: the reason where auto
    fell back to the reference, else "". plates: reads the plates' frames.
    """

    def __init__(self, backend: str = "auto") -> None:
        self.backend, self.note = make_backend(backend, Cache(_KINDS))
        self._reads = CachedReads(_KINDS)
        self.plates = KeptFrames(self._reads)
        self._last = ClipAnalysis()  # that was measured
        # what it depends on, of the scene and of its draft, and what its background depends on besides
        self._clip_keys: tuple[Hashable, ...] = ()
        self._ground_keys: tuple[Hashable, ...] = ()

    @property
    def made(self) -> Counter[str]:
        """How often each stage ran, by the name of its function (`mr360uw.cache.name_of`)."""
        return self._reads.cache.made

    def frame(self, scene: Scene, index: int, width: int | None = None) -> Frame:
        """Return a composited frame of a scene, `width` pixels wide; None takes the scene's own width.

        The sun, the veil's gain and the background are those that `measure` found; without it, they are measured in
        this frame alone: a composite of the clip takes them from all of it, so that its light may differ a little.
        Patches of known colour are read in the frames that show them.
        There is no motion blur. Raises what `composite_video` raises.
        """
        with one_blas_thread():
            loaded = self.loaded(scene, width)
            loaded.check(index + 1)
            plate, analysis = self.plate(scene, index, width), self._analysis_for(loaded, self.plates.reader(scene))
            if analysis.grade is None and loaded.plan.match.runs and loaded.scene.match.open_keys:
                places = patch_frames(scene.match, self.plates.reader(scene))
                shown = [self.plate(scene, place, width) for place in places]
                analysis = replace(analysis, grade=grade_in_frame(loaded, plate, shown, self._reads.cache))
            return composite_frame(loaded, analysis, self.backend, plate, 0.0, cache=self._reads.cache)

    coarse = staticmethod(coarse)

    def measure(self, scene: Scene, progress: Progress | None = None) -> ClipAnalysis:
        """Measure a scene's clip as a composite does before its first frame; frames use what was found from now on.

        The sun's and the gain's tracks over the clip are smoother than what single frames show, and the mean of a clip
        from a standing camera shows the ground without its caustics. They hold, for the scene and its draft, while the
        plate, `[camera]`, `[water]` and `[light]` stay as they are; the ground also depends on `[receiver]` and
        `[sea]`. Raises `VideoError`, `SceneError`.
        """
        video = scaled(self.plates.reader(scene), scene.plate.scale)
        analysis = clip_analysis(self.loaded(scene), video, progress)
        self.take_analysis(scene, analysis)
        return analysis

    def take_analysis(self, scene: Scene, analysis: ClipAnalysis) -> None:
        """Use an analysis of a scene's clip that another preview's `measure` returned."""
        plate, loaded = self.plates.reader(scene), self.loaded(scene)
        draft = replace(loaded, scene=coarse(loaded.scene))
        self._clip_keys = _of_clip(plate, loaded), _of_clip(plate, draft)
        self._ground_keys, self._last = (_of_ground(loaded), _of_ground(draft)), analysis

    def has_measured(self, scene: Scene, width: int | None = None) -> bool:
        """Return whether frames of a scene use an analysis of its clip that was measured."""
        return _of_clip(self.plates.reader(scene), self.loaded(scene, width)) in self._clip_keys

    def _analysis_for(self, loaded: Loaded, plate: VideoReader) -> ClipAnalysis:
        """Return the analysis for frames of a scene; what is not known for its settings is left out."""
        if _of_clip(plate, loaded) not in self._clip_keys:
            return ClipAnalysis()
        background = self._last.background
        if background is None or _of_ground(loaded) not in self._ground_keys:
            return replace(self._last, background=None)
        reduced = self._reads.cache.of(_reduced, background, loaded.width)
        return replace(self._last, background=reduced)

    def loaded(self, scene: Scene, width: int | None = None) -> Loaded:
        """Return a scene resolved for frames of a width, as `frame` draws it; raises what loading raises."""
        reader, size = self.plates.reader(scene), self.plates.size(scene, width)
        at_size = at_scale(scene, size[0] / reader.width)
        return Loader(*size, clip=not reader.is_still, reads=self._reads).load(at_size)

    def plate(self, scene: Scene, index: int, width: int | None = None) -> VideoFrame:
        """Return a frame of a scene's plate, `width` pixels wide; raise `VideoError`."""
        return self.plates.at(scene, index, width)

    def clip(self, scene: Scene) -> PlateClip:
        """Return the length and size of a scene's plate; raise `VideoError`."""
        return PlateClip.of(self.plates.reader(scene))

    def close(self) -> None:
        """Let go of everything that is kept, and of open files."""
        self.plates.close()
        self._reads.cache.clear()
        close_backend(self.backend)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
