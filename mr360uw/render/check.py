# SPDX-License-Identifier: Apache-2.0
"""Dry run of a scene: its plan, and every problem that would stop a run, without rendering a frame; and what the
stages of one frame cost.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar, TypeVarTuple

from mr360uw.base.cache import Cache, PartOf, name_of
from mr360uw.base.files import check_outputs
from mr360uw.composite import load_object
from mr360uw.errors import DamagedFrameError, Mr360uwError, SceneError, VideoError
from mr360uw.ibl import SunTrack
from mr360uw.ibl.sun.detect import tracked_in_words
from mr360uw.render.first_pass import ClipAnalysis, first_pass
from mr360uw.render.frame import Backend, composite_frame, make_backend
from mr360uw.render.lights import EnvironmentReader
from mr360uw.render.loaded import Loaded, load, load_plate_depth
from mr360uw.render.match_stage import clip_colour, clip_grade
from mr360uw.render.mattes import Mattes, ReceiverClip
from mr360uw.render.surroundings import surroundings_over_time
from mr360uw.scene.model import Scene, files_of
from mr360uw.scene.resolved import (
    TABLE_S,
    eyes_of_plate,
    keyed_in_words,
    open_plate,
    projection_notes,
    tables_on_the_way,
)
from mr360uw.video import VideoFrame, VideoReader, create_video
from mr360uw.video.encoder import resolved

T = TypeVar("T")
_SUFFIXES = (".mp4", ".mov", ".mkv", ".webm")
"""Containers tried when no output is named."""


def explain_plan(scene: Scene, backend: str = "auto") -> str:
    """Return the stages of a run with the reason for each, as text; opens every file that the scene names."""
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        return _explained(video, loaded, (), *make_backend(backend))


def check_scene(
    scene: Scene,
    out: str | Path | None = None,
    *,
    frames: tuple[int, int | None] = (0, None),
    backend: str = "auto",
    where: str = "scene",
) -> str:
    """Return the stages of a run with the reason for each, as text.

    Opens every file that a run opens; nothing is written beside them. Without `out`, the text lists the containers that
    can hold the result. Raises `SceneError`, of the file `where`, with one line for each problem.
    """
    found = _Problems()
    video = found.of(lambda: open_plate(scene))
    loaded, renderer = None, found.of(lambda: make_backend(backend))
    if video is not None:
        loaded = found.of(lambda: load(scene, video.width, video.height, clip=not video.is_still))
    if loaded is None:  # loading stops at the first problem: look for the others
        for settings in scene.objects:
            found.of(partial(load_object, settings))
        if video is not None:
            found.of(lambda: surroundings_over_time(scene)(0.0))
    output = None
    if video is not None:
        _check_other_clips(scene, video, frames, found)
        output = found.of(lambda: possible_outputs(scene, video, None if out is None else Path(out), where))
    if video is None or loaded is None or renderer is None or output is None or found.lines:
        raise SceneError(where, list(found.lines))
    kinds, notes = output
    return f"{_explained(video, loaded, notes, *renderer)}\noutput    {kinds}"


class _Problems:
    """Collects the messages of failed actions, each once, in order."""

    def __init__(self) -> None:
        self.lines: dict[str, None] = {}

    def of(self, action: Callable[[], T]) -> T | None:
        """Return the result of an action, or None if it fails."""
        try:
            return action()
        except SceneError as error:
            self.lines |= dict.fromkeys(f"{error.where} {line}" for line in error.problems)
        except Mr360uwError as error:
            self.lines |= dict.fromkeys(str(error).splitlines())
        return None


def _check_other_clips(scene: Scene, video: VideoReader, frames: tuple[int, int | None], found: _Problems) -> None:
    """Check the inputs that run in step with the plate: mattes, distance maps, the track of its sun."""
    size = (video.width, video.height)
    span = found.of(lambda: video.numbered_range(*frames))
    stop = 1 if span is None else span[1]
    for holdout in scene.holdouts:
        found.of(partial(lambda one: Mattes([one], *size, scene.plate.eye).check(stop), holdout))
    if scene.plate.depth is not None:
        found.of(lambda: load_plate_depth(scene, size, Cache(), (stop, video.frame_count)))
    if (receiver := scene.receiver) is not None:
        found.of(lambda: ReceiverClip(receiver, *size, scene.plate.eye).check(stop))
    if scene.light.track is not None:
        found.of(lambda: first_pass(surroundings_over_time(scene)(0.0), video, measures=["sun"]))


def possible_outputs(scene: Scene, video: VideoReader, out: Path | None, where: str) -> tuple[str, tuple[str, ...]]:
    """Return a description of the output, or of the possible ones, and what the first lacks of the plate.

    Raises `VideoError` if none can be opened. Outputs are tried in a temporary folder: beside real files nothing is
    written.
    """
    if out is not None:
        inputs = [Path(where), *files_of(scene)]
        check_outputs([out], inputs=inputs, overwrite=True)  # one that is there may be meant to be replaced
    kinds: list[str] = []
    notes: tuple[str, ...] = ()
    problem = ""
    names = [f"out{suffix}" for suffix in _SUFFIXES] if out is None else [out.name]
    with TemporaryDirectory() as folder:
        for name in names:
            try:
                writer = create_video(Path(folder) / name, video, scene.output)
                writer.abort()
                notes = notes if kinds else writer.notes
                kinds.append(Path(name).suffix)
            except VideoError as error:
                problem = problem or str(error).replace(folder + os.sep, "" if out is None else f"{out.parent}{os.sep}")
    if not kinds:
        raise VideoError(problem)
    if out is not None:
        return str(out), notes
    codec = resolved(scene.output, video).codec
    return f"{' or '.join(kinds)} can hold {codec} and the plate's sound; or pictures", notes


def _explained(video: VideoReader, loaded: Loaded, notes: tuple[str, ...], backend: Backend, fallback: str) -> str:
    size = f"{video.width}x{video.height}"
    length = "a still" if video.is_still else f"{video.frame_count} frames"
    doubts = (*video.doubts, *projection_notes(loaded.scene, video), *filter(None, [eyes_of_plate(loaded.scene)[0]]))
    lines = [
        f"plate     {video.path.name}: {size}, {length}, {video.codec_name}",
        f"renderer  {backend.name} ({backend.device})",
        *(f"note      {note}" for note in (*notes, *doubts, *loaded.notes, *filter(None, [fallback]))),
    ]
    lines += [f"keyed     {line}" for line in keyed_in_words(loaded.scene)]
    if tables := tables_on_the_way(loaded.scene):
        lines.append(f"keyed     the water takes {tables} tables on its way, about {tables * TABLE_S:.0f} s in all")
    for placed in loaded.objects:
        size = " x ".join(f"{s:.2f}" for s in placed.motion.scale[0] * placed.meshes[0].extent_m)
        triangles = len(placed.meshes[0].positions)
        clip = None if placed.playback is None else placed.playback.clip
        plays = "" if clip is None else f", plays {clip.name!r} of {clip.duration_s:.2f} s"
        lines.append(f"object    {placed.settings.mesh.name}: {triangles} triangles, {size} m{plays}")
    grade = clip_grade(loaded, video)
    lines += scene_sun_lines(loaded, video, ClipAnalysis(grade=grade))
    lines += [f"look      {line}" for line in (() if grade is None else grade.found)]
    return "\n".join([*lines, "stages", str(loaded.plan)])


def scene_sun_lines(loaded: Loaded, video: VideoReader, analysis: ClipAnalysis, index: int = 0) -> list[str]:
    """Return the lines on a scene's sun in a frame of its plate; none where the scene says itself where it is, nothing
    is lit by it, or the frame cannot be decoded.
    """
    if not loaded.plan.sun.runs or loaded.scene.light.sun != "detect":
        return []
    try:
        frame = next(iter(video.frames(index, index + 1)))
    except DamagedFrameError:
        return []
    light = loaded.at(frame.time_s).surroundings.light
    return sun_lines(light, frame.graded_by(clip_colour(loaded, analysis.grade)), analysis)


def sun_lines(light: EnvironmentReader, frame: VideoFrame, analysis: ClipAnalysis) -> list[str]:
    """Return a line on the sun in a frame, and one on that of the clip's track there, if the clip was measured."""
    place = f"frame {frame.index}" if frame.index else "first frame"
    lines = [f"light     {place}: {light.sun_found(frame.pixels, frame.time_s)[0]}"]
    if isinstance(analysis.sun, SunTrack):
        lines.append(f"light     clip: {tracked_in_words(analysis.sun.at(frame.index - analysis.first))}")
    return lines


