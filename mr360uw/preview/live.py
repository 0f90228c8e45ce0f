# SPDX-License-Identifier: Apache-2.0
"""Composited frames of a scene that changes, one at a time.

The clip's analysis is measured once and used while the settings that it depends on stay as they were.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Self

import numpy as np

from mr360uw.base.cache import Cache, Same
from mr360uw.base.input_files import Stamp, stamp
from mr360uw.base.parameters import Parameters
from mr360uw.base.progress import Progress, one_blas_thread
from mr360uw.render.first_pass import Background, ClipAnalysis, clip_analysis, waves_of
from mr360uw.render.frame import Frame, close_backend, composite_frame, make_backend
from mr360uw.render.loaded import Loaded, Loader
from mr360uw.render.match_stage import grade_in_frame, patch_frames
from mr360uw.render.plate_light import FrameLight, held_light
from mr360uw.scene.model import Scene, at_scale
from mr360uw.scene.resolved import open_plate
from mr360uw.video import VideoFrame, VideoReader
from mr360uw.video.reader import Seeker, scaled, scaled_size, smaller

COARSE_WIDTH = 512
"""Width [pixels] of drafts."""
_DRAFT: dict[str, dict[str, int]] = {
    "draw": {"samples": 5, "sun_samples": 8},
    "caustics": {"size": 128, "grid": 96, "planes": 2},
    "shafts": {"resolution": 128, "slices": 16},
    "water": {"bands": 21},
}
"""Settings of drafts, at most, by their tables. A pixel of theirs is as wide as two of a frame: detail is lost anyhow.
With 21 wavelengths, veils of Jerlov's waters differ by up to 0.8 % from those of 61. With 16 it is 1.7 %; the time to
solve and tabulate a water goes with their number."""


def coarse(scene: Scene) -> Scene:
    """Return a scene with the settings of a draft, for frames `COARSE_WIDTH` wide while a value is being moved.

    Edges, soft shadows, caustics and shafts are drawn with fewer samples, and the water is solved at fewer wavelengths
    and orders of light about the sun. Shafts of waves and bodies alone are left out: at their physical strength a draft
    would hardly show them.
    """
    drafts = {name: _at_most(getattr(scene, name), most) for name, most in _DRAFT.items()}
    drafts["water"] = drafts["water"].model_copy(update={"rough": True})
    if not (scene.lamps or scene.shafts.on_plate or scene.shafts.strength > 1.0):
        drafts["shafts"] = scene.shafts.model_copy(update={"mode": "off"})
    return scene.model_copy(update=drafts)


def _at_most(table: Parameters, most: dict[str, int]) -> Parameters:
    """Return a table of settings of which some are no larger than given."""
    return table.model_copy(update={name: min(getattr(table, name) or top, top) for name, top in most.items()})


def _of_clip(plate: VideoReader, loaded: Loaded) -> Hashable:
    scene, plan = loaded.scene, loaded.plan
    files = tuple((path, stamp(path)) for path in loaded.other_files)
    look = plan.match.runs and (scene.match.measures, scene.match.reading)
    wanted = plan.track_sun.runs, plan.track_gain.runs, look
    return Same(plate), scene.camera, scene.water, scene.light, scene.keys, files, wanted


def _of_light(plate: VideoReader, scene: Scene, index: int) -> Hashable:
    """Return what the light of a plate's frame depends on but water, depth and floor; none of it on its size."""
    camera = scene.camera.model_copy(update={"depth_m": 0.0})
    return Same(plate), index, camera, scene.light, scene.match, scene.keys, scene.water.type == "none"


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

    A frame depends on its scene, its number and its width alone, never on the frames before it, unless it holds their
    light. Files that are changed meanwhile are read again. After an error the preview goes on working. It belongs to
    the thread that made it, as its renderer does. backend: "auto", "gl" or "reference"; raises what `make_backend`
    raises. note: the reason where auto fell back to the reference, else "". plates: reads the plates' frames.
    """

    def __init__(self, backend: str = "auto") -> None:
        self.backend, self.note = make_backend(backend, Cache(_KINDS))
        self._cache = Cache(_KINDS)
        self.plates = KeptFrames(self._cache)
        self._last = ClipAnalysis()  # that was measured
        # what it depends on, of the scene and of its draft, and what its background depends on besides
        self._clip_keys: tuple[Hashable, ...] = ()
        self._ground_keys: tuple[Hashable, ...] = ()
        self._held: tuple[Hashable, FrameLight] | None = None  # the plate's light that was found last, and of what

    @property
    def made(self) -> Counter[str]:
        """Runs of each stage, by the name of its function (`mr360uw.base.cache.name_of`)."""
        return self._cache.made

    def frame(self, scene: Scene, index: int, width: int | None = None, *, holds_light: bool = False) -> Frame:
        """Return a composited frame of a scene, `width` pixels wide; None takes the scene's own width.

        holds_light: take the plate's light from the last picture of this frame, if all but the water, the depth, the
        floor and what is in the water is as it was; only the gain of the veil is fitted again. For drafts.

        The sun, the veil's gain and the background are those that `measure` found; without it, they are measured in
        this frame alone: a composite of the clip takes them from all of it, so that its light may differ a little.
        Patches of known colour are read in the frames that show them.
        There is no motion blur. Raises what `composite_video` raises.
        """
        with one_blas_thread():
            loaded = self.loaded(scene, width)
            loaded.check(index + 1)
            plate, analysis = self.plates.at(scene, index, width), self._analysis_for(loaded, self.plates.reader(scene))
            if analysis.grade is None and loaded.plan.match.runs and loaded.scene.match.open_keys:
                places = patch_frames(scene.match, self.plates.reader(scene))
                shown = [self.plates.at(scene, place, width) for place in places]
                analysis = replace(analysis, grade=grade_in_frame(loaded, plate, shown, self._cache))
            of_light, light = _of_light(self.plates.reader(scene), loaded.scene, index), None
            if holds_light and self._held is not None and self._held[0] == of_light:
                light = held_light(self._held[1], loaded.at(plate.time_s).surroundings, analysis, plate)
            frame = composite_frame(loaded, analysis, self.backend, plate, 0.0, cache=self._cache, light=light)
            if light is None:
                self._held = None if frame.light is None else (of_light, frame.light)
            return frame

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
        reduced = self._cache.of(_reduced, background, loaded.width)
        return replace(self._last, background=reduced)

    def loaded(self, scene: Scene, width: int | None = None) -> Loaded:
        """Return a scene resolved for frames of a width, as `frame` draws it; raises what loading raises."""
        reader, size = self.plates.reader(scene), self.plates.size(scene, width)
        at_size = at_scale(scene, size[0] / reader.width)
        return Loader(*size, clip=not reader.is_still, reads=self._cache).load(at_size)

    def close(self) -> None:
        """Let go of everything that is kept, and of open files."""
        self.plates.close()
        self._cache.clear()
        close_backend(self.backend)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# Frames of plates at any size, in any order: readers stay open, and the last few frames are kept.


_SOON = 4
"""Frames to decode before one from which on its keyframe comes sooner: 3840 x 1920 take 15 to 50 ms each on two cores.
Twice as many, the play head waits for half a second."""
_KEPT_FRAMES = 8
"""Frames that are kept at the size they were asked for: 6 MB each at 2048 x 1024."""


class KeptFrames:
    """Reads frames of scenes' plates. cache: keeps readers and frames, and counts the frames decoded."""

    def __init__(self, cache: Cache) -> None:
        self._cache = cache
        self._open: VideoReader | None = None  # the plate whose file is open
        self._closing = ExitStack()
        self._seek: Seeker = lambda _: iter(())
        self._frames: Iterator[VideoFrame] = iter(())  # the pass that goes on
        self._next = -1  # of the frame that comes next in it

    def reader(self, scene: Scene) -> VideoReader:
        """Return the reader of a scene's plate at its full size; opened again where the file has changed."""
        whole = at_scale(scene, 1.0)
        return self._cache.of(open_plate, whole.only())

    def size(self, scene: Scene, width: int | None) -> tuple[int, int]:
        """Return the width and height of a scene's frames that are `width` pixels wide, rounded to even numbers.

        None takes the scene's own; a plate is never enlarged. Raises `ParameterError` for less than 16 rows.
        """
        reader = self.reader(scene)
        return scaled_size(reader, scene.plate.scale if width is None else min(width / reader.width, 1.0))

    def at(self, scene: Scene, index: int, width: int | None = None) -> VideoFrame:
        """Return a frame of a scene's plate, `width` pixels wide, see `size`; raise `VideoError`."""
        reader, size = self.reader(scene), self.size(scene, width)
        reader.check_range(index, index + 1)
        return self._cache.of(self._reduced, reader, index, stamp(reader.file_of(index)), size, keep=_KEPT_FRAMES)

    def _reduced(self, reader: VideoReader, index: int, at: Stamp, size: tuple[int, int]) -> VideoFrame:
        """Return a frame at a size. at: the stamp of its file."""
        return smaller(self._cache.of(self._decoded, reader, index, at), *size)

    def soonest(self, scene: Scene, index: int, width: int | None) -> int:
        """Return the frame that stands in for another while that is decoded: its keyframe, or itself where it is near.

        Raises `VideoError`.
        """
        reader, size, cache = self.reader(scene), self.size(scene, width), self._cache
        entry, which = reader.entry_before(index), (reader, index, stamp(reader.file_of(index)))
        kept = cache.holds(self._decoded, *which) or cache.holds(self._reduced, *which, size)
        start = max(entry, self._next) if self._open is reader else entry
        return index if kept or index - (start if start <= index else entry) < _SOON else entry

    def overview(self, scene: Scene, count: int, width: int) -> list[VideoFrame]:
        """Return up to `count` small frames spread over a scene's plate, for a time line; raise `VideoError`.

        They are the keyframes nearest before even steps, which are read without others; each has its own index.
        """
        reader = self.reader(scene)
        last = 1 if reader.frame_count is None else reader.frame_count
        places = np.linspace(0, last - 1, count).astype(int).tolist()
        return [self.at(scene, index, width) for index in dict.fromkeys(map(reader.entry_before, places))]

    def close(self) -> None:
        """Close the file that is open."""
        self._closing.close()
        self._open, self._frames = None, iter(())

    def _decoded(self, reader: VideoReader, index: int, _: Stamp) -> VideoFrame:
        """Return a frame of a reader, decoding on from the last one where that is near; its file is as its stamp."""
        if self._open is not reader:
            self.close()
            self._seek, self._next = self._closing.enter_context(reader.seeker()), -1
            self._open = reader
        if not reader.entry_before(index) <= self._next <= index:
            self._frames = self._seek(index)
        self._next = -1
        frame = next(frame for frame in self._frames if frame.index == index)
        self._next = index + 1
        return frame
