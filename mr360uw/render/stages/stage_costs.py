# SPDX-License-Identifier: Apache-2.0
"""Graph of the stages of a frame as they ran: whose results each took, its processor time, and what the skips of a plan
save, measured by drawing one frame.

A stage that the plan skips is made to run, with the skipped stages that it builds on, and the frame is drawn again.
Stages that only choose what a drawn pixel shows (shadow, occlusion, grain, lamps) cannot be made to run: the scene has
nothing for them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar, TypeVarTuple

from mr360uw.cache import Cache, PartOf, name_of
from mr360uw.render.backends import Backend, make_backend
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import composite_frame
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.plan import Plan
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene
from mr360uw.video import VideoFrame

T = TypeVar("T")
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


_RUNS = 5
"""Pairs of frames that a median is taken over. Twice as many halve the error of what is saved by a factor of 1.4."""
_NEEDS: dict[str, tuple[str, ...]] = {
    "environment": (),
    "sun": ("environment",),
    "glossy": ("environment",),
    "caustics": ("environment", "sun"),
    "shafts": ("environment", "sun", "caustics"),
    "pattern": ("environment", "sun"),
    "surface": ("environment",),
    "snow": ("environment",),
}
"""Stages that can be made to run, and those that each of them builds on."""
_OF_WATER = ("caustics", "shafts", "pattern", "surface", "snow")
_LEAST_MS = 0.1
"""Saved time [ms] below which nothing is told from the clock's own steps."""


def explain_skips(scene: Scene, backend: str = "auto") -> str:
    """Return, as text, the graph of the stages of the plate's first frame with the processor time of each, and the time
    that each skip of the scene's plan saves.
    """
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        plate = next(iter(video.frames(0, 1)))
    renderer, _ = make_backend(backend)
    planned_ms, saved = skip_times(loaded, renderer, plate)
    graph = stage_graph(loaded, backend, plate)
    size = f"{loaded.width}x{loaded.height}"
    head = f"skips     first frame, {size}: {planned_ms:.1f} ms of processor time as planned; median of {_RUNS} pairs"
    lines = [head]
    for name, (saved_ms, why) in saved.items():
        said = "not measured: it has nothing to work on"
        if saved_ms is not None:
            said = f"saves less than {_LEAST_MS:g} ms" if saved_ms < _LEAST_MS else f"saves {saved_ms:.1f} ms"
        lines.append(f"  {name:<11}  {said} ({why})")
    return "\n".join([*lines, "graph     stage, processor time, runs, and the stages that it follows", str(graph)])


def stage_graph(loaded: Loaded, backend: str, plate: VideoFrame) -> StageGraph:
    """Return the graph of the stages of a frame, with the times of a first frame whose kernels are compiled."""
    graph = StageGraph()
    renderer, _ = make_backend(backend, StageGraph(graph=graph))
    composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0, cache=graph)
    graph.forget_times()
    for cache in (graph, renderer.cache):
        cache.clear()
    composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0, cache=graph)
    return graph


def skip_times(
    loaded: Loaded, backend: Backend, plate: VideoFrame
) -> tuple[float, dict[str, tuple[float | None, str]]]:
    """Return the processor time [ms] of a frame as planned, its geometry kept, and what each skip of the plan saves.

    By stage: processor time [ms] of all threads that is saved in a frame, the median of pairs of frames, None where the
    stage cannot be made to run; and the plan's reason. "kept" is all that a renderer keeps from an earlier frame:
    geometry, meshes, ambient light. The frame's light is measured in the plate's frame alone.
    """
    _frame_ms(loaded, backend, plate)  # compiles
    planned = statistics.median(_frame_ms(loaded, backend, plate) for _ in range(_RUNS))
    found: dict[str, tuple[float | None, str]] = {}
    if loaded.plan.layer.runs:
        backend.cache.clear()
        saved_ms = _frame_ms(loaded, backend, plate) - _frame_ms(loaded, backend, plate)
        found["kept"] = saved_ms, "geometry, visibility and ambient light of bodies that have not moved; one pair"
    for name, stage in loaded.plan.stages.items():
        if stage.runs:
            continue
        possible = name in _NEEDS and (name not in _OF_WATER or loaded.surroundings.medium is not None)
        found[name] = _saved_ms(loaded, backend, plate, name) if possible else None, stage.why
    return planned, found


def _saved_ms(loaded: Loaded, backend: Backend, plate: VideoFrame, name: str) -> float:
    """Return what a stage adds [ms] to a frame in which all that it builds on runs."""
    without = replace(loaded, plan=_with(loaded.plan, _NEEDS[name]))
    run = replace(loaded, plan=_with(loaded.plan, (*_NEEDS[name], name)))
    for one in (without, run):
        _frame_ms(one, backend, plate)  # compiles
    return statistics.median(_frame_ms(run, backend, plate) - _frame_ms(without, backend, plate) for _ in range(_RUNS))


def _with(plan: Plan, names: Sequence[str]) -> Plan:
    """Return a plan in which some stages run."""
    return replace(plan, **{name: replace(plan.stages[name], runs=True) for name in names})


def _frame_ms(loaded: Loaded, backend: Backend, plate: VideoFrame) -> float:
    """Return the processor time [ms] of a frame; of earlier frames, only the renderer's geometry is kept."""
    began = time.process_time()
    composite_frame(loaded, ClipAnalysis(), backend, plate, 0.0)
    return 1e3 * (time.process_time() - began)