Inputs = TypeVarTuple("Inputs")

_DEPTH = 3
"""Levels of fields in which an input is looked for results of other stages: a body's mesh is in its place in a shot."""
_SHOWN_MS = 0.05
"""Processor time [ms] below which a stage is left out of the table, for nobody would miss it."""


@dataclass
class StageRun:
    """A stage: how often it was asked for and how often it ran, its processor time [s] without that of the stages that
    it called, and the stages whose results it took.
    """

    asked: int = 0
    ran: int = 0
    seconds: float = 0.0
    inputs: set[str] = field(default_factory=set)


class StageGraph(Cache):
    """A cache that notes the graph of the functions whose results it holds. runs: by name, in the order of their ends.

    Caches of other parts of the program may note into the same graph. graph: that they note into; None for an own one.
    """

    def __init__(self, room: int = 1, graph: StageGraph | None = None) -> None:
        super().__init__(room)
        self.runs: dict[str, StageRun] = {} if graph is None else graph.runs
        self._within: list[float] = [] if graph is None else graph._within
        self._makers: dict[int, tuple[str, object]] = {} if graph is None else graph._makers

    def of(self, function: Callable[[*Inputs], T], *inputs: *Inputs, keep: int = 1) -> T:
        """Return the result of a function, as `Cache.of` does."""
        before = self.made.total()
        with self._timed(name_of(function)):
            result = super().of(function, *inputs, keep=keep)
        self._note(name_of(function), inputs, result, self.made.total() > before)
        return result

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Add the processor time until the context ends to a stage's, without that of the stages called in it."""
        self._within.append(0.0)
        began = time.process_time()
        try:
            yield
        finally:
            took = time.process_time() - began
            own = took - self._within.pop()
            if self._within:
                self._within[-1] += took
        self.runs.setdefault(name, StageRun()).seconds += own

    def _note(self, name: str, inputs: tuple[object, ...], result: object, ran: bool) -> None:
        """Note that a stage was asked for, whether it ran, and whose results it took."""
        run = self.runs.setdefault(name, StageRun())
        run.asked += 1
        run.ran += ran
        if ran:  # a result that is there has noted its inputs
            makers = (self._makers.get(id(part)) for part in _parts(inputs, _DEPTH))
            run.inputs |= {maker[0] for maker in makers if maker is not None} - {name}
        for part in (result, *(result if isinstance(result, tuple) else ())):
            self._makers.setdefault(id(part), (name, part))  # holds the part, so that its number is not given again

    def forget_times(self) -> None:
        """Begin anew to count, and let go of results; which stages took whose results stays known."""
        self._makers.clear()
        for run in self.runs.values():
            run.asked = run.ran = 0
            run.seconds = 0.0

    def __str__(self) -> str:
        shown = {name: run for name, run in self.runs.items() if 1e3 * run.seconds >= _SHOWN_MS}
        width = max(map(len, shown), default=0)
        return "\n".join(
            f"  {name:<{width}}  {1e3 * run.seconds:8.1f} ms  {run.ran} of {run.asked}  {', '.join(sorted(run.inputs))}"
            for name, run in shown.items()
        )


def _parts(item: Any, depth: int) -> Iterator[object]:
    """Yield an input and its fields, down to a depth."""
    if item is None or isinstance(item, int | float | str):
        return
    yield item
    if depth == 0:
        return
    if isinstance(item, PartOf):
        yield from _parts(item.whole, depth)
    elif isinstance(item, tuple | list):
        for part in item:
            yield from _parts(part, depth)
    elif is_dataclass(item):
        for one in fields(item):
            yield from _parts(getattr(item, one.name, None), depth - 1)


def explain_costs(scene: Scene, backend: str = "auto") -> str:
    """Return, as text, the graph of the stages of the plate's first frame with the processor time of each: of a first
    frame whose kernels are compiled.
    """
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        plate = next(iter(video.frames(0, 1)))
    graph = StageGraph()
    renderer, _ = make_backend(backend, StageGraph(graph=graph))
    composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0, cache=graph)
    graph.forget_times()
    for cache in (graph, renderer.cache):
        cache.clear()
    began = time.process_time()
    composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0, cache=graph)
    took_ms, size = 1e3 * (time.process_time() - began), f"{loaded.width}x{loaded.height}"
    head = f"costs     first frame, {size}: {took_ms:.1f} ms of processor time; stage, time, runs, and whom it follows"
    return f"{head}\n{graph}"
